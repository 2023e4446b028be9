"""Vehicle time on a host that only knows its own monotonic clock."""

from collections import deque
from itertools import pairwise

STEP_BACK_MIN_NS = 60_000_000_000
"""Step back of the master's monotonic clock after which it counts as a new master: no message is late by as much."""
RATE_MIN = 0.2
RATE_WINDOW = 5
PAUSE_SILENCE_MAX_NS = 1_000_000_000
"""Time without a message after which a master that had paused counts as gone: vehicle time goes on."""
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
    be slower than the wall's. Without messages it goes on, so that inputs that have stopped grow old. While the master
    says that it has paused, vehicle time stands still.

    Attributes:
        epoch_id: of the newest message; None before the first.
        pace: of the newest message.
    """

    def __init__(self) -> None:
        self.epoch_id: int | None = None
        self.pace = 1.0
        self._master_ahead_ns = 0
        """Offset from this host's monotonic clock to the master's."""
        self._updated_ns = 0
        self._samples: deque[tuple[int, int]] = deque(maxlen=RATE_WINDOW + 1)
        """(wall time of the master, vehicle time), oldest first."""
        self._newest: tuple[int, int] | None = None
        """The last of the samples; None before the first message."""
        self._rate = 1.0

    def update(self, t_ns: int, epoch_id: int, wall_master_ns: int, wall_ns: int, pace: float = 1.0) -> None:
        """Update the mapping with one `clock` message.

        Args:
            t_ns: the message's vehicle time.
            epoch_id: the message's epoch.
            wall_master_ns: the master's monotonic time when it sent the message.
            wall_ns: this host's monotonic time when the message arrived.
            pace: the message's.
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
        ahead_of_newest_ns = wall_master_ns - self._samples[-1][0] if self._samples else 1
        if ahead_of_newest_ns < 0 or (ahead_of_newest_ns == 0 and pace == self.pace):
            return  # a newer message has overtaken this one
        self._newest = (wall_master_ns, t_ns)
        if pace != self.pace:  # rates at another pace say nothing about this one
            self.pace = pace
            self._samples.clear()
        self._samples.append(self._newest)
        rates = [(t - t_before) / (wall - before) for (before, t_before), (wall, t) in pairwise(self._samples)]
        self._rate = min(pace, max([RATE_MIN * pace, *rates])) if rates else pace

    def now_ns(self, wall_ns: int) -> int:
        """Vehicle time at `wall_ns`, never negative; 0 before the first message."""
        if self._newest is None:
            return 0
        wall_master_ns, t_ns = self._newest
        passed_ns = wall_ns + self._master_ahead_ns - wall_master_ns
        if self.pace == 0.0:
            return t_ns + max(0, passed_ns - PAUSE_SILENCE_MAX_NS)
        now_ns = t_ns + int(passed_ns * self._rate)
        return now_ns if now_ns > 0 else 0

    def pace_now(self, wall_ns: int) -> float:
        """Pace at `wall_ns`: that of the newest message, and 1 when a paused master is silent."""
        if self.pace == 0.0 and self._newest is not None:
            silent_ns = wall_ns + self._master_ahead_ns - self._newest[0]
            return 0.0 if silent_ns <= PAUSE_SILENCE_MAX_NS else 1.0
        return self.pace
