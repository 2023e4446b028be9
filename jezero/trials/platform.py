"""Where the vehicle is above the rover's platform, and whether it stands on it, by the simulator's truth."""

from math import degrees, hypot

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    altitude_m,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    subtract,
    tilt_from_quat,
)
from jezero.schemas.state import Truth

STANDING_HEIGHT_MAX_M = 0.1
"""A vehicle farther above or below the platform does not stand on it."""
UPRIGHT_TILT_MAX_DEG = 15.0
FALLEN_TILT_MIN_DEG = 60.0


def offset_m(truth: Truth) -> Vec3:
    """(3,) position of the vehicle minus that of the platform's centre, NED."""
    return subtract(truth.pos_uav_ned_m, truth.pos_rover_ned_m)


def on_platform_m(truth: Truth, height_stand_m: float = 0.0) -> Vec3:
    """(3,) position of the vehicle from the platform's centre: forward, right and down in the platform's axes.

    Args:
        height_stand_m: height of the centre of mass of a standing vehicle, by which the truth lowers the vehicle
            vertically; only on a tilted platform does it make a difference.
    """
    stand_m = (0.0, 0.0, height_stand_m)
    center_ned_m = subtract(offset_m(truth), stand_m)
    return add(quat_rotate(quat_conjugate(_q_ned_from_rover_body(truth)), center_ned_m), stand_m)


def off_platform_reason(truth: Truth, half_side_m: float, height_stand_m: float = 0.0) -> str:
    """Why the vehicle does not stand upright on the platform; "" if it does.

    Args:
        half_side_m: half of the platform's side.
        height_stand_m: as in `on_platform_m`.
    """
    forward_m, right_m, down_m = on_platform_m(truth, height_stand_m)
    if abs(down_m) > STANDING_HEIGHT_MAX_M or max(abs(forward_m), abs(right_m)) > half_side_m:
        away_m = hypot(forward_m, right_m)
        return f"stands {away_m:.2f} m from the middle of the platform and {altitude_m(down_m):.2f} m above it"
    return _leaning_reason(quat_multiply(quat_conjugate(_q_ned_from_rover_body(truth)), truth.q_ned_from_frd))


def tipped_over_reason(truth: Truth) -> str:
    """Why the vehicle does not stand upright on the ground; "" if it does."""
    return _leaning_reason(truth.q_ned_from_frd)


def is_on_its_back(truth: Truth) -> bool:
    """Whether the vehicle lies on its side or on its rotors."""
    return degrees(tilt_from_quat(truth.q_ned_from_frd)) > FALLEN_TILT_MIN_DEG


def _q_ned_from_rover_body(truth: Truth) -> Quat:
    return quat_from_euler(truth.roll_rover_rad, truth.pitch_rover_rad, truth.yaw_rover_rad)


def _leaning_reason(q_surface_from_frd: Quat) -> str:
    tilt_deg = degrees(tilt_from_quat(q_surface_from_frd))
    return f"tilted by {tilt_deg:.0f} degrees" if tilt_deg > UPRIGHT_TILT_MAX_DEG else ""
