"""Steps of the autopilot's heading, which show in flight that the compass was wrong.

An autopilot resets its heading by the vehicle's motion where the motion contradicts the compass: GNSS measures how the
velocity changes, the IMU how the vehicle accelerates, and the heading turns one into the other.
"""

from jezero.frames import wrap_pi, yaw_from_quat
from jezero.schemas.state import Odometry

STEP_MIN_RAD = 0.3
"""Smaller steps come from an unusual declination, or from a compass that is only somewhat disturbed."""
CHECK = (
    "check how the compass is mounted (its rotation in the autopilot's settings), iron and currents near it, and its "
    "calibration"
)


def heading_step_rad(before: Odometry, after: Odometry) -> float:
    """Angle by which a reset between two odometries has turned the heading; 0 without a reset, and for a small one."""
    if after.reset_counter == before.reset_counter:
        return 0.0
    step_rad = wrap_pi(yaw_from_quat(after.q_ned_from_frd) - yaw_from_quat(before.q_ned_from_frd))
    return step_rad if abs(step_rad) > STEP_MIN_RAD else 0.0
