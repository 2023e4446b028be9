"""Time and way to the end of a landing, by its speeds; without waits for the rover or the wind."""

from math import hypot

from jezero.frames import Vec3, altitude_m
from jezero.services.actions.land_on_spot.config import PlainLandingConfig, RoverLandingConfig
from jezero.services.actions.land_on_spot.descent import CONTACT_S, GAIN_DESCENT_1PS
from jezero.services.actions.motion.behaviour import Remaining

APPROACH_DOWN_MPS = 1.2
"""Speed downwards on the way to the rover."""
DISARM_S = 4.0
"""Time from the contact until the autopilot has found the ground and stopped the motors."""
STEP_M = 0.05
"""Step of height with which the time of the descent is summed up."""


def rover_landing_remaining(pos_rel_ned_m: Vec3, config: RoverLandingConfig) -> Remaining:
    """Rest of a landing on the rover: the approach, and the descent that slows down with the height.

    Args:
        pos_rel_ned_m: (3,) position of the vehicle minus that of the platform.
    """
    north_m, east_m, down_m = pos_rel_ned_m
    away_m, height_m = hypot(north_m, east_m), max(altitude_m(down_m), 0.0)
    descent_m = min(height_m, config.height_approach_m)
    control = config.platform_control
    braking_s = 1.0 / control.gain_near_1ps if away_m > 0.0 else 0.0
    approach_s = max(away_m / control.speed_max_mps + braking_s, (height_m - descent_m) / APPROACH_DOWN_MPS)
    return Remaining(approach_s + _descent_s(descent_m, config) + CONTACT_S + DISARM_S, away_m + height_m)


def plain_descent_remaining(height_m: float, config: PlainLandingConfig) -> Remaining:
    """Rest of the descent onto a spot.

    Args:
        height_m: over ground.
    """
    slow_m = min(height_m, config.slow_height_m)
    down_s = (height_m - slow_m) / config.speed_high_mps + slow_m / config.speed_low_mps
    return Remaining(down_s + DISARM_S, height_m)


def _descent_s(height_m: float, config: RoverLandingConfig) -> float:
    """Time of the descent from a height."""
    steps = int(height_m / STEP_M) + 1
    step_m = height_m / steps
    heights_m = (step_m * (number + 0.5) for number in range(steps))
    return sum(
        step_m / min(max(GAIN_DESCENT_1PS * h, config.descent_min_mps), config.descent_max_mps) for h in heights_m
    )
