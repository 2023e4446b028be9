"""`jezero tag`: the tags on the rover's platform."""

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from jezero.base.extras import require
from jezero.cli.options import CommandGroup

if TYPE_CHECKING:
    from jezero.report.tag_board import Paper


@click.group(cls=CommandGroup)
def tag() -> None:
    """Print the tags on the rover's platform."""


@tag.command(name="print")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, metavar="FILE.pdf",
              help="The PDF to write.")  # fmt: skip
@click.option("--paper", type=click.Choice(["board", "a4", "a3"]), default="board", show_default=True,
              help="One page as large as the board, or sheets to be glued together.")  # fmt: skip
def print_(out: Path, paper: str) -> None:
    """Write the tag board of vehicle.toml as a PDF in true size.

    Print it without scaling, and check the ruler on each page: a board that is 2 % too large makes each height 2 % too
    small. Matt paper: tags that reflect the sun aren't seen.
    """
    require("`jezero tag print`", "matplotlib", "cv2")
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.report.tag_board import write_board

    if out.suffix.lower() != ".pdf":
        raise click.UsageError(f"{out} does not end with .pdf")
    platform = load_config(VehicleConfig, "vehicle").platform
    count = write_board(out, platform, cast("Paper", paper))
    pages = "1 page" if count == 1 else f"{count} pages"
    click.echo(f"{out}: {pages}, board of {platform.side_m:g} m with {len(platform.board)} tags; print it at 100 %")
