"""Limits of a target: it can't carry the vehicle through the fence, nor beyond its height, distance and speed.

The limits hold whoever sends setpoints; goals keep within them by plan. The fence, the greatest height and the greatest
distance are walls, in front of which the vehicle must be able to stop. Source: stopping distance v²/2a.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, sqrt

from msgspec.structs import replace

from jezero.base.fence import Edge, edges
from jezero.base.frames import Vec3, add, altitude_m, dot, horizontal, norm, scale, subtract
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.schemas.fence import Fence
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot

EDGE_M = 0.4
"""Targets keep this far inside the fence: less than planned ways do, so that a goal's tracking errors meet no limit."""
PULL_1PS = 1.0
"""Speed per distance of a target's point that the autopilot may make of it. Source: PX4's MPC_XY_P is 0.95."""
INWARD_MAX_MPS = 1.0
"""Greatest speed at which a goal that began outside the fence is led in."""
ROUNDS = 2
"""Number of times that the limits of all walls are applied: in a corner, the limit of one wall can lead towards another
wall."""
TOO_FAST_MPS = 0.2
"""Excess of speed towards a wall from which on all of the vehicle's tilt serves to brake."""
MARGIN_M = 2.0
"""Targets may lead this far beyond the greatest height and distance, so that a goal that ends there is not held
back."""
SPEED_MARGIN_MPS = 2.0
"""Excess over the greatest speed of a goal, for corrections and for the motion of the rover."""
ACCELERATION_MAX_MPS2 = 10.0
"""Greatest feed-forward, beyond the tilt of any multicopter that flies on."""
ZERO: Vec3 = (0.0, 0.0, 0.0)


def limited_target(
    fence: Fence | None, limits: VehicleLimitsConfig, target: Target, vehicle: VehicleSnapshot, *, floor_holds: bool
) -> tuple[Target, str]:
    """Target that leads no farther and no faster than to the fence and to the vehicle's limits.

    Args:
        fence: the fence, its zones in metres; None for none.
        floor_holds: the fence's floor over ground holds now.

    Returns:
        The same target if it needs no limit, and the name of the wall or limit that limits it, or "".
    """
    target, slowed = slowed_target(limits, target)
    target, brought_near = _near_target(limits, target, vehicle)
    target, held_back = _held_back_target(fence, limits, target, vehicle, floor_holds=floor_holds)
    return target, held_back or brought_near or slowed


def inward_target(target: Target, pos_ned_m: Vec3, inside_ned_m: Vec3) -> Target:
    """Target that leads a vehicle outside the fence inside, whatever else it leads to.

    Args:
        pos_ned_m: the vehicle's position, outside.
        inside_ned_m: point inside to which the vehicle shall fly.

    Returns:
        The same target if it leads to the point fast enough by itself.
    """
    way_ned_m = subtract(inside_ned_m, pos_ned_m)
    if (away_m := norm(way_ned_m)) < 1e-6:
        return target
    in_ned = scale(way_ned_m, 1.0 / away_m)
    lead_ned_m = ZERO if target.pos_ned_m is None else subtract(target.pos_ned_m, pos_ned_m)
    speed_mps = dot(target.vel_ned_mps or ZERO, in_ned) + PULL_1PS * dot(lead_ned_m, in_ned)
    missing_mps = min(INWARD_MAX_MPS, PULL_1PS * away_m) - speed_mps
    if missing_mps <= 1e-3:
        return target
    if target.pos_ned_m is None:
        return replace(target, vel_ned_mps=add(target.vel_ned_mps or ZERO, scale(in_ned, missing_mps)))
    return replace(target, pos_ned_m=add(target.pos_ned_m, scale(in_ned, missing_mps / PULL_1PS)))


# -- speed and distance ----------------------------------------------------------------------------------


def slowed_target(limits: VehicleLimitsConfig, target: Target) -> tuple[Target, str]:
    """Target whose velocity and acceleration are no greater than the vehicle may have, and the limit's name or ""."""
    speed_max_mps = limits.speed_max_mps + SPEED_MARGIN_MPS
    vel = _shortened(target.vel_ned_mps, speed_max_mps)
    acc = _shortened(target.acc_ned_mps2, ACCELERATION_MAX_MPS2)
    if vel is target.vel_ned_mps and acc is target.acc_ned_mps2:
        return target, ""
    return replace(target, vel_ned_mps=vel, acc_ned_mps2=acc), f"the greatest speed of {limits.speed_max_mps:g} m/s"


def _shortened(v_ned: Vec3 | None, length_max: float) -> Vec3 | None:
    if v_ned is None or (length := norm(v_ned)) <= length_max:
        return v_ned
    return scale(v_ned, length_max / length)


