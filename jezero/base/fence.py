"""The geometry of a fence: distances to its edges, ways that leave it, and shapes in which nothing can fly.

First what is needed in flight, with zones in metres and plain numbers. Then the judgement of a fence before it is in
force, whose shapes may be in degrees; it alone needs shapely, which takes half a second to import.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, dist, hypot, inf, sin
from typing import Any

from msgspec.structs import replace

from jezero.base.frames import Vec3, altitude_m, ned_from_geodetic, z_ned_m
from jezero.schemas.fence import Fence, Zone

Point = tuple[float, float]
HOLD_OFF_M = 0.5
"""Least distance from the fence that goals keep inside."""
ROUNDING_M = 1e-6
"""Places exactly at a limit are within it, whatever the rounding."""
STEP_M = 0.1
"""A way is checked at points this far apart: it may cut a corner by a twentieth of a metre less than `HOLD_OFF_M`."""
STEPS_MAX = 20_000
INWARD_STEPS = 20
SIZE_MIN_M, AREA_MIN_M2 = 1.0, 0.01
"""Smallest diagonal and area of a zone; a smaller one is a mistake."""
FAR_M = 50_000.0
"""Distance from the vehicle's origin at which no fence is of use."""


# -- distances -------------------------------------------------------------------------------------------


def placed(fence: Fence, origin_deg: Vec3 | None) -> Fence | None:
    """The fence with all its zones in metres; None while the origin that places degrees is unknown."""
    if not any(zone.corners_deg for zone in fence.zones):
        return fence
    if origin_deg is None:
        return None

    def placed_zone(zone: Zone) -> Zone:
        if not zone.corners_deg:
            return zone
        corners = (ned_from_geodetic((*corner_deg, origin_deg[2]), origin_deg)[:2] for corner_deg in zone.corners_deg)
        return Zone(name=zone.name, corners_ned_m=tuple(corners))

    keep_in = None if fence.keep_in is None else placed_zone(fence.keep_in)
    return replace(fence, keep_in=keep_in, keep_out=tuple(placed_zone(zone) for zone in fence.keep_out))


@dataclass(frozen=True)
class Edge:
    """One edge of a zone, seen from a point.

    Attributes:
        begin_m: north and east of one end.
        end_m: north and east of the other end.
        nearest_m: north and east of its point that is nearest to the point.
        inside_m: distance to it; negative when the point is on the forbidden side of the zone.
        zone: the zone.
        keep_in: the zone is the one to stay in.
    """

    begin_m: Point
    end_m: Point
    nearest_m: Point
    inside_m: float
    zone: Zone
    keep_in: bool

    @property
    def in_words(self) -> str:
        """The zone, for people."""
        return (
            f"the area {self.zone.name!r} to stay in" if self.keep_in else f"the zone {self.zone.name!r} to stay out of"
        )

    def distance_to_way_m(self, begin_m: Sequence[float], end_m: Sequence[float]) -> float:
        """Distance between this edge and a straight way, on the map."""
        way_begin, way_end = (begin_m[0], begin_m[1]), (end_m[0], end_m[1])
        if _cross(way_begin, way_end, self.begin_m, self.end_m):
            return 0.0
        return min(
            dist(way_begin, _nearest_point(way_begin, self.begin_m, self.end_m)),
            dist(way_end, _nearest_point(way_end, self.begin_m, self.end_m)),
            dist(self.begin_m, _nearest_point(self.begin_m, way_begin, way_end)),
            dist(self.end_m, _nearest_point(self.end_m, way_begin, way_end)),
        )


def _nearest_point(point_m: Point, begin_m: Point, end_m: Point) -> Point:
    """Nearest point of a line from `begin_m` to `end_m`."""
    d_north, d_east = end_m[0] - begin_m[0], end_m[1] - begin_m[1]
    length2 = d_north * d_north + d_east * d_east
    along = ((point_m[0] - begin_m[0]) * d_north + (point_m[1] - begin_m[1]) * d_east) / length2 if length2 else 0.0
    along = min(max(along, 0.0), 1.0)
    return (begin_m[0] + along * d_north, begin_m[1] + along * d_east)


