"""Reasons of refusals that several actions share, each with the number and the limit."""

from jezero.base.frames import Vec3, altitude_m, horizontal
from jezero.base.vehicle_config import VehicleLimitsConfig

SPEED_MIN_MPS = 0.1
"""Lowest speed that a goal may ask for."""


def point_refusal(point_ned_m: Vec3, limits: VehicleLimitsConfig) -> str:
    """Reason why the vehicle may not fly to a point, or ""."""
    return low_refusal(point_ned_m[2], limits) or high_or_far_refusal(point_ned_m, limits)


def low_refusal(z_ned_m: float, limits: VehicleLimitsConfig) -> str:
    """Reason why a point, in the world's or in the rover's frame, is too low, or ""."""
    if not z_ned_m < 0.0:
        return f"target z = {z_ned_m:g} m is not above the ground: NED counts down, 5 m up is −5"
    up_m = altitude_m(z_ned_m)
    if not up_m >= limits.altitude_min_m:
        return f"target z = {z_ned_m:g} m is {up_m:g} m up, below the limit of {limits.altitude_min_m:g} m"
    return ""


def high_or_far_refusal(point_ned_m: Vec3, limits: VehicleLimitsConfig) -> str:
    """Reason why a point is too high or too far away, or ""."""
    up_m = altitude_m(point_ned_m[2])
    if not up_m <= limits.altitude_max_m:
        return f"altitude {up_m:g} m is beyond the limit of {limits.altitude_max_m:g} m"
    return distance_refusal(point_ned_m, limits)


def distance_refusal(point_ned_m: Vec3, limits: VehicleLimitsConfig) -> str:
    """Reason why a point is too far away, or ""."""
    distance_m = horizontal(point_ned_m)
    if not distance_m <= limits.distance_max_m:
        return f"the target is {distance_m:.0f} m from the origin, beyond the limit of {limits.distance_max_m:g} m"
    return ""


def speed_refusal(speed_mps: float | None, limits: VehicleLimitsConfig) -> str:
    """Reason why a speed may not be flown, or ""."""
    if speed_mps is None or SPEED_MIN_MPS <= speed_mps <= limits.speed_max_mps:
        return ""
    return f"speed {speed_mps:g} m/s is not within {SPEED_MIN_MPS:g} to {limits.speed_max_mps:g} m/s"
