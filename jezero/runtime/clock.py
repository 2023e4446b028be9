"""Vehicle time on a host that only knows its own monotonic clock."""

from collections import deque

WINDOW = 10
JUMP_BACK_NS = 200_000_000
NS_PER_S = 1_000_000_000


class VehicleClock:
    """Maps monotonic wall time onto the vehicle time that `clock` messages carry.

    The earliest-arriving message of the last ten decides, as a delay can only make the master look late. The rate
    follows the master, which may run slower than the wall. Without messages time goes on at the last rate, so that
    what has stopped coming grows old.
    """

    def __init__(self) -> None:
        self.epoch_id: int | None = None
        self._samples: deque[tuple[int, int]] = deque(maxlen=WINDOW)
        self._rate = 1.0

    def update(self, t_ns: int, epoch_id: int, wall_ns: int) -> None:
        """Take one `clock` message that arrived at `wall_ns`."""
        jumped = self.now_ns(wall_ns) - t_ns > JUMP_BACK_NS
        if epoch_id != self.epoch_id or jumped:
            self._samples.clear()
            self._rate = 1.0
            self.epoch_id = epoch_id
        self._samples.append((wall_ns, t_ns))
        first_wall, first_t = self._samples[0]
        if wall_ns - first_wall > NS_PER_S // 4:
            self._rate = min(1.0, max(0.2, (t_ns - first_t) / (wall_ns - first_wall)))

    def now_ns(self, wall_ns: int) -> int:
        """Vehicle time at `wall_ns`; 0 before the first message."""
        return max((t + int((wall_ns - wall) * self._rate) for wall, t in self._samples), default=0)
