"""Detection of a vehicle that is tilted by what it touches, such as an edge or a rock."""

from math import hypot

TILT_SINE_MAX = 0.17
"""Sine of the largest tilt on level ground: 10 degrees."""
SLOPE_SINE_MAX = 0.34
"""Sine of the largest tilt that a slope gives a vehicle which stands on it: 20 degrees."""


def is_tilted_by_contact(
    axis_ned: tuple[float, float], expected_axis_ned: tuple[float, float], sine_max: float = TILT_SINE_MAX
) -> bool:
    """Whether the tilt is above the limit, and above the expected tilt by more than the limit.

    Args:
        axis_ned: (2,) north and east components of the unit vector along the body's vertical axis.
        expected_axis_ned: (2,) the same vector as commanded, or as measured in the air: wind alone tilts a vehicle.
        sine_max: sine of the limit.
    """
    tilt = hypot(*axis_ned)
    if tilt <= sine_max:
        return False
    return tilt - (axis_ned[0] * expected_axis_ned[0] + axis_ned[1] * expected_axis_ned[1]) / tilt > sine_max
