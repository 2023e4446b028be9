"""What a straight leg takes in the wind: its time, and the charge of the battery."""

from math import hypot, sqrt

from jezero.flight_cost import FlightCost, flight_cost
from jezero.frames import Vec3, distance, scale, subtract
from jezero.services.actions.motion.config import MoveConfig
from jezero.services.actions.motion.speed_profile import SpeedProfile
from jezero.services.actions.motion.straight_path import straight_speed_mps
from jezero.vehicle_config import VehicleConfig

SPEED_MIN_MPS = 0.3
"""A vehicle that comes forward more slowly against the wind may just as well be blown away."""


def leg_cost(
    start_ned_m: Vec3, end_ned_m: Vec3, speed_mps: float, move: MoveConfig, wind_ned_mps: Vec3, vehicle: VehicleConfig
) -> FlightCost | None:
    """Cost of a straight leg from rest to rest; None where the vehicle doesn't come forward against the wind.

    Args:
        speed_mps: over ground, along the leg; it is less where the vertical limits or the wind don't allow it.
    """
    length_m = distance(start_ned_m, end_ned_m)
    if length_m < 1e-6:
        return FlightCost(0.0, 0.0)
    direction_ned = scale(subtract(end_ned_m, start_ned_m), 1.0 / length_m)
    speed_mps = straight_speed_mps(start_ned_m, end_ned_m, speed_mps, move)
    speed_mps = min(speed_mps, _speed_in_wind_mps(direction_ned, wind_ned_mps, vehicle.airframe.airspeed_max_mps))
    if speed_mps < SPEED_MIN_MPS:
        return None
    time_s = SpeedProfile(length_m, speed_mps, move.accel_mps2).duration_s + move.reached_s
    return flight_cost(time_s, scale(direction_ned, length_m / time_s), wind_ned_mps, vehicle)


def _speed_in_wind_mps(direction_ned: Vec3, wind_ned_mps: Vec3, airspeed_max_mps: float) -> float:
    """Greatest speed along a direction that an airspeed allows; 0 where the wind carries the vehicle off."""
    north, east = direction_ned[0], direction_ned[1]
    level = hypot(north, east)
    if level < 1e-3 or airspeed_max_mps == float("inf"):
        return float("inf")
    along_mps = (wind_ned_mps[0] * north + wind_ned_mps[1] * east) / level
    across_mps = (wind_ned_mps[0] * east - wind_ned_mps[1] * north) / level
    if abs(across_mps) >= airspeed_max_mps:
        return 0.0
    return max(along_mps + sqrt(airspeed_max_mps**2 - across_mps**2), 0.0) / level
