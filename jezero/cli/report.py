"""`jezero report`: figures of recorded flights."""

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

if TYPE_CHECKING:
    from jezero.report.style import Format


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True), metavar="PATH...")
@click.option("--format", "form", type=click.Choice(["png", "pdf", "svg"]), default="png", show_default=True,
              help="Format of the figures; pdf and svg for papers.")  # fmt: skip
def report(paths: tuple[Path, ...], form: str) -> None:
    """Draw the figures of recorded flights into their folders.

    A PATH is the folder of a run (`jezero demo`, `jezero fly --out`, `jezero getimages`, `jezero gridsweep`,
    `jezero bench landing --out`) or a file of `jezero bench landing --json`. Figures of images: a contact sheet, and
    for a coverage the planned and the flown path. Figures of a flight: position and status over time, and the places
    of an orbit's images. Figures of a landing on the rover: estimate and truth, the rover's position, UWB and tag, the
    touchdown. Figure of a landing on a spot: the vehicle's odometry. Figure of several landings or a benchmark: the
    scatter of the touchdowns.
    """
    from jezero.report.report import ReportError, draw_report

    try:
        files = draw_report(paths, cast("Format", form))
    except ReportError as error:
        raise click.ClickException(str(error)) from error
    for file in files:
        click.echo(f"wrote {file}")
