"""Detection of a vehicle that is tilted by what it touches, such as an edge or a rock."""

from math import hypot

TILT_SINE_MAX = 0.17
"""Sine of the largest tilt on level ground: 10 degrees."""


def is_tilted_by_contact(axis_ned: tuple[float, float], expected_axis_ned: tuple[float, float]) -> bool:
    """Whether the tilt is above the limit, and above the expected tilt by more than the limit.

    Args:
        axis_ned: (2,) north and east components of the unit vector along the body's vertical axis.
        expected_axis_ned: (2,) the same vector as commanded, or as measured in the air: wind alone tilts a vehicle.
    """
    tilt = hypot(*axis_ned)
    if tilt <= TILT_SINE_MAX:
        return False
    return tilt - (axis_ned[0] * expected_axis_ned[0] + axis_ned[1] * expected_axis_ned[1]) / tilt > TILT_SINE_MAX