def _near_target(limits: VehicleLimitsConfig, target: Target, vehicle: VehicleSnapshot) -> tuple[Target, str]:
    """Target with a point within the greatest distance, or no farther than the vehicle is; and the limit's name or "".

    The greatest distance is a wall only in the vehicle's own direction, and does not stop a point far away to its side.
    """
    point, pos_ned_m = target.pos_ned_m, vehicle.pos_ned_m
    if point is None or pos_ned_m is None:
        return target, ""
    away_m, away_max_m = horizontal(point), max(limits.distance_max_m + MARGIN_M, horizontal(pos_ned_m))
    if away_m <= away_max_m:
        return target, ""
    part = away_max_m / away_m
    return replace(target, pos_ned_m=(part * point[0], part * point[1], point[2])), _distance_name(limits)


def _distance_name(limits: VehicleLimitsConfig) -> str:
    return f"the greatest distance of {limits.distance_max_m:g} m"


# -- walls -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Wall:
    """A part of the fence or of the vehicle's limits near the vehicle.

    Attributes:
        out_ned: (3,) unit vector from the vehicle's position towards the forbidden side.
        distance_m: distance to it, negative for a vehicle on the forbidden side.
        braking_mps2: deceleration in front of it.
        name: the wall, for people.
        edge: edge of a zone; None for ceiling, floor and limits, which have no end.
    """

    out_ned: Vec3
    distance_m: float
    braking_mps2: float
    name: str
    edge: Edge | None = None

    @property
    def room_m(self) -> float:
        """Distance that a target may lead towards the wall; negative where it must lead away, 0 outside the fence."""
        return 0.0 if self.distance_m < 0.0 else self.distance_m - EDGE_M

    @property
    def speed_max_mps(self) -> float:
        """Greatest speed towards the wall from which the vehicle stops in front of it."""
        return sqrt(2.0 * self.braking_mps2 * self.room_m) if self.room_m > 0.0 else PULL_1PS * self.room_m

    def is_met(self, begin_ned_m: Vec3, way_ned_m: Vec3) -> bool:
        """Whether a straight way comes too near."""
        if self.edge is None or self.distance_m < EDGE_M:
            return True
        end_ned_m = add(begin_ned_m, way_ned_m)
        return self.edge.distance_to_way_m(begin_ned_m, end_ned_m) < EDGE_M


def _held_back_target(
    fence: Fence | None, limits: VehicleLimitsConfig, target: Target, vehicle: VehicleSnapshot, *, floor_holds: bool
) -> tuple[Target, str]:
    """Target that stops in front of all walls, and the name of the wall that holds it back, or ""."""
    pos_ned_m, limiting = vehicle.pos_ned_m, ""
    if pos_ned_m is None:
        return target, ""
    vel, lead = target.vel_ned_mps, None if target.pos_ned_m is None else subtract(target.pos_ned_m, pos_ned_m)
    speed_mps = max(norm(vel or ZERO), norm(vehicle.vel_ned_mps))
    reach_m = EDGE_M + max(norm(lead or ZERO), speed_mps * speed_mps / (2.0 * limits.braking_mps2))
    walls = list(_limit_walls(limits, vehicle, pos_ned_m, reach_m))
    if fence is not None:
        walls += _fence_walls(fence, limits.braking_mps2, vehicle, pos_ned_m, reach_m, floor_holds=floor_holds)
    for wall in walls:
        if _is_too_fast(wall, vehicle, pos_ned_m):
            vel, lead, limiting = *_braking(vel, lead, wall, vehicle), wall.name
    for _ in range(ROUNDS):
        for wall in walls:
            new_lead = lead if lead is None else _limited_lead(lead, wall, pos_ned_m)
            new_vel = vel if vel is None else _limited_velocity(vel, new_lead, wall, vehicle, pos_ned_m)
            if new_lead is not lead or new_vel is not vel:
                limiting = limiting or wall.name
            lead, vel = new_lead, new_vel
    if not limiting:
        return target, ""
    point = None if lead is None else add(pos_ned_m, lead)
    return replace(target, pos_ned_m=point, vel_ned_mps=vel, acc_ned_mps2=None), limiting


def _limit_walls(
    limits: VehicleLimitsConfig, vehicle: VehicleSnapshot, pos_ned_m: Vec3, reach_m: float
) -> Iterator[Wall]:
    """The limits of height and distance as walls, those within reach.

    The height of a takeoff counts from the take-off point.
    """
    from_m = 0.0 if vehicle.takeoff_ned_m is None else max(0.0, altitude_m(vehicle.takeoff_ned_m[2]))
    below_m = limits.altitude_max_m + from_m - altitude_m(pos_ned_m[2]) + MARGIN_M + EDGE_M
    if below_m <= reach_m:
        yield Wall(
            (0.0, 0.0, -1.0), below_m, limits.braking_mps2, f"the greatest height of {limits.altitude_max_m:g} m"
        )
    away_m = horizontal(pos_ned_m)
    room_m = limits.distance_max_m - away_m + MARGIN_M + EDGE_M
    if room_m <= reach_m and away_m > 1.0:
        yield Wall(
            (pos_ned_m[0] / away_m, pos_ned_m[1] / away_m, 0.0), room_m, limits.braking_mps2, _distance_name(limits)
        )


