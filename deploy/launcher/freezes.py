"""Which processes are frozen: by what they do, not by how late they are, so that a busy machine costs nobody its life.

Two kinds are told apart from a process that is only starved of processor time:

- stopped: the kernel says so (SIGSTOP). Such a process can't go on by itself, however much time it is given.
- mute: its liveliness token is on the bus, held by Zenoh's threads, but its own loop has made no report for ten of
  them, and it was not for want of a processor. A process that the bus can't reach has no token and isn't judged.

Time in which the launcher itself did not run counts for nobody: a machine that was suspended or stalled as a whole
finds all its services alive.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jezero.runtime.child import is_stopped

LOOK_PERIOD_S = 0.25
LONGEST_STEP_S = 0.5
"""What the time between two looks counts at most."""
STOPPED_S = 1.5
MUTE_S = 10.0


@dataclass(frozen=True, kw_only=True)
class Look:
    """A process at one instant.

    Attributes:
        stopped: by a signal. Waiting for a debugger is another state, and is left alone.
        waited_s: how long its main thread has waited for a processor so far.
        signs: how often it has been heard of on the bus so far.
        reachable: its token is there and so is the router, so that its reports must arrive.
    """

    stopped: bool
    waited_s: float
    signs: int
    reachable: bool


def look_at(pid: int, *, signs: int, reachable: bool) -> Look:
    """A child that has not been waited for, and so still has its process id. Source: sched-stats.rst."""
    try:
        waited_s = int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except FileNotFoundError:  # a kernel without these statistics
        waited_s = 0.0
    return Look(stopped=is_stopped(pid), waited_s=waited_s, signs=signs, reachable=reachable)


@dataclass
class _Record:
    """Of one process: its last look, and for how long at most it has been stopped, or mute."""

    last: Look
    stopped_s: float = 0.0
    mute_s: float = 0.0

    def add(self, look: Look, step_s: float) -> None:
        self.stopped_s = self.stopped_s + step_s if look.stopped else 0.0
        if look.reachable and look.signs == self.last.signs:
            self.mute_s += max(0.0, step_s - (look.waited_s - self.last.waited_s))
        else:
            self.mute_s = 0.0
        self.last = look

    @property
    def verdict(self) -> str:
        if self.stopped_s >= STOPPED_S:
            return f"stopped for {self.stopped_s:.2f} s"
        if self.mute_s >= MUTE_S:
            return f"no report for {self.mute_s:.1f} s, although it is on the bus and had a processor"
        return ""


class FreezeWatch:
    """Judges processes from looks at them."""

    def __init__(self) -> None:
        self._records: dict[int, _Record] = {}
        self._last_s: float | None = None

    def judge(self, now_s: float, looks: Mapping[int, Look]) -> dict[int, str]:
        """Those that are frozen, and how that shows.

        Args:
            now_s: monotonic.
            looks: by process id; who is missing has ended.
        """
        step_s = 0.0 if self._last_s is None else min(now_s - self._last_s, LONGEST_STEP_S)
        self._last_s = now_s
        self._records = {pid: self._records.get(pid) or _Record(look) for pid, look in looks.items()}
        for pid, look in looks.items():
            self._records[pid].add(look, step_s)
        return {pid: record.verdict for pid, record in self._records.items() if record.verdict}
