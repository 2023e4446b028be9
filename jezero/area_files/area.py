"""The area in the world: a file's polygon, placed around the world's origin."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from jezero.area_files.polygon import AreaFileError, Corner, FilePolygon, Ring
from jezero.area_files.rings import ring_area
from jezero.base.frames import ned_from_geodetic

DISTANCE_MAX_M = 50_000.0
"""An area farther away than this is misread: metres for degrees, longitude for latitude, or another place's origin."""
EXTENT_MIN_M = 0.1
"""An area smaller than this is misread: degrees for metres."""
DECIMALS = 4
"""A tenth of a millimetre."""


@dataclass(frozen=True)
class Area:
    """An area with its holes in the world frame.

    Attributes:
        name: name that the file gives it; "" for none.
        polygon_ned_m: (n, 2) corners of the outline, metres north and east.
        holes_ned_m: polygons (n, 2) that are left out.
        origin_deg: latitude and longitude of the world's origin that placed it; None for a file in metres. A goal with
            it gets refusals and warnings that name places in the file's degrees.
    """

    name: str
    polygon_ned_m: Ring
    holes_ned_m: tuple[Ring, ...] = ()
    origin_deg: Corner | None = None


def place(polygon: FilePolygon, origin_deg: Sequence[float] | None) -> Area:
    """Place a file's polygon in the world.

    Args:
        origin_deg: latitude and longitude of the world's origin, such as `Odometry.origin_deg`, whose altitude is not
            used; None is enough for a polygon in metres.

    Raises:
        AreaFileError: the polygon is so far from the origin, or so small, that its numbers must be misread; or the
            origin is missing.
    """
    if polygon.in_metres:
        rings = polygon.rings
    elif origin_deg is None:
        raise AreaFileError(f"{polygon.place} is in degrees, and the world's origin is not known yet")
    else:
        rings = tuple(project(ring, origin_deg) for ring in polygon.rings)
    for corner, corner_ned_m in zip(polygon.rings[0], rings[0], strict=True):
        if not hypot(*corner_ned_m) <= DISTANCE_MAX_M or not (polygon.in_metres or _on_earth(corner)):
            raise AreaFileError(f"{polygon.place}: {_far(polygon, corner, corner_ned_m, origin_deg)}")
    extent_m = max(max(axis) - min(axis) for axis in zip(*rings[0], strict=True))
    if extent_m < EXTENT_MIN_M:
        hint = ": if its numbers are degrees, leave out --metres" if polygon.in_metres else ""
        raise AreaFileError(f"{polygon.place}: the area is only {1000.0 * extent_m:.1f} mm wide{hint}")
    placed_deg = None if polygon.in_metres or origin_deg is None else (origin_deg[0], origin_deg[1])
    return Area(polygon.name, rings[0], rings[1:], placed_deg)


def project(ring: Ring, origin_deg: Sequence[float]) -> Ring:
    """Metres north and east of the origin from latitudes and longitudes."""
    latitude_deg, longitude_deg, *_ = origin_deg
    placed = []
    for corner_deg in ring:
        north_m, east_m, _ = ned_from_geodetic((*corner_deg, 0.0), (latitude_deg, longitude_deg, 0.0))
        placed.append((round(north_m, DECIMALS), round(east_m, DECIMALS)))
    return tuple(placed)


def area_m2(polygon: FilePolygon) -> float:
    """Size of a polygon without its holes, wherever it lies."""
    rings = polygon.rings if polygon.in_metres else [project(ring, polygon.rings[0][0]) for ring in polygon.rings]
    outline, *holes = (ring_area(ring) for ring in rings)
    return max(outline - sum(holes), 0.0)


def _far(polygon: FilePolygon, corner: Corner, corner_ned_m: Corner, origin_deg: Sequence[float] | None) -> str:
    """What is wrong with a corner that is too far away, and what helps."""
    distance_km = hypot(*corner_ned_m) / 1000.0
    far = f"is {distance_km:.0f} km from" if distance_km < 1e6 else f"is {distance_km:.1e} km from"
    far += " the world's origin"
    if polygon.in_metres or origin_deg is None:
        return (
            f"the corner {corner[0]:g} m north, {corner[1]:g} m east {far}: "
            "metres are counted from that origin, not from that of a map"
        )
    there = f"the corner at latitude {corner[0]:.6f}, longitude {corner[1]:.6f}"
    metres = "if its numbers are metres, [north, east], add --metres; " if polygon.perhaps_metres else ""
    if not _on_earth(corner):
        return f"{there} is not on Earth: {metres or 'degrees are WGS 84, the latitude up to 90'}"
    latitude_deg, longitude_deg, *_ = origin_deg
    far += f", which is at {latitude_deg:.6f}, {longitude_deg:.6f}"
    swapped = (corner[1], corner[0])
    if _on_earth(swapped) and hypot(*project((swapped,), origin_deg)[0]) <= DISTANCE_MAX_M:
        return f"{there} {far}: latitude and longitude are in the wrong order"
    return (
        f"{there} {far}: {metres}if the field is elsewhere, start the vehicle there, or plan it with --plan-only "
        "--origin LATITUDE LONGITUDE"
    )


def _on_earth(corner_deg: Corner) -> bool:
    """Whether latitude and longitude are in range; a longitude may go on beyond 180 degrees."""
    return abs(corner_deg[0]) <= 90.0 and abs(corner_deg[1]) <= 360.0
