"""Vehicle time on a host that only knows its own monotonic clock."""

from collections import deque
from itertools import pairwise

FORGET_NS = 60_000_000_000
"""A message older than the newest by so much, by their master's clock, shows that one of the two tells a wrong one."""
RATE_MIN = 0.2
RATES = 5
"""The rate is the fastest of so many: one stall does not make a master slow."""
DRIFT = 2e-4
"""Monotonic clocks of two hosts differ by less."""


class VehicleClock:
    """Maps monotonic wall time onto the vehicle time that `clock` messages carry.

    Each message tells both times of its master. The one that arrived earliest ties the two monotonic clocks together,
    as a delay can only make the master look late; the newest ties vehicle time to the master's. So a master that stood
    still is told from messages that came late: vehicle time steps back for the former at once, and never for the
    latter, which would make old setpoints young. Between messages it follows the master's rate, which may be slower
    than the wall's; without messages it goes on, so that what has stopped coming grows old.
    """

    def __init__(self) -> None:
        self.epoch_id: int | None = None
        self._master_ahead_ns = 0
        """The master's monotonic clock less ours."""
        self._updated_ns = 0
        self._samples: deque[tuple[int, int]] = deque(maxlen=RATES + 1)
        """(wall time of the master, vehicle time), oldest first."""
        self._newest: tuple[int, int] | None = None
        """Of these."""
        self._rate = 1.0

    def update(self, t_ns: int, epoch_id: int, wall_master_ns: int, wall_ns: int) -> None:
        """Take one `clock` message that arrived at `wall_ns`."""
        ahead_ns = wall_master_ns - wall_ns
        if epoch_id != self.epoch_id or (self._samples and self._samples[-1][0] - wall_master_ns > FORGET_NS):
            self.epoch_id = epoch_id
            self._samples.clear()
            self._newest = None
        if self._samples:
            drift_ns = int((wall_ns - self._updated_ns) * DRIFT)
            ahead_ns = max(ahead_ns, self._master_ahead_ns - drift_ns)
        self._master_ahead_ns = ahead_ns
        self._updated_ns = wall_ns
        if self._samples and wall_master_ns <= self._samples[-1][0]:
            return  # overtaken by a newer one
        self._newest = (wall_master_ns, t_ns)
        self._samples.append(self._newest)
        rates = [(t - t_before) / (wall - before) for (before, t_before), (wall, t) in pairwise(self._samples)]
        self._rate = min(1.0, max([RATE_MIN, *rates])) if rates else 1.0

    def now_ns(self, wall_ns: int) -> int:
        """Vehicle time at `wall_ns`, never negative; 0 before the first message."""
        if self._newest is None:
            return 0
        wall_master_ns, t_ns = self._newest
        now_ns = t_ns + int((wall_ns + self._master_ahead_ns - wall_master_ns) * self._rate)
        return now_ns if now_ns > 0 else 0
