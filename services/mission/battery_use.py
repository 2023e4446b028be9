"""How fast the battery empties in the present flight."""

from collections import deque
from statistics import linear_regression

from jezero.base.vehicle_config import LEAST_USE
from jezero.schemas.units import NS_PER_S

PERIOD_NS = NS_PER_S
MEASURED_MIN_NS, MEASURED_MAX_NS = 30 * NS_PER_S, 90 * NS_PER_S
"""The use is measured over a time in which the charge falls by several of the whole percents that an autopilot reports,
and in which the sag of the voltage at a takeoff hardly counts."""


class BatteryUse:
    """Measures the use of the battery as the slope of its reported charge over the last 90 s of the flight.

    So the measurement contains what a forecast does not know: wind, payload, and the age of the battery. A gauge that
    shows less than `LEAST_USE` of the declared use is wrong: it stands still, for example, or rises. Then the declared
    use counts, and the charge is calculated with it.

    Args:
        declared_per_s: fraction of the capacity used per second in hover.

    Attributes:
        per_s: fraction of the capacity that is used per second: the declared one, until it is measured.
        charge: fraction of the capacity that is left at most; None before the first report of the flight.
    """

    def __init__(self, declared_per_s: float) -> None:
        self.per_s = declared_per_s
        self.charge: float | None = None
        self._declared_per_s = declared_per_s
        self._falls_per_s = self._least_per_s = LEAST_USE * declared_per_s
        self._samples: deque[tuple[int, float]] = deque()
        """Times with the reported charge, one a second."""

    def update(self, t_ns: int, remaining: float) -> None:
        """Take the charge of a flying vehicle into account.

        Args:
            remaining: fraction of the capacity that is left, as the autopilot reports it.
        """
        samples = self._samples
        if samples and t_ns - samples[-1][0] < PERIOD_NS:
            return
        if self.charge is None:
            self.charge = remaining
        elif samples:
            falls = self._falls_per_s * (t_ns - samples[-1][0]) / NS_PER_S
            self.charge = max(0.0, min(remaining, self.charge - falls))
        samples.append((t_ns, remaining))
        while t_ns - samples[0][0] > MEASURED_MAX_NS:
            samples.popleft()
        if t_ns - samples[0][0] >= MEASURED_MIN_NS:
            times_s = [(sample_ns - t_ns) / NS_PER_S for sample_ns, _ in samples]
            measured_per_s = -linear_regression(times_s, [charge for _, charge in samples]).slope
            believed = measured_per_s >= self._least_per_s
            self.per_s = measured_per_s if believed else self._declared_per_s
            self._falls_per_s = self._least_per_s if believed else self._declared_per_s

    def reset(self) -> None:
        """Forget what was measured, for another flight."""
        self._samples.clear()
        self.charge = None
        self.per_s, self._falls_per_s = self._declared_per_s, self._least_per_s
