"""How fast the battery empties in the present flight."""

from collections import deque
from statistics import linear_regression

from jezero.schemas.units import NS_PER_S

PERIOD_NS = NS_PER_S
MEASURED_MIN_NS, MEASURED_MAX_NS = 30 * NS_PER_S, 90 * NS_PER_S
"""The use is measured over a time in which the charge falls by several of the whole percents that an autopilot reports,
and in which the sag of the voltage at a takeoff hardly counts."""
OTHER_BATTERY_RISE = 0.1
"""When the charge rises by more, somebody has put in another battery. A charge that the autopilot estimates from the
voltage rises by less than this when the vehicle flies with less thrust."""


class BatteryUse:
    """Measures the use of the battery as the slope of its reported charge over the last 90 s of the flight.

    So the measurement contains what a forecast does not know: wind, payload, and the age of the battery.

    Args:
        declared_per_s: fraction of the capacity used per second, until it is measured.

    Attributes:
        per_s: fraction of the capacity that is used per second.
    """

    def __init__(self, declared_per_s: float) -> None:
        self.per_s = declared_per_s
        self._declared_per_s = declared_per_s
        self._samples: deque[tuple[int, float]] = deque()
        """Times with the charge, one a second."""

    def update(self, t_ns: int, remaining: float) -> None:
        """Take the charge of a flying vehicle into account.

        Args:
            remaining: fraction of the capacity that is left.
        """
        samples = self._samples
        if samples and remaining > samples[-1][1] + OTHER_BATTERY_RISE:
            self.reset()
        if samples and t_ns - samples[-1][0] < PERIOD_NS:
            return
        samples.append((t_ns, remaining))
        while t_ns - samples[0][0] > MEASURED_MAX_NS:
            samples.popleft()
        if t_ns - samples[0][0] >= MEASURED_MIN_NS:
            times_s = [(sample_ns - t_ns) / NS_PER_S for sample_ns, _ in samples]
            self.per_s = max(0.0, -linear_regression(times_s, [charge for _, charge in samples]).slope)

    def reset(self) -> None:
        """Forget what was measured, for another flight or another battery."""
        self._samples.clear()
        self.per_s = self._declared_per_s
