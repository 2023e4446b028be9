"""Walls in front of which a flight by velocity stops: the fence, the vehicle's limits, and the ground.

The bridge holds the fence too, nearer to it. The reference stops earlier, so that the vehicle needs no such help and
no setpoint leads through a wall. Source: stopping distance v²/2a.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, sqrt

from jezero.base.fence import edges
from jezero.base.frames import Vec3, altitude_m, dot, horizontal, scale, subtract
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.schemas.fence import Fence

HOLD_OFF_M = 1.0
"""Distance from the fence at which the reference stops: that of planned ways, and as much for the vehicle's overshoot
in a gust."""
BRAKING_PART = 0.8
"""Part of the acceleration with which the reference brakes in front of a wall; the rest turns the velocity."""
ROUNDS = 2
"""Number of times that all walls are applied: in a corner, one wall can lead towards another one."""
NOTICED_MPS = 0.05
"""A wall that takes away less speed than this is not named."""


@dataclass(frozen=True)
class ReferenceWall:
    """A wall near the reference.

    Attributes:
        out_ned: (3,) unit vector towards the forbidden side.
        room_m: distance that the reference may still go; negative beyond.
        name: the wall, for people.
    """

    out_ned: Vec3
    room_m: float
    name: str


def walls(
    pos_ned_m: Vec3, reach_m: float, fence: Fence | None, limits: VehicleLimitsConfig, z_low_ned_m: float, low_name: str
) -> Iterator[ReferenceWall]:
    """The walls within reach of a point.

    Args:
        pos_ned_m: (3,) point, in the autopilot's present frame.
        fence: the fence, its zones in metres; None for none.
        z_low_ned_m: z of the lowest place that the point may go to.
        low_name: what is there, for people.
    """
    down_m, up_m = z_low_ned_m - pos_ned_m[2], altitude_m(pos_ned_m[2])
    yield ReferenceWall((0.0, 0.0, 1.0), down_m, low_name)
    yield ReferenceWall(
        (0.0, 0.0, -1.0), limits.altitude_max_m - up_m, f"the greatest height of {limits.altitude_max_m:g} m"
    )
    away_m = horizontal(pos_ned_m)
    if away_m > 1.0:
        out_ned = (pos_ned_m[0] / away_m, pos_ned_m[1] / away_m, 0.0)
        yield ReferenceWall(
            out_ned, limits.distance_max_m - away_m, f"the greatest distance of {limits.distance_max_m:g} m"
        )
    if fence is None:
        return
    if fence.ceiling_m is not None:
        yield ReferenceWall(
            (0.0, 0.0, -1.0), fence.ceiling_m - up_m - HOLD_OFF_M, f"the ceiling of {fence.ceiling_m:g} m"
        )
    for edge in edges(fence, pos_ned_m, reach_m + HOLD_OFF_M):
        north_m, east_m = edge.nearest_m[0] - pos_ned_m[0], edge.nearest_m[1] - pos_ned_m[1]
        length_m = hypot(north_m, east_m)
        if length_m > 1e-6:
            sign = 1.0 if edge.inside_m >= 0.0 else -1.0
            out_ned = (sign * north_m / length_m, sign * east_m / length_m, 0.0)
            yield ReferenceWall(out_ned, edge.inside_m - HOLD_OFF_M, edge.in_words)


def held_back(vel_ned_mps: Vec3, near: list[ReferenceWall], accel_mps2: float) -> tuple[Vec3, str]:
    """The velocity from which the reference stops in front of all walls, and the name of one that limits it, or ""."""
    vel, name = vel_ned_mps, ""
    for _ in range(ROUNDS):
        for wall in near:
            out_max_mps = sqrt(2.0 * BRAKING_PART * accel_mps2 * max(wall.room_m, 0.0))
            excess_mps = dot(vel, wall.out_ned) - out_max_mps
            if excess_mps > 0.0:
                vel = subtract(vel, scale(wall.out_ned, excess_mps))
                name = wall.name if excess_mps > NOTICED_MPS else name
    return vel, name