def _cross(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether the lines from `a` to `b` and from `c` to `d` cross."""

    def side(p: Point, q: Point, r: Point) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0


def edges(fence: Fence, point_m: Sequence[float], reach_m: float = inf) -> Iterator[Edge]:
    """The edges of the zones within reach; of a zone that the point violates, the nearest edge alone.

    Args:
        point_m: north and east; further numbers are not used.
        reach_m: greatest distance of an edge from the point.
    """
    for zone in fence.zones:
        keep_in = zone is fence.keep_in
        away_m, near, within = _distances(zone, (point_m[0], point_m[1]))
        if within is keep_in:
            yield from (
                _edge(zone, index, near[index], each_m, keep_in=keep_in)
                for index, each_m in enumerate(away_m)
                if each_m <= reach_m
            )
        else:
            index = away_m.index(min(away_m))
            yield _edge(zone, index, near[index], -away_m[index], keep_in=keep_in)


def nearest(fence: Fence, point_m: Sequence[float]) -> Edge | None:
    """The nearest edge, or where zones are violated that of the zone that is violated most; None without zones.

    Args:
        point_m: north and east; further numbers are not used.
    """
    found: Edge | None = None
    for zone in fence.zones:
        keep_in = zone is fence.keep_in
        away_m, near, within = _distances(zone, (point_m[0], point_m[1]))
        index = away_m.index(min(away_m))
        inside_m = away_m[index] if within is keep_in else -away_m[index]
        if found is None or inside_m < found.inside_m:
            found = _edge(zone, index, near[index], inside_m, keep_in=keep_in)
    return found


def _edge(zone: Zone, index: int, near: Point, inside_m: float, *, keep_in: bool) -> Edge:
    corners = zone.corners_ned_m
    return Edge(corners[index - 1], corners[index], near, inside_m, zone, keep_in)


def _distances(zone: Zone, point_m: Point) -> tuple[list[float], list[Point], bool]:
    """Distance to each edge and its nearest point, and whether the point is within the polygon.

    Edge i leads from corner i - 1 to corner i. Plain numbers: the bridge needs this in each step.
    """
    north_m, east_m = point_m
    within = False
    away_m: list[float] = []
    near: list[Point] = []
    corners = zone.corners_ned_m
    a_north, a_east = corners[-1]
    for b_north, b_east in corners:
        d_north, d_east = b_north - a_north, b_east - a_east
        length2 = d_north * d_north + d_east * d_east
        along = ((north_m - a_north) * d_north + (east_m - a_east) * d_east) / length2 if length2 else 0.0
        along = 0.0 if along < 0.0 else min(along, 1.0)
        near_north, near_east = a_north + along * d_north, a_east + along * d_east
        near.append((near_north, near_east))
        away_m.append(hypot(north_m - near_north, east_m - near_east))
        if (a_east > east_m) != (b_east > east_m) and north_m < a_north + (east_m - a_east) / d_east * d_north:
            within = not within
        a_north, a_east = b_north, b_east
    return away_m, near, within


# -- places and ways -------------------------------------------------------------------------------------


def outside_reason(fence: Fence, pos_ned_m: Vec3, margin_m: float = 0.0) -> str:
    """Where and how far a position is outside, for people; "" inside.

    Args:
        margin_m: distance from edges and ceiling that a position inside must have.
    """
    at, up_m = nearest(fence, pos_ned_m), altitude_m(pos_ned_m[2])
    place = f"at north {pos_ned_m[0]:.1f} m, east {pos_ned_m[1]:.1f} m, {up_m:.1f} m up"
    if at is not None and at.inside_m < margin_m:
        side = "outside" if at.keep_in else "inside"
        return f"{-at.inside_m:.1f} m {side} {at.in_words}, {place}"
    if fence.ceiling_m is not None and up_m > fence.ceiling_m - margin_m:
        return f"{up_m - fence.ceiling_m:.1f} m above the ceiling of {fence.ceiling_m:g} m, {place}"
    return ""


def point_inside(fence: Fence, pos_ned_m: Vec3, inside_m: float) -> Vec3:
    """The point nearest to a position that is `inside_m` within the fence; less where the fence is narrow."""
    point: Vec3 = pos_ned_m
    if fence.ceiling_m is not None:
        point = (point[0], point[1], max(point[2], z_ned_m(fence.ceiling_m - inside_m)))
    for number in range(INWARD_STEPS):
        at = nearest(fence, point)
        if at is None or at.inside_m >= inside_m - 1e-3:
            break
        if abs(at.inside_m) < 1e-6:  # The point is on the outline. From a point beside it the direction is known.
            point = (point[0] + 1e-3 * cos(number), point[1] + 1e-3 * sin(number), point[2])
            continue
        step = (inside_m - at.inside_m) / at.inside_m
        north_m, east_m = point[0] - at.nearest_m[0], point[1] - at.nearest_m[1]
        point = (point[0] + step * north_m, point[1] + step * east_m, point[2])
    return point


def place_refusal(fence: Fence, pos_ned_m: Vec3, *, low_allowed: bool) -> str:
    """Reason why no goal leads to a place, or ""."""
    if reason := outside_reason(fence, pos_ned_m):
        return reason
    at, up_m = nearest(fence, pos_ned_m), altitude_m(pos_ned_m[2])
    place = f"at north {pos_ned_m[0]:.1f} m, east {pos_ned_m[1]:.1f} m"
    if at is not None and at.inside_m < HOLD_OFF_M - ROUNDING_M:
        return f"it comes within {HOLD_OFF_M:g} m of the edge of {at.in_words}, {place}"
    if fence.ceiling_m is not None and up_m > fence.ceiling_m - HOLD_OFF_M + ROUNDING_M:
        return f"{up_m:.1f} m up is within {HOLD_OFF_M:g} m of the ceiling of {fence.ceiling_m:g} m, {place}"
    if not low_allowed and up_m < fence.floor_over_ground_m - ROUNDING_M:
        return f"{up_m:.1f} m up is below the floor of {fence.floor_over_ground_m:g} m, {place}"
    return ""


def way_refusal(fence: Fence, way_ned_m: Sequence[Vec3], *, from_ground: bool, to_ground: bool) -> str:
    """Reason why a way leaves the fence, with the first place where it does; "" for a way that stays inside.

    A way that begins outside may lead in, on the condition that it then stays there.

    Args:
        way_ned_m: corners of the way; empty for an unknown one, which is not judged.
        from_ground: the first leg is a takeoff, which may be below the floor.
        to_ground: the last leg is a landing, which may be below the floor.
    """
    legs = list(pairwise(way_ned_m))
    entered = bool(way_ned_m) and not outside_reason(fence, way_ned_m[0])
    for index, (begin, end) in enumerate(legs):
        low_allowed = (from_ground and index == 0) or (to_ground and index == len(legs) - 1)
        for pos_ned_m in _points(begin, end):
            reason = place_refusal(fence, pos_ned_m, low_allowed=low_allowed)
            if reason and entered:
                return f"the way leaves the fence {fence.name!r}: {reason}"
            entered |= not reason
    if legs and not entered:
        return f"the way is outside the fence {fence.name!r}: {place_refusal(fence, legs[-1][1], low_allowed=True)}"
    return ""


def _points(begin: Vec3, end: Vec3) -> Iterator[Vec3]:
    length_m = hypot(end[0] - begin[0], end[1] - begin[1], end[2] - begin[2])
    steps = min(max(int(length_m / STEP_M), 1), STEPS_MAX)
    for index in range(1, steps + 1):
        part = index / steps
        yield (
            begin[0] + part * (end[0] - begin[0]),
            begin[1] + part * (end[1] - begin[1]),
            begin[2] + part * (end[2] - begin[2]),
        )


# -- judgement before a fence is in force ----------------------------------------------------------------


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
    if free is None or free.geom_type != "MultiPolygon":
        return ()
    sizes = ", ".join(f"{area_m2:.0f} m²" for area_m2 in sorted((part.area for part in free.geoms), reverse=True))
    return (f"the area to stay in falls into {len(free.geoms)} parts, between which nothing can fly: {sizes}",)


def _areas(fence: Fence, origin_deg: Vec3 | None) -> tuple[Any, Any]:
    """The area to stay in, `HOLD_OFF_M` inside its edge, and what is left of it without the zones to stay out of.

    Both are None without an area to stay in. They are None too where some zones are in degrees, others in metres, and
    the origin, which places both on one map, isn't known.
    """
    import shapely

    corners_deg = [zone.corners_deg for zone in fence.zones if zone.corners_deg]
    if origin_deg is None and corners_deg and len(corners_deg) == len(fence.zones):
        origin_deg = (*corners_deg[0][0], 0.0)
    whole = placed(fence, origin_deg)
    if whole is None or whole.keep_in is None:
        return None, None
    inside = shapely.Polygon(whole.keep_in.corners_ned_m).buffer(-HOLD_OFF_M)
    outside = [shapely.Polygon(zone.corners_ned_m).buffer(HOLD_OFF_M) for zone in whole.keep_out]
    return inside, inside.difference(shapely.unary_union(outside))


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


def zone_refusal(zone: Zone) -> str:
    """What is wrong with the shape of a zone, for people, or ""."""
    import shapely

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


def _place(zone: Zone, north_m: float, east_m: float) -> str:
    if not zone.corners_deg:
        return f"north {north_m:.1f} m, east {east_m:.1f} m"
    latitude, longitude = zone.corners_deg[0]
    return f"{north_m:.1f} m north and {east_m:.1f} m east of its first corner, {latitude:.6f}, {longitude:.6f}"


def _polygon(zone: Zone) -> Any:
    """A zone in metres, north before east; one in degrees around its first corner."""
    import shapely

    if not zone.corners_deg:
        return shapely.Polygon(zone.corners_ned_m)
    first: Vec3 = (*zone.corners_deg[0], 0.0)
    return shapely.Polygon([ned_from_geodetic((*corner, 0.0), first)[:2] for corner in zone.corners_deg])


class JoinError(ValueError):
    """Several areas to stay in are not one; the text says why, for people."""


def joined(zones: Sequence[Zone]) -> Zone:
    """Several areas to stay in as one.

    Raises:
        JoinError: they are not one.
    """
    if len(zones) == 1:
        return zones[0]
    import shapely

    in_degrees = {bool(zone.corners_deg) for zone in zones}
    if len(in_degrees) > 1:
        raise JoinError("some areas to stay in are in degrees and others in metres: write all in the same")
    for zone in zones:
        if reason := zone_refusal(zone):
            raise JoinError(f"{zone.name!r}: {reason}")
    first_deg = zones[0].corners_deg[0][1] if True in in_degrees else 0.0
    areas = [shapely.Polygon(_turned(zone.corners_deg, first_deg) or zone.corners_ned_m) for zone in zones]
    shape = shapely.unary_union(areas)
    if not isinstance(shape, shapely.Polygon):
        raise JoinError(f"the {len(zones)} areas to stay in don't touch: give one area, or let them overlap")
    if shape.interiors:
        advice = "join them to one, and write the hole as a zone to stay out of"
        raise JoinError(f"the areas to stay in surround a hole: {advice}")
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
