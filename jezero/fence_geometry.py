"""Distances to a fence, and the first place where a way leaves it. Zones are in metres."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, inf

from msgspec.structs import replace

from jezero.frames import Vec3, altitude_m, ned_from_geodetic
from jezero.schemas.fence import Fence, Zone

Point = tuple[float, float]
HOLD_OFF_M = 0.5
"""Least distance from the fence that goals keep inside."""
STEP_M = 0.1
"""A way is checked at points this far apart: it may cut a corner by a twentieth of a metre less than `HOLD_OFF_M`."""
STEPS_MAX = 20_000


@dataclass(frozen=True)
class Nearest:
    """The nearest part of the outlines.

    Attributes:
        inside_m: distance to it, negative outside the fence.
        zone: its zone.
        keep_in: the zone is the one to stay in.
    """

    inside_m: float
    zone: Zone
    keep_in: bool

    @property
    def in_words(self) -> str:
        """The zone, for people."""
        return (
            f"the area {self.zone.name!r} to stay in" if self.keep_in else f"the zone {self.zone.name!r} to stay out of"
        )


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


def nearest(fence: Fence, point_m: Sequence[float]) -> Nearest | None:
    """The nearest outline, or where zones are violated the one that is violated most; None without zones.

    Args:
        point_m: north and east; further numbers are not used.
    """
    found: Nearest | None = None
    for zone in fence.zones:
        each = _nearest_of(zone, (point_m[0], point_m[1]), keep_in=zone is fence.keep_in)
        if found is None or each.inside_m < found.inside_m:
            found = each
    return found


def _nearest_of(zone: Zone, point_m: Point, *, keep_in: bool) -> Nearest:
    north_m, east_m = point_m
    best_m, within = inf, False
    corners = zone.corners_ned_m
    a_north, a_east = corners[-1]
    for b_north, b_east in corners:
        d_north, d_east = b_north - a_north, b_east - a_east
        length2 = d_north * d_north + d_east * d_east
        along = ((north_m - a_north) * d_north + (east_m - a_east) * d_east) / length2 if length2 > 0.0 else 0.0
        along = min(max(along, 0.0), 1.0)
        distance_m = hypot(north_m - a_north - along * d_north, east_m - a_east - along * d_east)
        best_m = min(best_m, distance_m)
        if (a_east > east_m) != (b_east > east_m) and north_m < a_north + (east_m - a_east) / d_east * d_north:
            within = not within
        a_north, a_east = b_north, b_east
    allowed = within is keep_in
    return Nearest(best_m if allowed else -best_m, zone, keep_in)


def outside_reason(fence: Fence, pos_ned_m: Vec3) -> str:
    """Where and how far a position is outside, for people; "" inside."""
    at = nearest(fence, pos_ned_m)
    place = f"at north {pos_ned_m[0]:.1f} m, east {pos_ned_m[1]:.1f} m, {altitude_m(pos_ned_m[2]):.1f} m up"
    if at is not None and at.inside_m < 0.0:
        side = "outside" if at.keep_in else "inside"
        return f"{-at.inside_m:.1f} m {side} {at.in_words}, {place}"
    if fence.ceiling_m is not None and altitude_m(pos_ned_m[2]) > fence.ceiling_m:
        return f"{altitude_m(pos_ned_m[2]) - fence.ceiling_m:.1f} m above the ceiling of {fence.ceiling_m:g} m, {place}"
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
            reason = _place_refusal(fence, pos_ned_m, low_allowed=low_allowed)
            if reason and entered:
                return f"the way leaves the fence {fence.name!r}: {reason}"
            entered |= not reason
    if legs and not entered:
        return f"the way is outside the fence {fence.name!r}: {_place_refusal(fence, legs[-1][1], low_allowed=True)}"
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


def _place_refusal(fence: Fence, pos_ned_m: Vec3, *, low_allowed: bool) -> str:
    """Reason why no goal leads to a place, or ""."""
    if reason := outside_reason(fence, pos_ned_m):
        return reason
    at, up_m = nearest(fence, pos_ned_m), altitude_m(pos_ned_m[2])
    place = f"at north {pos_ned_m[0]:.1f} m, east {pos_ned_m[1]:.1f} m"
    if at is not None and at.inside_m < HOLD_OFF_M - 1e-6:
        return f"it comes within {HOLD_OFF_M:g} m of the edge of {at.in_words}, {place}"
    if not low_allowed and up_m < fence.floor_over_ground_m - 1e-6:
        return f"{up_m:.1f} m up is below the floor of {fence.floor_over_ground_m:g} m, {place}"
    return ""
