"""Figures of recorded flights."""

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

if TYPE_CHECKING:
    from jezero.report.style import Format


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True), metavar="PATH...")
@click.option("--format", "form", type=click.Choice(["png", "pdf", "svg"]), default="png", show_default=True,
              help="Of the figures; pdf and svg for papers.")  # fmt: skip
def report(paths: tuple[Path, ...], form: str) -> None:
    """Draw what flights left behind, into their folders.

    A PATH is the folder of a run (`jezero demo`, `jezero fly --out`, `jezero getimages`, `jezero gridsweep`,
    `jezero bench landing --out`) or a file of `jezero bench landing --json`. Of pictures: a contact sheet, and of a
    coverage its plan beside the way flown. Of each flight: position and status over time, and where pictures were taken
    in an orbit. Of each landing on the rover: the estimate against the truth, the rover's position, UWB against tag,
    the touchdown. Of each plain landing: the vehicle's odometry. Of several landings, and of a benchmark: the scatter
    of the touchdowns, beside them.
    """
    from jezero.report.report import ReportError, draw_report

    try:
        files = draw_report(paths, cast("Format", form))
    except ReportError as error:
        raise click.ClickException(str(error)) from error
    for file in files:
        click.echo(f"wrote {file}")
