"""Detection of frozen processes by their state, not by their lateness, so that a busy machine kills no process.

Two kinds of frozen process are distinguished from one that only lacks processor time:

- stopped: the kernel reports it (SIGSTOP). Such a process can't continue by itself.
- silent: its liveliness token, held by Zenoh's threads, is on the bus, but its own loop has made no report for ten
  seconds in which it did not wait for a processor. A process that the bus can't reach has no token and is not checked.

A silence of all services at once is the fault of the bus or of the launcher's link to it, and counts for none of them.
Time in which the launcher itself did not run is not counted: after the suspension of the whole machine all services are
still alive.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jezero.runtime.linux_processes import is_stopped

SAMPLE_PERIOD_S = 0.25
STEP_MAX_S = 0.5
"""The time between two samples counts as at most this."""
STOPPED_MAX_S = 1.5
SILENT_MAX_S = 10.0
BUS_SILENT_MIN_S = 2.0
"""The bus counts as silent when none of the services has reported for this long; each reports once a second."""


@dataclass(frozen=True, kw_only=True)
class ProcessSample:
    """State of a process at one time.

    Attributes:
        stopped: whether a signal has stopped it. A process that waits for a debugger is not stopped.
        waited_s: total time that its main thread has waited for a processor.
        reports: number of its reports and arrivals on the bus so far.
        reachable: whether its token and the router are present, so that its reports must arrive.
    """

    stopped: bool
    waited_s: float
    reports: int
    reachable: bool


def sample_process(pid: int, *, reports: int, reachable: bool) -> ProcessSample:
    """Sample a child that has not been reaped, so that its process id is still its own. Source: sched-stats.rst."""
    try:
        waited_s = int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except FileNotFoundError:  # a kernel without these statistics
        waited_s = 0.0
    return ProcessSample(stopped=is_stopped(pid), waited_s=waited_s, reports=reports, reachable=reachable)


@dataclass
class _Record:
    """Previous sample of a process, and the time for which it has been stopped or silent."""

    previous: ProcessSample
    stopped_s: float = 0.0
    silent_s: float = 0.0

    def add(self, sample: ProcessSample, step_s: float, *, bus_silent: bool) -> None:
        self.stopped_s = self.stopped_s + step_s if sample.stopped else 0.0
        if not sample.reachable or self.has_reported(sample):
            self.silent_s = 0.0
        elif not bus_silent:
            self.silent_s += max(0.0, step_s - (sample.waited_s - self.previous.waited_s))
        self.previous = sample

    def has_reported(self, sample: ProcessSample) -> bool:
        """Whether there are new reports in a sample."""
        return sample.reports != self.previous.reports

    @property
    def reason(self) -> str:
        if self.stopped_s >= STOPPED_MAX_S:
            return f"stopped for {self.stopped_s:.2f} s"
        if self.silent_s >= SILENT_MAX_S:
            return f"no report for {self.silent_s:.1f} s, although it is on the bus and had a processor"
        return ""


class FreezeDetector:
    """Detects frozen processes from their samples."""

    def __init__(self) -> None:
        self._records: dict[int, _Record] = {}
        self._last_s: float | None = None
        self._bus_silent_s = 0.0

    def update(self, now_s: float, samples: Mapping[int, ProcessSample]) -> dict[int, str]:
        """Update with new samples; returns the frozen processes and the reason for each.

        Args:
            now_s: monotonic time.
            samples: samples by process id; a missing process has ended.
        """
        step_s = 0.0 if self._last_s is None else min(now_s - self._last_s, STEP_MAX_S)
        self._last_s = now_s
        self._records = {pid: self._records.get(pid) or _Record(sample) for pid, sample in samples.items()}
        any_report = any(self._records[pid].has_reported(sample) for pid, sample in samples.items())
        self._bus_silent_s = 0.0 if any_report else self._bus_silent_s + step_s
        bus_silent = self._bus_silent_s >= BUS_SILENT_MIN_S
        for pid, sample in samples.items():
            self._records[pid].add(sample, step_s, bus_silent=bus_silent)
        return {pid: record.reason for pid, record in self._records.items() if record.reason}
