"""How fast the battery empties in the present flight."""

from collections import deque

from jezero.schemas.units import NS_PER_S

STEPS_MIN, STEPS_MAX = 3, 10
"""Steps of one percent, in which the autopilot reports the charge, over which the use is measured."""


class BatteryUse:
    """Measures the use of the battery from the times at which its reported charge falls.

    So the measurement contains what a forecast does not know: wind, payload, and the age of the battery.

    Args:
        declared_per_s: fraction of the capacity used per second, until it is measured.
    """

    def __init__(self, declared_per_s: float) -> None:
        self._declared_per_s = declared_per_s
        self._steps: deque[tuple[int, float]] = deque(maxlen=STEPS_MAX + 1)
        """Times at which the charge fell, with the charge from then on."""
        self._remaining: float | None = None

    def update(self, t_ns: int, remaining: float) -> None:
        """Take the charge of a flying vehicle into account.

        Args:
            remaining: fraction of the capacity that is left.
        """
        before, self._remaining = self._remaining, remaining
        if before is not None and remaining > before:  # another battery, or another estimate of the same one
            self._steps.clear()
        elif before is not None and remaining < before:
            self._steps.append((t_ns, remaining))

    def reset(self) -> None:
        """Forget the flight that is over."""
        self._steps.clear()
        self._remaining = None

    @property
    def per_s(self) -> float:
        """Fraction of the capacity that is used per second."""
        if len(self._steps) <= STEPS_MIN:
            return self._declared_per_s
        (first_ns, first), (last_ns, last) = self._steps[0], self._steps[-1]
        return (first - last) * NS_PER_S / (last_ns - first_ns)
