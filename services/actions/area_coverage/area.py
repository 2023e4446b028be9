"""The area of a goal: its polygons are repaired where their meaning is clear, and refused where it is not.

The vehicle may fly inside the outline and away from the holes, each by a margin.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import cos, dist, pi

import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from jezero.base.frames import geodetic_from_ned

Point = tuple[float, float]
AREA_MIN_M2 = 1e-4
CORNERS_APART_M = 0.01
"""Nearer corners are the same one, and a corner nearer to the line between its neighbours is none: no vehicle flies as
exactly as that."""
MAIN_MIN = 0.99
"""Least fraction of a polygon in its main part, for a repair: what is left out then is a mistake of the drawing."""
CORNERS_MAX = 6000
"""More corners would take too long to plan: 3000 take about three seconds."""


class AreaError(ValueError):
    """The area can't be mapped; the message has the reason and what to change."""


@dataclass(frozen=True)
class PlaceNames:
    """Names places of an area in messages, in the coordinates that the user gave.

    Attributes:
        corner_m: origin of the area's coordinates here, in those of the goal.
        origin_deg: latitude and longitude of the goal's origin; None for an area that was given in metres.
    """

    corner_m: Point = (0.0, 0.0)
    origin_deg: Point | None = None

    def name(self, point_m: Sequence[float]) -> str:
        """The name of a point of the area."""
        north_m, east_m = point_m[0] + self.corner_m[0], point_m[1] + self.corner_m[1]
        metres = f"{north_m:.2f} m north, {east_m:.2f} m east"
        if self.origin_deg is None:
            return metres
        latitude_deg, longitude_deg, _ = geodetic_from_ned((north_m, east_m, 0.0), (*self.origin_deg, 0.0))
        return f"latitude {latitude_deg:.7f}, longitude {longitude_deg:.7f} ({metres})"


@dataclass(frozen=True)
class RepairedArea:
    """The area of a goal after all repairs.

    Attributes:
        polygon: ground to cover.
        outline: the polygon without its holes.
        holes: ground that is left out; parts may touch the outline.
        warnings: repairs that change the area, for people.
    """

    polygon: Polygon
    outline: Polygon
    holes: Polygon | MultiPolygon
    warnings: tuple[str, ...]


def make_area(polygon_ned_m: Sequence[Point], holes_ned_m: Sequence[Sequence[Point]] = ()) -> Polygon:
    """The ground of `repair_area`."""
    return repair_area(polygon_ned_m, holes_ned_m).polygon


def repair_area(
    polygon_ned_m: Sequence[Point], holes_ned_m: Sequence[Sequence[Point]] = (), places: PlaceNames | None = None
) -> RepairedArea:
    """Make a simple polygon with holes from its corners; the last corner may repeat the first.

    Repeated corners and corners on a line go without a word. A polygon that crosses itself is repaired with a warning
    if one part has nearly all of its area. Holes may touch or overlap each other, and touch the outline.

    Args:
        places: names the places in the messages; None for the corners' own coordinates.

    Raises:
        AreaError: too few or too many corners, edges that cross, no area, a hole that isn't inside, or nothing left.
    """
    warnings: list[str] = []
    places = places or PlaceNames()
    outline = _ring(polygon_ned_m, "the polygon", places, warnings)
    around = outline.buffer(CORNERS_APART_M, join_style="mitre")
    holes = []
    for number, corners_m in enumerate(holes_ned_m, 1):
        hole = _ring(corners_m, f"hole {number}", places, warnings)
        if not around.covers(hole):
            raise AreaError(f"hole {number} is not wholly inside the polygon: correct it, or leave it out")
        holes.append(hole)
    left_out = shapely.union_all(holes) if holes else Polygon()
    area = _main_without_holes(outline.difference(left_out), warnings) if holes else outline
    if (corners := shapely.get_num_coordinates(area)) > CORNERS_MAX:
        raise AreaError(f"the area has {corners} corners, more than {CORNERS_MAX}: simplify it, or map it in parts")
    return RepairedArea(area, outline, left_out, tuple(warnings))


