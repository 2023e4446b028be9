"""Elapsed vehicle time, for time-outs."""

AHEAD_MAX_NS = 100_000_000
"""No time-out may be exceeded by more than this."""


class Timer:
    """Elapsed vehicle time that never steps back, from an estimate of vehicle time that may.

    The estimate steps back when the time master stood still and its clock message arrives afterwards. The time until
    the estimate is where it was has been counted already, and is not counted twice, within `AHEAD_MAX_NS`.

    Attributes:
        now_ns: vehicle time since the first update; never steps back.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self._t_ns: int | None = None
        self._ahead_ns = 0
        """Vehicle time that is counted already and has yet to pass."""

    def update(self, t_ns: int) -> None:
        """Count the time since the last update; `t_ns` is the present vehicle time."""
        passed_ns = 0 if self._t_ns is None else t_ns - self._t_ns
        self._t_ns = t_ns
        ahead_ns = self._ahead_ns - passed_ns
        if ahead_ns > 0:
            self._ahead_ns = min(ahead_ns, AHEAD_MAX_NS)
        else:
            self._ahead_ns = 0
            self.now_ns -= ahead_ns
