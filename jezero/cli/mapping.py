"""`jezero map`: a map from the images of a coverage."""

from pathlib import Path

import click

from jezero.cli.flight import Printer

M_PER_PX = 0.02


@click.command("map")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--resolution",
    "m_per_px",
    type=click.FloatRange(0.001, 10.0),
    default=M_PER_PX,
    show_default=True,
    help="Metres per pixel.",
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The map's file [FOLDER/map.png].")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
def make(folder: Path, m_per_px: float, out: Path | None, as_json: bool) -> None:
    """Make a map from a coverage's images in FOLDER: a PNG with north at the top, and its world file.

    Coordinates are metres in the world frame, x to the east and y to the north. The ground's height comes from the
    altimeter; features that images have in common correct their positions.
    """
    map_pictures(Printer(as_json), folder, m_per_px, out)


def map_pictures(printer: Printer, folder: Path, m_per_px: float = M_PER_PX, out: Path | None = None) -> None:
    """Make a map from a folder's images and print a summary.

    Raises:
        click.ClickException: the folder has no images, or they cannot be mapped.
    """
    from jezero.mapping.making import make_map
    from jezero.mapping.survey import SurveyError
    from jezero.runtime.config import load_config
    from jezero.vehicle_config import VehicleConfig

    file = (out or folder / "map.png").with_suffix(".png")
    try:
        made = make_map(folder, m_per_px, load_config(VehicleConfig, "vehicle"))
        world = made.mosaic.save(file)
    except SurveyError as error:
        raise click.ClickException(str(error)) from None
    height_px, width_px, _ = made.mosaic.pixels.shape
    alignment = made.alignment
    text = (
        f"{made.pictures} images, {alignment.pairs} pairs with ground in common; median offset before alignment "
        f"{100.0 * alignment.before_m:.1f} cm, after it {100.0 * alignment.after_m:.1f} cm\n"
        if alignment.pairs
        else f"{made.pictures} images without ground in common: each is placed by the vehicle's own position\n"
    )
    printer.event(
        "result",
        f"{text}wrote {file}: {width_px} x {height_px} pixels of {m_per_px:g} m, and {world}",
        outcome="succeeded",
        file=str(file),
        world_file=str(world),
        pictures=made.pictures,
        pairs=alignment.pairs,
        apart_before_m=alignment.before_m if alignment.pairs else None,
        apart_after_m=alignment.after_m if alignment.pairs else None,
    )
