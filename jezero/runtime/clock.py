"""Vehicle time on a host that only knows its own monotonic clock."""

from collections import deque

WINDOW = 10
JUMP_BACK_NS = 200_000_000
SETTLE_NS = 150_000_000
NS_PER_S = 1_000_000_000


class VehicleClock:
    """Maps monotonic wall time onto the vehicle time that `clock` messages carry.

    The earliest-arriving message of the last ten decides, as a delay can only make the master look late. The rate
    follows the master, which may run slower than the wall. Without messages time goes on at the last rate, so that
    what has stopped coming grows old. Time steps back only when messages stay behind it for a while, as they do after
    the master has stood still: those that a link held back come all at once, and must not make old setpoints young.
    """

    def __init__(self) -> None:
        self.epoch_id: int | None = None
        self._samples: deque[tuple[int, int]] = deque(maxlen=WINDOW)
        self._behind: list[tuple[int, int]] = []
        """The latest messages, while they are too far behind to be believed yet."""
        self._rate = 1.0

    def update(self, t_ns: int, epoch_id: int, wall_ns: int) -> None:
        """Take one `clock` message that arrived at `wall_ns`."""
        if epoch_id != self.epoch_id:
            self._begin([], epoch_id)
        if self.now_ns(wall_ns) - t_ns > JUMP_BACK_NS:
            self._behind.append((wall_ns, t_ns))
            if wall_ns - self._behind[0][0] >= SETTLE_NS:
                self._begin(self._behind, epoch_id)
            return
        self._behind.clear()
        self._samples.append((wall_ns, t_ns))
        first_wall, first_t = self._samples[0]
        spans = [(wall - first_wall, t - first_t) for wall, t in self._samples if wall - first_wall > NS_PER_S // 4]
        if spans:  # late messages make it look slow: the fastest span is the one without them
            self._rate = min(1.0, max(0.2, *(t / wall for wall, t in spans)))

    def _begin(self, samples: list[tuple[int, int]], epoch_id: int) -> None:
        self._samples = deque(samples, maxlen=WINDOW)
        self._behind = []
        self._rate = 1.0
        self.epoch_id = epoch_id

    def now_ns(self, wall_ns: int) -> int:
        """Vehicle time at `wall_ns`; 0 before the first message."""
        return max((t + int((wall_ns - wall) * self._rate) for wall, t in self._samples), default=0)
