"""Where the vehicle is above the rover's platform, and whether it stands on it, by the simulator's truth."""

from math import degrees, hypot

from jezero.frames import Vec3, altitude_m, rotate_yaw, subtract, tilt_from_quat
from jezero.schemas.state import Truth

STANDING_HEIGHT_MAX_M = 0.1
"""A vehicle farther above or below the platform does not stand on it."""
UPRIGHT_TILT_MAX_DEG = 15.0


def offset_m(truth: Truth) -> Vec3:
    """(3,) position of the vehicle minus that of the platform's centre, NED."""
    return subtract(truth.pos_uav_ned_m, truth.pos_rover_ned_m)


def on_platform_m(truth: Truth) -> Vec3:
    """(3,) position of the vehicle from the platform's centre: forward, right and down in the rover's axes."""
    return rotate_yaw(offset_m(truth), -truth.yaw_rover_rad)


def off_platform_reason(truth: Truth, half_side_m: float) -> str:
    """Why the vehicle does not stand upright on the platform; "" if it does.

    Args:
        half_side_m: half of the platform's side.
    """
    forward_m, right_m, down_m = on_platform_m(truth)
    if abs(down_m) > STANDING_HEIGHT_MAX_M or max(abs(forward_m), abs(right_m)) > half_side_m:
        away_m = hypot(forward_m, right_m)
        return f"stands {away_m:.2f} m from the middle of the platform and {altitude_m(down_m):.2f} m above it"
    return tipped_over_reason(truth)


def tipped_over_reason(truth: Truth) -> str:
    """Why the vehicle does not stand upright; "" if it does."""
    tilt_deg = degrees(tilt_from_quat(truth.q_ned_from_frd))
    return f"tilted by {tilt_deg:.0f} degrees" if tilt_deg > UPRIGHT_TILT_MAX_DEG else ""
