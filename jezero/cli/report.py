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

    A PATH is the folder of a run (`jezero up`, `jezero demo`, `jezero fly --out`, `jezero getimages`,
    `jezero gridsweep`, `jezero bench landing --out`), a recording, or a file of `jezero bench landing --json`. Each
    recording of `jezero up` has its own folder of figures, beside it.

    Figures of a flight: position and status over time; for each orbit and coverage the path flown and the pictures.
    Figures of each landing on the rover: estimate and truth, the rover's position, UWB and tag, the touchdown; on a
    spot: the vehicle's odometry. Figures of images: a contact sheet, and for a coverage the planned and the flown path.
    Figure of several landings or a benchmark: the scatter of the touchdowns. In a recording without truth, as of a real
    vehicle, the figures show the estimate with three of its standard deviations instead of its error.
    """
    from jezero.report.report import ReportError, draw_report

    try:
        files = draw_report(paths, cast("Format", form), lambda text: click.echo(text, err=True))
    except ReportError as error:
        raise click.ClickException(str(error)) from error
    for file in files:
        click.echo(f"wrote {file}")
