"""What is wrong with a fence before it is in force: shapes that are a mistake, and areas in which nothing can fly."""

from collections.abc import Sequence
from math import hypot
from typing import Any

import shapely
from msgspec.structs import replace
from shapely.geometry import MultiPolygon, Polygon

from jezero.fence_geometry import HOLD_OFF_M, outside_reason, placed, way_refusal
from jezero.frames import Vec3, ned_from_geodetic
from jezero.schemas.fence import Fence, Zone

SIZE_MIN_M, AREA_MIN_M2 = 1.0, 0.01
"""Smallest diagonal and area of a zone; a smaller one is a mistake."""
FAR_M = 50_000.0
"""Distance from the vehicle's origin at which no fence is of use."""


def zone_refusal(zone: Zone) -> str:
    """What is wrong with the shape of a zone, for people, or ""."""
    shape = _polygon(zone)
    north_m, east_m, north_end_m, east_end_m = shape.bounds
    size_m = hypot(north_end_m - north_m, east_end_m - east_m)
    if size_m < SIZE_MIN_M:
        hint = ": are they degrees? Then write `degrees: true`" if zone.corners_ned_m else ""
        return f"its corners are at most {1000.0 * size_m:.0f} mm apart{hint}"
    if shape.convex_hull.area < AREA_MIN_M2:
        return "it has no area: all its corners are in one line"
    if not shape.is_valid:
        place = shapely.is_valid_reason(shape).partition("[")[2].rstrip("]").split()
        north_m, east_m = (float(number) for number in place[:2])
        where = _place(zone, north_m, east_m)
        return f"its edges cross or touch at {where}: give the corners in their order along the edge"
    return ""


def fence_refusal(fence: Fence, origin_deg: Vec3 | None = None) -> str:
    """Why a fence can't be put in force, for people, or "".

    Args:
        origin_deg: latitude, longitude and altitude of the vehicle's origin; None where it isn't known.
    """
    for zone in fence.zones:
        if reason := zone_refusal(zone) or _far(zone, origin_deg):
            return f"{zone.name!r}: {reason}"
    inside, free = _areas(fence, origin_deg)
    if inside is not None and inside.is_empty:
        return f"the area to stay in is nowhere wider than {2 * HOLD_OFF_M:g} m: no vehicle can fly in it"
    if free is not None and free.is_empty:
        names = ", ".join(repr(zone.name) for zone in fence.keep_out)
        return f"nothing is left to fly in: {names} to stay out of covers the area to stay in"
    return ""


def fence_doubts(fence: Fence, origin_deg: Vec3 | None = None) -> tuple[str, ...]:
    """What a person should know about a fence that can be put in force.

    Args:
        origin_deg: as in `fence_refusal`.
    """
    _, free = _areas(fence, origin_deg)
    if not isinstance(free, MultiPolygon):
        return ()
    sizes = ", ".join(f"{area_m2:.0f} m²" for area_m2 in sorted((part.area for part in free.geoms), reverse=True))
    return (f"the area to stay in falls into {len(free.geoms)} parts, between which nothing can fly: {sizes}",)


def places_outside(fence: Fence, pos_uav_ned_m: Vec3, pos_rover_ned_m: Vec3 | None) -> tuple[str, ...]:
    """Whether the vehicle, the rover, or the straight way between them is outside: a sentence for each that is.

    Args:
        fence: its zones in metres.
        pos_rover_ned_m: None where nobody knows the place of the rover.
    """
    places = {"the vehicle": pos_uav_ned_m} | ({} if pos_rover_ned_m is None else {"the rover": pos_rover_ned_m})
    found = tuple(f"{name} is {reason}" for name, at in places.items() if (reason := outside_reason(fence, at)))
    if found or pos_rover_ned_m is None:
        return found
    on_map = replace(fence, ceiling_m=None, floor_over_ground_m=0.0)
    way = way_refusal(on_map, (pos_uav_ned_m, pos_rover_ned_m), from_ground=True, to_ground=True)
    return (f"from the vehicle to the rover {way}",) if way else ()


