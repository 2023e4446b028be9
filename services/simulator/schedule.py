"""Steps of the simulation, and the times at which a sensor samples and at which its readings arrive."""

from collections import deque
from typing import Generic, TypeVar

from jezero.schemas.units import NS_PER_S

T = TypeVar("T")

STEPS_PER_S = 250
DT_S = 1.0 / STEPS_PER_S
"""Steps of the simulation per second of vehicle time, and their length."""


class Schedule(Generic[T]):
    """One sensor's rate and delay.

    Samples fall on the first step at or after each period's end; on average the rate is kept, also where the period is
    no multiple of the step.

    Args:
        rate_hz: samples per second.
        delay_s: time from a sample until its reading arrives.
        phase_s: time of the first sample, so that not all sensors sample in one step.
    """

    def __init__(self, rate_hz: float, delay_s: float = 0.0, phase_s: float = 0.0) -> None:
        self._period_ns = round(NS_PER_S / rate_hz)
        self._delay_ns = round(NS_PER_S * delay_s)
        self._next_ns = round(NS_PER_S * phase_s)
        self._queue: deque[tuple[int, T]] = deque()

    def due(self, t_ns: int) -> bool:
        """Whether to sample in this step; to be called once per step."""
        if t_ns < self._next_ns:
            return False
        self._next_ns += self._period_ns * ((t_ns - self._next_ns) // self._period_ns + 1)
        return True

    def put(self, t_ns: int, reading: T) -> None:
        """Add a reading of time `t_ns`."""
        self._queue.append((t_ns + self._delay_ns, reading))

    def arrived(self, t_ns: int) -> T | None:
        """The next reading whose delay is over, oldest first, or None."""
        if self._queue and self._queue[0][0] <= t_ns:
            return self._queue.popleft()[1]
        return None
