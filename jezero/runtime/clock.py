"""Vehicle time on a host that only knows its own monotonic clock."""

from collections import deque
from itertools import pairwise

STEP_BACK_MIN_NS = 60_000_000_000
"""Step back of the master's monotonic clock after which it counts as a new master: no message is late by as much."""
RATE_MIN = 0.2
RATE_WINDOW = 5
"""Number of newest rates whose maximum is used: one stall does not make a master slow."""
DRIFT_MAX = 2e-4
"""Upper limit of the relative drift between the monotonic clocks of two hosts."""


class VehicleClock:
    """Maps monotonic wall time onto the vehicle time that `clock` messages carry.

    Each message holds both times of its master: vehicle time and monotonic time. The message with the shortest delay
    gives the offset between the two monotonic clocks, as a delay can only make the master's clock look late. The newest
    message gives vehicle time at a time of the master's monotonic clock. This distinguishes a master that stood still
    from messages that arrived late: vehicle time steps back at once for a stalled master, and never for late messages,
    after which old setpoints would count as young. Between messages vehicle time follows the master's rate, which may
    be slower than the wall's. Without messages it goes on, so that inputs that have stopped grow old.

    Attributes:
        epoch_id: of the newest message; None before the first.
    """

    def __init__(self) -> None:
        self.epoch_id: int | None = None
        self._master_ahead_ns = 0
        """Offset from this host's monotonic clock to the master's."""
        self._updated_ns = 0
        self._samples: deque[tuple[int, int]] = deque(maxlen=RATE_WINDOW + 1)
        """(wall time of the master, vehicle time), oldest first."""
        self._newest: tuple[int, int] | None = None
        """The last of the samples; None before the first message."""
        self._rate = 1.0

    def update(self, t_ns: int, epoch_id: int, wall_master_ns: int, wall_ns: int) -> None:
        """Update the mapping with one `clock` message.

        Args:
            t_ns: the message's vehicle time.
            epoch_id: the message's epoch.
            wall_master_ns: the master's monotonic time when it sent the message.
            wall_ns: this host's monotonic time when the message arrived.
        """
        ahead_ns = wall_master_ns - wall_ns
        if epoch_id != self.epoch_id or (self._samples and self._samples[-1][0] - wall_master_ns > STEP_BACK_MIN_NS):
            self.epoch_id = epoch_id
            self._samples.clear()
            self._newest = None
        if self._samples:
            drift_ns = int((wall_ns - self._updated_ns) * DRIFT_MAX)
            ahead_ns = max(ahead_ns, self._master_ahead_ns - drift_ns)
        self._master_ahead_ns = ahead_ns
        self._updated_ns = wall_ns
        if self._samples and wall_master_ns <= self._samples[-1][0]:
            return  # a newer message has overtaken this one
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