def joined(zones: Sequence[Zone]) -> Zone | str:
    """Several areas to stay in as one, or why they are not one, for people."""
    if len(zones) == 1:
        return zones[0]
    in_degrees = {bool(zone.corners_deg) for zone in zones}
    if len(in_degrees) > 1:
        return "some areas to stay in are in degrees and others in metres: write all in the same"
    for zone in zones:
        if reason := zone_refusal(zone):
            return f"{zone.name!r}: {reason}"
    first_deg = zones[0].corners_deg[0][1] if True in in_degrees else 0.0
    shape = shapely.unary_union([Polygon(_turned(zone.corners_deg, first_deg) or zone.corners_ned_m) for zone in zones])
    if not isinstance(shape, Polygon):
        return f"the {len(zones)} areas to stay in don't touch: give one area, or let them overlap"
    if shape.interiors:
        return "the areas to stay in surround a hole: join them to one, and write the hole as a zone to stay out of"
    corners = tuple((float(a), float(b)) for a, b in shape.exterior.coords[:-1])
    name = " and ".join(zone.name for zone in zones)[:64]
    return (
        Zone(name=name, corners_deg=_turned(corners, 0.0))
        if True in in_degrees
        else Zone(name=name, corners_ned_m=corners)
    )


def _turned(corners_deg: Sequence[tuple[float, float]], longitude_deg: float) -> tuple[tuple[float, float], ...]:
    """The same corners with longitudes within half a turn of one, so that no edge leads around the Earth."""
    return tuple((a, b - 360.0 * round((b - longitude_deg) / 360.0)) for a, b in corners_deg)


def _areas(fence: Fence, origin_deg: Vec3 | None) -> tuple[Any, Any]:
    """The area to stay in, `HOLD_OFF_M` inside its edge, and what is left of it without the zones to stay out of.

    Both are None without an area to stay in. They are None too where some zones are in degrees, others in metres, and
    the origin, which places both on one map, isn't known.
    """
    corners_deg = [zone.corners_deg for zone in fence.zones if zone.corners_deg]
    if origin_deg is None and corners_deg and len(corners_deg) == len(fence.zones):
        origin_deg = (*corners_deg[0][0], 0.0)
    whole = placed(fence, origin_deg)
    if whole is None or whole.keep_in is None:
        return None, None
    inside = Polygon(whole.keep_in.corners_ned_m).buffer(-HOLD_OFF_M)
    outside = [Polygon(zone.corners_ned_m).buffer(HOLD_OFF_M) for zone in whole.keep_out]
    return inside, inside.difference(shapely.unary_union(outside))


def _polygon(zone: Zone) -> Polygon:
    """A zone in metres, north before east; one in degrees around its first corner."""
    if not zone.corners_deg:
        return Polygon(zone.corners_ned_m)
    first: Vec3 = (*zone.corners_deg[0], 0.0)
    return Polygon([ned_from_geodetic((*corner, 0.0), first)[:2] for corner in zone.corners_deg])


def _place(zone: Zone, north_m: float, east_m: float) -> str:
    if not zone.corners_deg:
        return f"north {north_m:.1f} m, east {east_m:.1f} m"
    latitude, longitude = zone.corners_deg[0]
    return f"{north_m:.1f} m north and {east_m:.1f} m east of its first corner, {latitude:.6f}, {longitude:.6f}"


def _far(zone: Zone, origin_deg: Vec3 | None) -> str:
    """Why a zone in degrees is at no place where the vehicle can be, or ""."""
    if origin_deg is None or not zone.corners_deg:
        return ""
    away_m = _nearest_m(zone.corners_deg, origin_deg)
    if away_m < FAR_M:
        return ""
    exchanged = [(longitude, latitude) for latitude, longitude in zone.corners_deg if abs(longitude) <= 90.0]
    if exchanged and _nearest_m(exchanged, origin_deg) < FAR_M:
        return "latitude and longitude are exchanged: write [latitude, longitude]"
    return f"it is {away_m / 1000.0:.0f} km from the vehicle's origin"


def _nearest_m(corners_deg: Sequence[tuple[float, float]], origin_deg: Vec3) -> float:
    places = (ned_from_geodetic((*corner, origin_deg[2]), origin_deg) for corner in corners_deg)
    return min(hypot(place[0], place[1]) for place in places)
