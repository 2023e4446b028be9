"""Limit of a target so that it can't carry the vehicle through the fence. Source: stopping distance v²/2a."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import hypot, sqrt

from msgspec.structs import replace

from jezero.fence import Edge, edges
from jezero.frames import Vec3, add, altitude_m, dot, norm, scale, subtract
from jezero.schemas.fence import Fence
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot

EDGE_M = 0.4
"""Targets keep this far inside the fence: less than planned ways do, so that a goal's tracking errors meet no limit."""
BRAKING_MPS2 = 1.0
"""Deceleration in front of the fence: that of planned ways, and less than the 1.3 m/s² that the greatest tilt leaves in
gusts of 11 m/s."""
PULL_1PS = 1.0
"""Speed per distance of a target's point that the autopilot may make of it. Source: PX4's MPC_XY_P is 0.95."""
ROUNDS = 2
"""Number of times that the limits of all walls are applied: in a corner, the limit of one wall can lead towards another
wall."""
TOO_FAST_MPS = 0.2
"""Excess of speed towards a wall from which on all of the vehicle's tilt serves to brake."""
ZERO: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Wall:
    """A part of the fence near the vehicle.

    Attributes:
        out_ned: (3,) unit vector from the vehicle's position towards the forbidden side.
        distance_m: distance to it, negative for a vehicle on the forbidden side.
        name: the wall, for people.
        edge: edge of a zone; None for ceiling, floor and limits, which have no end.
    """

    out_ned: Vec3
    distance_m: float
    name: str
    edge: Edge | None = None

    @property
    def room_m(self) -> float:
        """Distance that a target may lead towards the wall; negative where it must lead away, 0 outside the fence."""
        return 0.0 if self.distance_m < 0.0 else self.distance_m - EDGE_M

    @property
    def speed_max_mps(self) -> float:
        """Greatest speed towards the wall from which the vehicle stops in front of it."""
        return sqrt(2.0 * BRAKING_MPS2 * self.room_m) if self.room_m > 0.0 else PULL_1PS * self.room_m

    def is_met(self, begin_ned_m: Vec3, way_ned_m: Vec3) -> bool:
        """Whether a straight way comes too near."""
        if self.edge is None or self.distance_m < EDGE_M:
            return True
        end_ned_m = add(begin_ned_m, way_ned_m)
        return self.edge.distance_to_way_m(begin_ned_m, end_ned_m) < EDGE_M


def limited_target(
    fence: Fence | None,
    target: Target,
    vehicle: VehicleSnapshot,
    *,
    floor_holds: bool,
    limits: Callable[[VehicleSnapshot, Vec3, float], Iterable[Wall]] = lambda vehicle, pos_ned_m, reach_m: (),
) -> tuple[Target, str]:
    """Target that leads no farther and no faster than to the fence and to the vehicle's limits.

    Args:
        fence: the fence; None for none.
        floor_holds: the fence's floor over ground holds now.
        limits: gives the vehicle's limits within reach as walls.

    Returns:
        The same target if it needs no limit, and the name of the wall that limits it, or "".
    """
    pos_ned_m, limiting = vehicle.pos_ned_m, ""
    if pos_ned_m is None:
        return target, ""
    vel, lead = target.vel_ned_mps, None if target.pos_ned_m is None else subtract(target.pos_ned_m, pos_ned_m)
    speed_mps = max(norm(vel or ZERO), norm(vehicle.vel_ned_mps))
    reach_m = EDGE_M + max(norm(lead or ZERO), speed_mps * speed_mps / (2.0 * BRAKING_MPS2))
    walls = list(limits(vehicle, pos_ned_m, reach_m))
    if fence is not None:
        walls += _walls(fence, vehicle, pos_ned_m, reach_m, floor_holds=floor_holds)
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


def _is_too_fast(wall: Wall, vehicle: VehicleSnapshot, pos_ned_m: Vec3) -> bool:
    excess_mps = dot(vehicle.vel_ned_mps, wall.out_ned) - wall.speed_max_mps
    way_ned_m = _stopping_way(vehicle.vel_ned_mps, norm(vehicle.vel_ned_mps))
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
    ways = (_stopping_way(vel, speed_mps) for vel in (vel_ned_mps, vehicle.vel_ned_mps))
    if not any(wall.is_met(pos_ned_m, way) for way in ways):
        return vel_ned_mps
    pull_mps = 0.0 if lead_ned_m is None else max(0.0, PULL_1PS * dot(lead_ned_m, wall.out_ned))
    return _limited(vel_ned_mps, wall, wall.speed_max_mps - pull_mps)


def _stopping_way(vel_ned_mps: Vec3, speed_mps: float) -> Vec3:
    """Way until the vehicle stops from a speed, in the direction of a velocity."""
    length = norm(vel_ned_mps)
    return scale(vel_ned_mps, speed_mps * speed_mps / (2.0 * BRAKING_MPS2 * length)) if length > 1e-6 else ZERO


def _limited(v_ned: Vec3, wall: Wall, out_max: float) -> Vec3:
    """A vector whose part towards a wall is at most `out_max`."""
    excess = dot(v_ned, wall.out_ned) - out_max
    return v_ned if excess <= 1e-3 else subtract(v_ned, scale(wall.out_ned, excess))


def _walls(
    fence: Fence, vehicle: VehicleSnapshot, pos_ned_m: Vec3, reach_m: float, *, floor_holds: bool
) -> Iterator[Wall]:
    """All walls that the vehicle may meet."""
    for edge in edges(fence, pos_ned_m, reach_m):
        north_m, east_m = edge.nearest_m[0] - pos_ned_m[0], edge.nearest_m[1] - pos_ned_m[1]
        length_m = hypot(north_m, east_m)
        sign = 1.0 if edge.inside_m >= 0.0 else -1.0
        if length_m > 1e-6:
            out_ned = (sign * north_m / length_m, sign * east_m / length_m, 0.0)
            yield Wall(out_ned, edge.inside_m, edge.in_words, edge)
    if fence.ceiling_m is not None:
        below_m = fence.ceiling_m - altitude_m(pos_ned_m[2])
        yield Wall((0.0, 0.0, -1.0), below_m, f"the ceiling of {fence.ceiling_m:g} m")
    if floor_holds and fence.floor_over_ground_m > 0.0 and vehicle.height_m is not None:
        above_m = max(vehicle.height_m - fence.floor_over_ground_m, 0.0) + EDGE_M
        yield Wall((0.0, 0.0, 1.0), above_m, f"the floor of {fence.floor_over_ground_m:g} m")
