"""Measurements sorted by their time stamps, so that delayed ones are fused in the right order."""

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import get_args

import msgspec

from jezero.services.estimator.kalman import FilterState, Kalman, UpdateResult
from jezero.services.estimator.measurements import Kind, Measurement

HISTORY_LENGTH_NS = 2_000_000_000
"""Longer than the greatest delay of a measurement, and than the window of the rejection statistics."""
ACCEPTED_FRACTION_MIN = 0.2
"""An input counts as rejected when a smaller fraction of its components passes the gate."""
ORDER_AT_SAME_TIME: dict[Kind, int] = {kind: i for i, kind in enumerate(get_args(Kind))}


class HistoryEntry(msgspec.Struct):
    """A measurement with the filter state after its update; `key` is its sort key."""

    key: tuple[int, int]
    measurement: Measurement
    after: FilterState
    result: UpdateResult


def _key(measurement: Measurement) -> tuple[int, int]:
    return (measurement.t_ns, ORDER_AT_SAME_TIME[measurement.kind])


_BY_KEY = attrgetter("key")


@dataclass(slots=True)
class AcceptanceStatistics:
    """Counts of accepted and rejected measurements of one kind within a time window.

    Attributes:
        newest: the newest measurement in the window.
        measurements: number of measurements.
        first_ns: time of the oldest one.
        offered: sum of `UpdateResult.offered`.
        used: sum of `UpdateResult.used`.
    """

    newest: Measurement
    measurements: int = 0
    first_ns: int = 0
    offered: int = 0
    used: int = 0


class MeasurementHistory:
    """A filter with its recent measurements: a late one is inserted in order, and all later ones are fused again.

    Attributes:
        entries: oldest first.
        used_ns: time of the newest fused measurement of each kind.
        rejected: whether the last measurement of each kind was rejected.
    """

    def __init__(self, kalman: Kalman, start: FilterState, gate: tuple[float, float]) -> None:
        kalman.restore(start)
        self.kalman = kalman
        self.entries: list[HistoryEntry] = []
        self.used_ns: dict[Kind, int] = {}
        self.rejected: dict[Kind, bool] = {}
        self._start = start
        self._gate = gate

    def add(self, measurements: Iterable[Measurement]) -> None:
        """Fuse measurements; duplicates and those older than the history are skipped."""
        added: list[Measurement] = []
        for measurement in measurements:
            if measurement.t_ns >= self._start.t_ns and not self._is_known(measurement):
                added.append(measurement)
        if not added:
            return
        first = bisect_right(self.entries, min(_key(m) for m in added), key=_BY_KEY)
        later = [entry.measurement for entry in self.entries[first:]]
        del self.entries[first:]
        self.kalman.restore(self.entries[-1].after if self.entries else self._start)
        for measurement in sorted([*later, *added], key=_key):
            self._fuse(measurement)
        self._drop_old()

    def statistics(self, kind: Kind, since_ns: int) -> AcceptanceStatistics | None:
        """Statistics of one kind since `since_ns` or the last position reset; None when nothing was measured."""
        statistics: AcceptanceStatistics | None = None
        for entry in reversed(self.entries):
            measurement = entry.measurement
            if measurement.kind != kind:
                if measurement.t_ns < since_ns or measurement.kind == "locate":
                    break
                continue
            if measurement.t_ns < since_ns:
                break
            if entry.result.offered:
                statistics = statistics or AcceptanceStatistics(measurement)
                statistics.measurements += 1
                statistics.offered += entry.result.offered
                statistics.used += entry.result.used
                statistics.first_ns = measurement.t_ns
        return statistics

    def _fuse(self, measurement: Measurement) -> None:
        self.kalman.predict_to(measurement.t_ns)
        result = measurement.fuse(self.kalman, self._gate)
        if result.offered:
            self.rejected[measurement.kind] = result.used < ACCEPTED_FRACTION_MIN * result.offered
        if result.used:
            self.used_ns[measurement.kind] = max(measurement.t_ns, self.used_ns.get(measurement.kind, 0))
        self.entries.append(HistoryEntry(_key(measurement), measurement, self.kalman.save(), result))

    def _is_known(self, measurement: Measurement) -> bool:
        if measurement.kind == "locate":  # made by the filter itself: a turn and a position of one time are two resets
            return False
        key = _key(measurement)
        i = bisect_right(self.entries, key, key=_BY_KEY)
        return i > 0 and self.entries[i - 1].key == key

    def _drop_old(self) -> None:
        until_ns = self.kalman.t_ns - HISTORY_LENGTH_NS
        if self.entries[0].measurement.t_ns <= until_ns:
            kept = bisect_right(self.entries, until_ns, key=lambda entry: entry.measurement.t_ns)
            self._start = self.entries[kept - 1].after
            del self.entries[:kept]
