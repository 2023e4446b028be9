"""`jezero map`: a map from the images of a coverage."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from jezero.cli.shared import FiniteRange, Printer

if TYPE_CHECKING:
    from jezero.mapping.making import Map

M_PER_PX = 0.02


@click.command("map")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--resolution",
    "m_per_px",
    type=FiniteRange(0.001, 10.0),
    default=M_PER_PX,
    show_default=True,
    help="Metres per pixel.",
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The map's file [FOLDER/map.png].")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
def make(folder: Path, m_per_px: float, out: Path | None, as_json: bool) -> None:
    """Make a map from a coverage's images in FOLDER: a PNG with north at the top, a GeoTIFF and a KML overlay.

    The PNG's world file is in metres of the world frame, x to the east and y to the north; the GeoTIFF and the overlay
    are in degrees. The ground's height comes from the altimeter; features that images have in common correct their
    positions.
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
        files = made.save(file)
    except SurveyError as error:
        raise click.ClickException(str(error)) from None
    height_px, width_px, _ = made.mosaic.pixels.shape
    alignment = made.alignment
    printer.event(
        "result",
        f"{_alignment_text(made)}\nmap of {width_px} x {height_px} pixels, {made.description}\n"
        f"wrote {', '.join(str(path) for path in files)}{_origin_text(made)}",
        outcome="succeeded",
        file=str(file),
        files=[str(path) for path in files],
        m_per_px=m_per_px,
        picture_m_per_px=made.picture_m_per_px,
        origin_deg=made.origin_deg,
        pictures=made.pictures,
        pairs=alignment.pairs,
        groups=alignment.groups,
        apart_before_m=alignment.before_m if alignment.pairs else None,
        apart_after_m=alignment.after_m if alignment.pairs else None,
    )


def _alignment_text(made: "Map") -> str:
    alignment = made.alignment
    if alignment.pairs == 0:
        return f"{made.pictures} images without ground in common: each is placed by the vehicle's own position"
    text = (
        f"{made.pictures} images, {alignment.pairs} pairs with ground in common; median offset before alignment "
        f"{100.0 * alignment.before_m:.1f} cm, after it {100.0 * alignment.after_m:.1f} cm"
    )
    if len(alignment.groups) > 1:
        sizes = ", ".join(str(size) for size in alignment.groups)
        text += (
            f"\nwarning: {len(alignment.groups)} groups of images ({sizes}) have no ground in common: where they meet, "
            "the map may be off by the errors of the vehicle's position; take pictures of the ground between them"
        )
    return text


def _origin_text(made: "Map") -> str:
    if made.origin_deg is None:
        return "\nthe images have no position in degrees, so there is no GeoTIFF and no KML"
    latitude, longitude, _ = made.origin_deg
    return f"\nthe map's origin is at latitude {latitude:.7f}, longitude {longitude:.7f}"
