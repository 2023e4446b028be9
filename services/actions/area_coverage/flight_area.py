"""Where the vehicle may fly over an area: inside its outline and away from its holes, each by a margin."""

from dataclasses import dataclass
from math import cos, pi

from shapely.geometry import MultiPolygon, Polygon

from jezero.services.actions.area_coverage.area import AreaError, RepairedArea, polygons_of

TRACKING_M = 0.15
"""Distance from its path that a vehicle hardly exceeds in wind. A margin holds for the vehicle, so the path keeps this
much more; without a margin the path may lie on the outline itself."""
ARC_SEGMENTS = 4
ARC_OUTWARDS = 1.0 / cos(0.25 * pi / ARC_SEGMENTS)
"""Factor of a radius that keeps the chords of a quarter circle of ARC_SEGMENTS outside the circle."""
MARGIN_LOSS_MIN = 0.01
"""Least fraction of the area that the margins leave out, for a warning."""
MAIN_MIN = 0.9
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
    fly = _main_of(inside.difference(blocked).intersection(area.polygon), margin_outline_m, margin_holes_m)
    sweep = max(polygons_of(_swept_from(fly, area.polygon, resolution_m)), key=lambda part: float(part.area))
    lost = 1.0 - sweep.area / area.polygon.area
    warnings = (
        (
            f"the margins ({_in_words(margin_outline_m, margin_holes_m)}) leave out {100.0 * lost:.0f} % of the area: "
            "no line passes there",
        )
        if lost > MARGIN_LOSS_MIN
        else ()
    )
    return FlightArea(sweep, fly, warnings)


def _with_tracking(margin_m: float) -> float:
    return ARC_OUTWARDS * (margin_m + TRACKING_M) if margin_m else 0.0


def _swept_from(fly: Polygon, area: Polygon, resolution_m: float) -> Polygon | MultiPolygon:
    """The ground of the area within half a line distance of where the vehicle may fly."""
    return area.intersection(fly.buffer(0.5 * resolution_m))


def _main_of(ground: Polygon | MultiPolygon, margin_outline_m: float, margin_holes_m: float) -> Polygon:
    """The main part of what the margins leave."""
    parts = polygons_of(ground)
    margins = _in_words(margin_outline_m, margin_holes_m)
    if not parts:
        raise AreaError(f"the margins ({margins}) leave nothing to fly over: take smaller ones")
    main = max(parts, key=lambda part: float(part.area))
    if main.area < MAIN_MIN * sum(part.area for part in parts):
        raise AreaError(
            f"the margins ({margins}) cut the area into {len(parts)} parts: take smaller ones, or map the parts one "
            "by one"
        )
    return main


def _in_words(margin_outline_m: float, margin_holes_m: float) -> str:
    return f"{margin_outline_m:g} m from the outline, {margin_holes_m:g} m from holes"