def _main_without_holes(ground: BaseGeometry, warnings: list[str]) -> Polygon:
    """The main part of what the holes leave of the polygon."""
    parts = polygons_of(ground)
    left_m2 = sum(part.area for part in parts)
    if left_m2 < AREA_MIN_M2:
        raise AreaError("nothing is left to cover: the holes are as large as the polygon")
    main = _largest(parts)
    if main.area < MAIN_MIN * left_m2:
        raise AreaError(f"the holes cut the polygon into {len(parts)} parts: map these one by one")
    if len(parts) > 1:
        warnings.append(f"the holes cut off {_size(left_m2 - main.area)}, which is left out")
    return main


def _ring(corners_m: Sequence[Point], name: str, places: PlaceNames, warnings: list[str]) -> Polygon:
    """A valid polygon from the corners of one outline."""
    kept = _apart(corners_m)
    if len(kept) < 3:
        raise AreaError(f"{name} has {len(kept)} different corners: three are the least")
    ring = Polygon(kept)
    if not ring.is_valid:
        ring = _untangled(ring, name, places, warnings)
    if ring.area < AREA_MIN_M2:
        raise AreaError(f"{name} has an area of {ring.area:.1e} m²: its corners are on one line")
    simple = ring.simplify(CORNERS_APART_M)
    return simple if isinstance(simple, Polygon) and simple.is_valid and simple.area >= AREA_MIN_M2 else ring


def _apart(corners_m: Sequence[Point]) -> list[Point]:
    """The corners without those that repeat the one before, across the end too."""
    kept: list[Point] = []
    for corner in corners_m:
        if not kept or dist(kept[-1], corner) >= CORNERS_APART_M:
            kept.append(corner)
    while len(kept) > 1 and dist(kept[-1], kept[0]) < CORNERS_APART_M:
        kept.pop()
    return kept


def _untangled(ring: Polygon, name: str, places: PlaceNames, warnings: list[str]) -> Polygon:
    """The main part of an outline that crosses or touches itself.

    Ground that the outline goes around twice is inside by one rule and outside by the other: it counts as unclear.
    """
    reason = shapely.is_valid_reason(ring)
    place = _place_in(reason, places)
    everything = shapely.make_valid(ring, method="structure", keep_collapsed=False)
    parts = polygons_of(everything)
    total_m2 = sum(part.area for part in parts)
    if total_m2 < AREA_MIN_M2:
        raise AreaError(f"{name} has an area of {total_m2:.1e} m²: its corners are on one line")
    by_crossings = shapely.make_valid(ring)
    main = _largest(parts)
    lost_m2 = total_m2 - main.area
    unclear_m2 = everything.symmetric_difference(shapely.union_all(polygons_of(by_crossings))).area
    if lost_m2 + unclear_m2 > (1.0 - MAIN_MIN) * total_m2:
        raise AreaError(f"{name} crosses or touches itself{place}: give its corners in order, or map its parts alone")
    spikes = list(_spikes(by_crossings, main, places))
    if spikes:
        warnings.append(f"{name} runs forth and back on one line, which is left out: {', '.join(spikes)}")
    if lost_m2 + unclear_m2 > AREA_MIN_M2 or not spikes:
        warnings.append(f"{name} crosses or touches itself{place}: {_size(lost_m2 + unclear_m2)} there is left out")
    return main


def _spikes(repaired: BaseGeometry, main: Polygon, places: PlaceNames) -> Iterator[str]:
    """The lines without area in an outline, by the end that is farther from its main part."""
    for line in shapely.get_parts(repaired):
        if isinstance(line, LineString) and line.length > CORNERS_APART_M:
            yield "at " + places.name(max(line.coords, key=lambda end: main.distance(shapely.Point(end))))


def _place_in(reason: str, places: PlaceNames) -> str:
    """The place of a crossing in GEOS' words, such as "Self-intersection[3.5 4]"."""
    found = re.search(r"\[(\S+) (\S+)\]", reason)
    return f" at {places.name((float(found[1]), float(found[2])))}" if found else ""


def _size(area_m2: float) -> str:
    return f"{area_m2:.2g} m²"


