"""The vehicle's limits of height, distance and speed, held whoever sends setpoints. Goals keep within them by plan."""

from collections.abc import Iterator

from msgspec.structs import replace

from jezero.frames import Vec3, altitude_m, horizontal, norm, scale
from jezero.services.vehicle_bridge.fence_limit import EDGE_M, Wall
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot
from jezero.vehicle_config import VehicleLimitsConfig

MARGIN_M = 2.0
"""Targets may lead this far beyond a limit, so that a goal that ends at the limit is not held back."""
SPEED_MARGIN_MPS = 2.0
"""Excess over the greatest speed of a goal, for corrections and for the motion of the rover."""
ACCELERATION_MAX_MPS2 = 10.0
"""Greatest feed-forward, beyond the tilt of any multicopter that flies on."""


def limit_walls(
    limits: VehicleLimitsConfig, vehicle: VehicleSnapshot, pos_ned_m: Vec3, reach_m: float
) -> Iterator[Wall]:
    """The limits of height and distance as walls, those within reach.

    The height of a takeoff counts from the take-off point.
    """
    from_m = 0.0 if vehicle.takeoff_ned_m is None else max(0.0, altitude_m(vehicle.takeoff_ned_m[2]))
    below_m = limits.altitude_max_m + from_m - altitude_m(pos_ned_m[2]) + MARGIN_M + EDGE_M
    if below_m <= reach_m:
        yield Wall((0.0, 0.0, -1.0), below_m, f"the greatest height of {limits.altitude_max_m:g} m")
    away_m = horizontal(pos_ned_m)
    room_m = limits.distance_max_m - away_m + MARGIN_M + EDGE_M
    if room_m <= reach_m and away_m > 1.0:
        yield Wall((pos_ned_m[0] / away_m, pos_ned_m[1] / away_m, 0.0), room_m, _distance_name(limits))


def near_target(limits: VehicleLimitsConfig, target: Target, vehicle: VehicleSnapshot) -> tuple[Target, str]:
    """Target with a point within the greatest distance, or no farther than the vehicle is; and the limit's name or "".

    `limit_walls` has a wall only in the vehicle's own direction, and does not stop a point far away to its side.
    """
    point, pos_ned_m = target.pos_ned_m, vehicle.pos_ned_m
    if point is None or pos_ned_m is None:
        return target, ""
    away_m, away_max_m = horizontal(point), max(limits.distance_max_m + MARGIN_M, horizontal(pos_ned_m))
    if away_m <= away_max_m:
        return target, ""
    part = away_max_m / away_m
    return replace(target, pos_ned_m=(part * point[0], part * point[1], point[2])), _distance_name(limits)


def slowed_target(limits: VehicleLimitsConfig, target: Target) -> tuple[Target, str]:
    """Target whose velocity and acceleration are no greater than the vehicle may have, and the limit's name or ""."""
    speed_max_mps = limits.speed_max_mps + SPEED_MARGIN_MPS
    vel = _shortened(target.vel_ned_mps, speed_max_mps)
    acc = _shortened(target.acc_ned_mps2, ACCELERATION_MAX_MPS2)
    if vel is target.vel_ned_mps and acc is target.acc_ned_mps2:
        return target, ""
    return replace(target, vel_ned_mps=vel, acc_ned_mps2=acc), f"the greatest speed of {limits.speed_max_mps:g} m/s"


def _distance_name(limits: VehicleLimitsConfig) -> str:
    return f"the greatest distance of {limits.distance_max_m:g} m"


def _shortened(v_ned: Vec3 | None, length_max: float) -> Vec3 | None:
    if v_ned is None or (length := norm(v_ned)) <= length_max:
        return v_ned
    return scale(v_ned, length_max / length)