def _fence_walls(
    fence: Fence, braking_mps2: float, vehicle: VehicleSnapshot, pos_ned_m: Vec3, reach_m: float, *, floor_holds: bool
) -> Iterator[Wall]:
    """All walls of the fence that the vehicle may meet."""
    for edge in edges(fence, pos_ned_m, reach_m):
        north_m, east_m = edge.nearest_m[0] - pos_ned_m[0], edge.nearest_m[1] - pos_ned_m[1]
        length_m = hypot(north_m, east_m)
        sign = 1.0 if edge.inside_m >= 0.0 else -1.0
        if length_m > 1e-6:
            out_ned = (sign * north_m / length_m, sign * east_m / length_m, 0.0)
            yield Wall(out_ned, edge.inside_m, braking_mps2, edge.in_words, edge)
    if fence.ceiling_m is not None:
        below_m = fence.ceiling_m - altitude_m(pos_ned_m[2])
        yield Wall((0.0, 0.0, -1.0), below_m, braking_mps2, f"the ceiling of {fence.ceiling_m:g} m")
    if floor_holds and fence.floor_over_ground_m > 0.0 and vehicle.height_m is not None:
        above_m = max(vehicle.height_m - fence.floor_over_ground_m, 0.0) + EDGE_M
        yield Wall((0.0, 0.0, 1.0), above_m, braking_mps2, f"the floor of {fence.floor_over_ground_m:g} m")


def _is_too_fast(wall: Wall, vehicle: VehicleSnapshot, pos_ned_m: Vec3) -> bool:
    excess_mps = dot(vehicle.vel_ned_mps, wall.out_ned) - wall.speed_max_mps
    way_ned_m = _stopping_way(vehicle.vel_ned_mps, norm(vehicle.vel_ned_mps), wall.braking_mps2)
    return wall.edge is not None and excess_mps > TOO_FAST_MPS and wall.is_met(pos_ned_m, way_ned_m)


def _braking(vel: Vec3 | None, lead: Vec3 | None, wall: Wall, vehicle: VehicleSnapshot) -> tuple[Vec3, Vec3 | None]:
    """Velocity and lead that only brake: the speed along the wall stays, as its change would take tilt from braking."""
    out_n, out_e, _ = out = wall.out_ned
    wanted_mps = dot(vel or ZERO, out) + PULL_1PS * dot(lead or ZERO, out)
    change_mps = min(wall.speed_max_mps, wanted_mps) - dot(vehicle.vel_ned_mps, out)
    north_mps, east_mps, _ = vehicle.vel_ned_mps
    down_mps = 0.0 if vel is None else vel[2]
    braking = (north_mps + change_mps * out_n, east_mps + change_mps * out_e, down_mps)
    return braking, None if lead is None else (0.0, 0.0, lead[2])


def _limited_lead(lead_ned_m: Vec3, wall: Wall, pos_ned_m: Vec3) -> Vec3:
    lead_max_m = min(wall.room_m, wall.speed_max_mps / PULL_1PS)
    return _limited(lead_ned_m, wall, lead_max_m) if wall.is_met(pos_ned_m, lead_ned_m) else lead_ned_m


def _limited_velocity(
    vel_ned_mps: Vec3, lead_ned_m: Vec3 | None, wall: Wall, vehicle: VehicleSnapshot, pos_ned_m: Vec3
) -> Vec3:
    speed_mps = max(norm(vel_ned_mps), norm(vehicle.vel_ned_mps))
    ways = (_stopping_way(vel, speed_mps, wall.braking_mps2) for vel in (vel_ned_mps, vehicle.vel_ned_mps))
    if not any(wall.is_met(pos_ned_m, way) for way in ways):
        return vel_ned_mps
    pull_mps = 0.0 if lead_ned_m is None else max(0.0, PULL_1PS * dot(lead_ned_m, wall.out_ned))
    return _limited(vel_ned_mps, wall, wall.speed_max_mps - pull_mps)


def _limited(v_ned: Vec3, wall: Wall, out_max: float) -> Vec3:
    """A vector whose part towards a wall is at most `out_max`."""
    excess = dot(v_ned, wall.out_ned) - out_max
    return v_ned if excess <= 1e-3 else subtract(v_ned, scale(wall.out_ned, excess))


def _stopping_way(vel_ned_mps: Vec3, speed_mps: float, braking_mps2: float) -> Vec3:
    """Way until the vehicle stops from a speed, in the direction of a velocity."""
    length = norm(vel_ned_mps)
    return scale(vel_ned_mps, speed_mps * speed_mps / (2.0 * braking_mps2 * length)) if length > 1e-6 else ZERO