TRACKING_M = 0.15
"""Distance from its path that a vehicle hardly exceeds in wind. A margin holds for the vehicle, so the path keeps this
much more; without a margin the path may lie on the outline itself."""
ARC_SEGMENTS = 4
ARC_OUTWARDS = 1.0 / cos(0.25 * pi / ARC_SEGMENTS)
"""Factor of a radius that keeps the chords of a quarter circle of ARC_SEGMENTS outside the circle."""
MARGIN_LOSS_MIN = 0.01
"""Least fraction of the area that the margins leave out, for a warning."""
MAIN_IN_MARGINS_MIN = 0.9
"""Least fraction of what the margins leave in its main part: corners behind a hole may be cut off, not half a field."""


@dataclass(frozen=True)
class FlightArea:
    """Ground to sweep, and where the vehicle may fly for that.

    Attributes:
        sweep: ground of the area within half a line distance of `fly`.
        fly: ground over which the path may lead.
        warnings: what the margins change, for people.
    """

    sweep: Polygon
    fly: Polygon
    warnings: tuple[str, ...]


def flight_area(
    area: RepairedArea, resolution_m: float, *, margin_outline_m: float = 0.0, margin_holes_m: float = 0.0
) -> FlightArea:
    """Where to fly over an area.

    Args:
        resolution_m: distance between lines.
        margin_outline_m: least distance of the vehicle from the outline, inside it.
        margin_holes_m: least distance of the vehicle from each hole.

    Raises:
        AreaError: the margins leave nothing, or cut the area into parts.
    """
    if not margin_outline_m and (not margin_holes_m or area.holes.is_empty):
        return FlightArea(area.polygon, area.polygon, ())
    inside = area.outline.buffer(-_with_tracking(margin_outline_m), quad_segs=ARC_SEGMENTS)
    blocked = area.holes.buffer(_with_tracking(margin_holes_m), quad_segs=ARC_SEGMENTS)
    fly = _main_in_margins(inside.difference(blocked).intersection(area.polygon), margin_outline_m, margin_holes_m)
    sweep = _largest(polygons_of(area.polygon.intersection(fly.buffer(0.5 * resolution_m))))
    lost = 1.0 - sweep.area / area.polygon.area
    if lost <= MARGIN_LOSS_MIN:
        return FlightArea(sweep, fly, ())
    margins = _margins_in_words(margin_outline_m, margin_holes_m)
    warning = f"the margins ({margins}) leave out {100.0 * lost:.0f} % of the area: no line passes there"
    return FlightArea(sweep, fly, (warning,))


def _with_tracking(margin_m: float) -> float:
    return ARC_OUTWARDS * (margin_m + TRACKING_M) if margin_m else 0.0


def _main_in_margins(ground: Polygon | MultiPolygon, margin_outline_m: float, margin_holes_m: float) -> Polygon:
    """The main part of what the margins leave."""
    parts = polygons_of(ground)
    margins = _margins_in_words(margin_outline_m, margin_holes_m)
    if not parts:
        raise AreaError(f"the margins ({margins}) leave nothing to fly over: take smaller ones")
    main = _largest(parts)
    if main.area < MAIN_IN_MARGINS_MIN * sum(part.area for part in parts):
        raise AreaError(
            f"the margins ({margins}) cut the area into {len(parts)} parts: take smaller ones, or map the parts one "
            "by one"
        )
    return main


def _margins_in_words(margin_outline_m: float, margin_holes_m: float) -> str:
    return f"{margin_outline_m:g} m from the outline, {margin_holes_m:g} m from holes"


def polygons_of(geometry: BaseGeometry) -> list[Polygon]:
    """The polygons in a geometry, without points, lines and empty parts."""
    parts = shapely.get_parts(geometry)
    nested = [polygons_of(part) if isinstance(part, MultiPolygon) else [part] for part in parts]
    return [part for group in nested for part in group if isinstance(part, Polygon) and not part.is_empty]


def _largest(parts: Sequence[Polygon]) -> Polygon:
    return max(parts, key=lambda part: float(part.area))
