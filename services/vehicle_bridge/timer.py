"""Vehicle time that has passed, for time-outs."""

AHEAD_MAX_NS = 150_000_000
"""No silence may last longer than this beyond its limit."""


class Timer:
    """Counts what passes of vehicle time, which is an estimate that may step back.

    It steps back when the time master stood still, of which the bridge learns afterwards. What then passes once more
    has been counted already and isn't again, within bounds.

    Attributes:
        now_ns: time that has passed since the first one told; never steps back.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self._t_ns: int | None = None
        self._ahead_ns = 0
        """Of vehicle time that is counted already."""

    def tell(self, t_ns: int) -> None:
        """Vehicle time is this now."""
        passed_ns = 0 if self._t_ns is None else t_ns - self._t_ns
        self._t_ns = t_ns
        ahead_ns = self._ahead_ns - passed_ns
        if ahead_ns > 0:
            self._ahead_ns = min(ahead_ns, AHEAD_MAX_NS)
        else:
            self._ahead_ns = 0
            self.now_ns -= ahead_ns
