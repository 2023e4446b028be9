"""Measurements in the order of their own times, whatever the order in which they arrive."""

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter

import msgspec

from jezero.services.estimator.kalman import Kalman, Moment, Verdict
from jezero.services.estimator.measurements import Kind, Measurement

KEPT_NS = 2_000_000_000
"""Longer than any measurement is late, and long enough to judge an input by."""
REFUSED_SHARE = 0.2
"""What is used of a measurement, or of several, less than this share is refused."""
RANK: dict[Kind, int] = {"odometry": 0, "rover": 1, "altimeter": 2, "uwb": 3, "tag": 4, "locate": 5}
"""Order of measurements of one instant."""


class Entry(msgspec.Struct):
    """A measurement and the filter after it; `key` is the measurement's place in the order."""

    key: tuple[int, int]
    measurement: Measurement
    after: Moment
    verdict: Verdict


def _key(measurement: Measurement) -> tuple[int, int]:
    return (measurement.t_ns, RANK[measurement.kind])


_BY_KEY = attrgetter("key")


@dataclass(slots=True)
class Tally:
    """A span of one kind's measurements.

    Attributes:
        newest: of them.
        first_ns: time of the oldest.
        offered, used: parts, as in `Verdict`, of all of them.
    """

    newest: Measurement
    measurements: int = 0
    first_ns: int = 0
    offered: int = 0
    used: int = 0


class Timeline:
    """A filter with its recent past: a late measurement is put where it belongs and what came after is done again.

    Attributes:
        entries: oldest first.
        used_ns: time of the newest measurement of each kind that was fused.
        refused: whether the last one of each kind was refused.
    """

    def __init__(self, kalman: Kalman, start: Moment, gate: tuple[float, float]) -> None:
        kalman.restore(start)
        self.kalman = kalman
        self.entries: list[Entry] = []
        self.used_ns: dict[Kind, int] = {}
        self.refused: dict[Kind, bool] = {}
        self._start = start
        self._gate = gate

    def add(self, measurements: Iterable[Measurement]) -> None:
        """Fuse measurements that are not older than what is kept; one that is there already is left out."""
        added: list[Measurement] = []
        for measurement in measurements:
            if measurement.t_ns >= self._start.t_ns and not self._is_known(measurement):
                added.append(measurement)
        if not added:
            return
        first = bisect_right(self.entries, min(_key(m) for m in added), key=_BY_KEY)
        again = [entry.measurement for entry in self.entries[first:]]
        del self.entries[first:]
        self.kalman.restore(self.entries[-1].after if self.entries else self._start)
        for measurement in sorted([*again, *added], key=_key):
            self._fuse(measurement)
        self._forget()

    def tally(self, kind: Kind, since_ns: int) -> Tally | None:
        """What became of a kind's measurements from a time on, or from the last location on; None: there were none."""
        tally: Tally | None = None
        for entry in reversed(self.entries):
            measurement = entry.measurement
            if measurement.kind != kind:
                if measurement.t_ns < since_ns or measurement.kind == "locate":
                    break
                continue
            if measurement.t_ns < since_ns:
                break
            if entry.verdict.offered:
                tally = tally or Tally(measurement)
                tally.measurements += 1
                tally.offered += entry.verdict.offered
                tally.used += entry.verdict.used
                tally.first_ns = measurement.t_ns
        return tally

    def _fuse(self, measurement: Measurement) -> None:
        self.kalman.predict_to(measurement.t_ns)
        verdict = measurement.fuse(self.kalman, self._gate)
        if verdict.offered:
            self.refused[measurement.kind] = verdict.used < REFUSED_SHARE * verdict.offered
        if verdict.used:
            self.used_ns[measurement.kind] = max(measurement.t_ns, self.used_ns.get(measurement.kind, 0))
        self.entries.append(Entry(_key(measurement), measurement, self.kalman.save(), verdict))

    def _is_known(self, measurement: Measurement) -> bool:
        key = _key(measurement)
        i = bisect_right(self.entries, key, key=_BY_KEY)
        return i > 0 and self.entries[i - 1].key == key

    def _forget(self) -> None:
        until_ns = self.kalman.t_ns - KEPT_NS
        if self.entries[0].measurement.t_ns <= until_ns:
            kept = bisect_right(self.entries, until_ns, key=lambda entry: entry.measurement.t_ns)
            self._start = self.entries[kept - 1].after
            del self.entries[:kept]
