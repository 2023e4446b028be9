"""Detectors that several services share: a sensor that repeats itself, a tilt by contact, a compass that was wrong."""

from math import hypot

from jezero.base.frames import wrap_pi, yaw_from_quat
from jezero.schemas.state import Odometry

REPEATED_READINGS_MAX = 2
"""The noise of a working sensor may produce the same reading this many times in a row."""

TILT_SINE_MAX = 0.17
"""Sine of the largest tilt on level ground: 10 degrees."""
SLOPE_SINE_MAX = 0.34
"""Sine of the largest tilt that a slope gives a vehicle which stands on it: 20 degrees."""

HEADING_STEP_MIN_RAD = 0.3
"""Smaller steps of the heading come from an unusual declination, or from a compass that is only somewhat disturbed."""
COMPASS_CHECK = (
    "check how the compass is mounted (its rotation in the autopilot's settings), iron and currents near it, and its "
    "calibration"
)
"""What a person does about a compass that was wrong."""


class FrozenSensorDetector:
    """Detects a sensor that repeats its reading to the last digit; the readings of a working sensor carry noise."""

    def __init__(self) -> None:
        self._last: object = None
        self._repeats = 0

    def is_frozen(self, reading: object) -> bool:
        """Compare a reading with the one before it. Call it once for every reading."""
        self._repeats = self._repeats + 1 if reading == self._last else 0
        self._last = reading
        return self._repeats > REPEATED_READINGS_MAX


def is_tilted_by_contact(
    axis_ned: tuple[float, float], expected_axis_ned: tuple[float, float], sine_max: float = TILT_SINE_MAX
) -> bool:
    """Whether a vehicle is tilted by what it touches, such as an edge or a rock.

    Its tilt is above the limit, and above the expected tilt by more than the limit.

    Args:
        axis_ned: (2,) north and east components of the unit vector along the body's vertical axis.
        expected_axis_ned: (2,) the same vector as commanded, or as measured in the air: wind alone tilts a vehicle.
        sine_max: sine of the limit.
    """
    tilt = hypot(*axis_ned)
    if tilt <= sine_max:
        return False
    return tilt - (axis_ned[0] * expected_axis_ned[0] + axis_ned[1] * expected_axis_ned[1]) / tilt > sine_max


def heading_step_rad(before: Odometry, after: Odometry) -> float:
    """Angle by which a reset between two odometries has turned the heading; 0 without a reset, and for a small one.

    An autopilot resets its heading by the vehicle's motion where the motion contradicts the compass: GNSS measures how
    the velocity changes, the IMU how the vehicle accelerates, and the heading turns one into the other. So a step shows
    in flight that the compass was wrong.
    """
    if after.reset_counter == before.reset_counter:
        return 0.0
    step_rad = wrap_pi(yaw_from_quat(after.q_ned_from_frd) - yaw_from_quat(before.q_ned_from_frd))
    return step_rad if abs(step_rad) > HEADING_STEP_MIN_RAD else 0.0
