"""The area that is drawn in a browser: its rings, its place on the globe, and its file."""

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jezero.area_files import AreaFileError, FilePolygon, place, read_polygons
from jezero.base.frames import geodetic_from_ned, ned_from_geodetic

FILE_MAX_BYTES = 500_000
CORNERS_MAX = 6000
"""Greatest number of corners that the planner accepts."""
COORDINATE_MAX_M = 1e6
SHIFT_MIN_M = 0.001
Ring = list[list[float]]


@dataclass(frozen=True)
class DrawnArea:
    """An area in metres, with the origin that it was drawn around.

    Attributes:
        rings: the outline, then the holes; corners are north and east of the world's origin.
        origin_deg: latitude and longitude of that origin; None while it was not known.
    """

    rings: tuple[Ring, ...] = ()
    origin_deg: tuple[float, float] | None = None

    @property
    def outline(self) -> Ring:
        """The corners of the outline; none without an area."""
        return self.rings[0] if self.rings else []

    def around(self, origin_deg: tuple[float, float] | None) -> "DrawnArea":
        """The same area on the globe, in metres around another origin: an autopilot has a new one at each start."""
        if origin_deg is None or origin_deg == self.origin_deg:
            return self
        if self.origin_deg is None:
            return DrawnArea(self.rings, origin_deg)
        north_m, east_m, _ = ned_from_geodetic((*self.origin_deg, 0.0), (*origin_deg, 0.0))
        if max(abs(north_m), abs(east_m)) < SHIFT_MIN_M:
            return self
        moved = tuple([[corner[0] + north_m, corner[1] + east_m] for corner in ring] for ring in self.rings)
        return DrawnArea(moved, origin_deg)

    def relative_to(self, origin_m: Sequence[float]) -> tuple[Ring, ...]:
        """The rings in metres relative to a point of the world."""
        return tuple([[corner[0] - origin_m[0], corner[1] - origin_m[1]] for corner in ring] for ring in self.rings)

    def kept(self) -> dict[str, Any]:
        """The area as the browser stores it."""
        return {"rings": self.rings, "origin": self.origin_deg}

    def geojson(self) -> bytes:
        """The area as a GeoJSON feature in degrees.

        Raises:
            AreaFileError: there is no area, or the world's origin is not known yet.
        """
        if self.origin_deg is None:
            raise AreaFileError("the area can't be exported yet: the vehicle has not sent the position of its origin")
        if not self.rings:
            raise AreaFileError("there is no area to export: draw one")
        origin_deg = (*self.origin_deg, 0.0)
        rings = []
        for ring in self.rings:
            corners = [geodetic_from_ned((north_m, east_m, 0.0), origin_deg) for north_m, east_m in ring]
            rings.append(
                [[round(longitude, 9), round(latitude, 9)] for latitude, longitude, _ in (*corners, corners[0])]
            )
        geometry = {"type": "Polygon", "coordinates": rings}
        return json.dumps({"type": "Feature", "properties": {"name": "area"}, "geometry": geometry}, indent=1).encode()


def area_from_browser(sent: Any, origin_deg: Any = None) -> DrawnArea:
    """An area as a browser has it; whatever is no area is an empty one.

    Args:
        sent: list of rings.
        origin_deg: latitude and longitude, or None.
    """
    try:
        rings = tuple([[float(north_m), float(east_m)] for north_m, east_m in ring] for ring in sent or ())
        origin = None if origin_deg is None else (float(origin_deg[0]), float(origin_deg[1]))
    except (TypeError, ValueError, IndexError):
        return DrawnArea()
    corners = [part for ring in rings for corner in ring for part in corner]
    if len(corners) > 2 * CORNERS_MAX or not all(abs(part) <= COORDINATE_MAX_M for part in corners):
        return DrawnArea()
    return DrawnArea(rings if corners and rings[0] else (), origin)


def polygons_in(name: str, text: str, size: int) -> list[FilePolygon]:
    """The areas in a file that a browser has sent.

    Args:
        name: name of the file; its end is its format.
        text: content of the file.
        size: size of the file in bytes.

    Raises:
        AreaFileError: the file is too large, or has no area; the message says what to do.
    """
    size = max(size, len(text))
    if size > FILE_MAX_BYTES:
        raise AreaFileError(
            f"{name} has {size / 1e6:.1f} MB, more than {FILE_MAX_BYTES / 1e6:g} MB: simplify its areas"
        )
    with tempfile.TemporaryDirectory(prefix="jezero-area-") as folder:
        file = Path(folder) / f"area{Path(name).suffix.lower()}"
        file.write_text(text, encoding="utf-8")
        try:
            return read_polygons(file)
        except AreaFileError as error:
            reason = str(error).removeprefix(f"{file}: ")
            raise AreaFileError(
                f"{name}: {reason.replace('add --metres', 'fly it with `jezero gridsweep --metres`')}"
            ) from None


def placed(polygon: FilePolygon, origin_deg: Sequence[float] | None) -> DrawnArea:
    """A file's polygon in the world.

    Raises:
        AreaFileError: it is too far away, or the world's origin is not known yet.
    """
    if origin_deg is None and not polygon.in_metres:
        raise AreaFileError("the area can't be placed yet: the vehicle has not sent the position of its origin")
    area = place(polygon, origin_deg)
    rings = tuple([list(corner) for corner in ring] for ring in (area.polygon_ned_m, *area.holes_ned_m))
    return DrawnArea(rings, None if origin_deg is None else (origin_deg[0], origin_deg[1]))
