"""Whether a vehicle that touches something leans over it, as over an edge or a rock."""

from math import hypot

LEAN_MAX = 0.17
"""Sine of an angle, 10 degrees."""


def leans_over(lean_ned: tuple[float, float], usual_ned: tuple[float, float]) -> bool:
    """Whether it leans by more than the limit, and by so much more than it would by itself.

    Args:
        lean_ned: (2,) north and east of a unit vector along the body's vertical axis.
        usual_ned: (2,) the same as it is asked for, or was in the air: a wind makes a vehicle lean.
    """
    lean = hypot(*lean_ned)
    if lean <= LEAN_MAX:
        return False
    return lean - (lean_ned[0] * usual_ned[0] + lean_ned[1] * usual_ned[1]) / lean > LEAN_MAX
