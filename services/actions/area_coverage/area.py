"""Checks of the area of a goal."""

from collections.abc import Sequence

from shapely.geometry import LinearRing, Polygon
from shapely.validation import explain_validity

Point = tuple[float, float]
AREA_MIN_M2 = 1e-4


class AreaError(ValueError):
    """The area can't be mapped; the message has the reason and what to change."""


def make_area(polygon_ned_m: Sequence[Point], holes_ned_m: Sequence[Sequence[Point]] = ()) -> Polygon:
    """Make a simple polygon with holes from its corners; the last corner may repeat the first.

    Raises:
        AreaError: too few corners, edges that cross, no area, or a hole that isn't wholly inside.
    """
    area = _ring(polygon_ned_m, "the polygon")
    for number, corners_ned_m in enumerate(holes_ned_m, 1):
        hole = _ring(corners_ned_m, f"hole {number}")
        if not area.contains(hole):
            raise AreaError(f"hole {number} is not wholly inside the polygon, or touches another hole: correct it")
        area = area.difference(hole)
    if not isinstance(area, Polygon):
        raise AreaError("the holes cut the polygon into parts: map these one by one")
    return area


def _ring(corners_m: Sequence[Point], name: str) -> Polygon:
    distinct = len(set(corners_m))
    if distinct < 3:
        raise AreaError(f"{name} has {distinct} different corners: three are the least")
    ring = Polygon(LinearRing(corners_m))
    if not ring.is_valid:
        raise AreaError(f"{name} crosses or touches itself ({explain_validity(ring)}): give its corners in order")
    if ring.area < AREA_MIN_M2:
        raise AreaError(f"{name} has an area of {ring.area:.1e} m²: its corners are on one line")
    return ring
