"""What the ranges say of themselves: how noisy they are, which of them took a detour, and which are stuck."""

from bisect import bisect_left, insort
from collections import deque
from itertools import combinations
from statistics import median

from jezero.frozen_sensor import FrozenSensorDetector
from jezero.schemas.sensors import Uwb, UwbRange
from jezero.schemas.units import NS_PER_S

NOISE_NS = 2 * NS_PER_S
LINE_NS = NS_PER_S // 2
LINE_MIN = 5
QUANTILE, QUANTILE_OF_NORMAL = 0.3, 0.385
"""A low quantile of the second differences: with a fifth of the ranges too long, half of them are wrong."""
VARIANCE_OF_DIFFERENCE = 6.0
NOISE_SAMPLES_MIN = 20
DETOUR_SIGMAS, DETOUR_MIN_M = 3.0, 0.12
"""A range so much above the line through its anchor's last ones is dropped; the second is what curvature may do."""


Past = deque[tuple[int, float, float | None]]
"""Of an anchor: time, range, and how far the range is from what the two before it went on to (m), if there are two."""


class RangeScreen:
    """Follows the ranges of each anchor for two seconds.

    Attributes:
        std_m: white noise of a range, 0 before enough of them have come.
    """

    def __init__(self) -> None:
        self.std_m = 0.0
        self._past: dict[int, Past] = {}
        self._bends_m: list[float] = []
        """How far all these are off, ascending."""
        self._repeats: dict[int, FrozenSensorDetector] = {}
        self._stuck: set[int] = set()

    def clear(self) -> None:
        self._past.clear()
        self._bends_m.clear()
        self._repeats.clear()
        self._stuck.clear()
        self.std_m = 0.0

    def screen(self, uwb: Uwb, std_m: float) -> tuple[UwbRange, ...]:
        """The ranges that are no longer than their anchor's last ones let expect, and not the same again and again.

        Args:
            std_m: of a range as the filter takes it.
        """
        for r in uwb.ranges:
            past = self._past.setdefault(r.anchor, deque())
            if past and r.t_ns <= past[-1][0]:
                continue
            self._note_repeats(r)
            bend_m = None
            if len(past) > 1:
                bend_m = abs((r.range_m - past[-1][1]) - (past[-1][1] - past[-2][1]))
                insort(self._bends_m, bend_m)
            past.append((r.t_ns, r.range_m, bend_m))
            while past[0][0] < r.t_ns - NOISE_NS:
                _, _, forgotten_m = past.popleft()
                if forgotten_m is not None:
                    del self._bends_m[bisect_left(self._bends_m, forgotten_m)]
        self._measure_noise()
        limit_m = DETOUR_SIGMAS * max(std_m, self.std_m) + DETOUR_MIN_M
        return tuple(r for r in uwb.ranges if r.anchor not in self._stuck and not self._is_detour(r, limit_m))

    def _note_repeats(self, r: UwbRange) -> None:
        if self._repeats.setdefault(r.anchor, FrozenSensorDetector()).is_frozen(r.range_m):
            self._stuck.add(r.anchor)
        else:
            self._stuck.discard(r.anchor)

    def _is_detour(self, r: UwbRange, limit_m: float) -> bool:
        """Whether an anchor's newest range is too long; late ones are left to the filter's gate."""
        past = self._past[r.anchor]
        return past[-1][0] == r.t_ns and _above_line_m(past) > limit_m

    def _measure_noise(self) -> None:
        """From second differences, which no speed and hardly any acceleration enters."""
        if len(self._bends_m) >= NOISE_SAMPLES_MIN:
            self.std_m = _quantile(self._bends_m, QUANTILE) / (QUANTILE_OF_NORMAL * VARIANCE_OF_DIFFERENCE**0.5)


def _quantile(ordered: list[float], share: float) -> float:
    """Linear between the two nearest, rounded as numpy does."""
    below, weight = divmod(share * (len(ordered) - 1), 1.0)
    low, high = ordered[int(below)], ordered[int(below) + 1]
    return low + (high - low) * weight if weight < 0.5 else high - (high - low) * (1.0 - weight)


def _above_line_m(past: Past) -> float:
    """How far the newest range is above the line through the last half second; outliers hardly move that line.

    Source: Theil and Sen, the median of the slopes between all pairs.
    """
    newest_ns, newest_m, _ = past[-1]
    recent = [(1e-9 * (t_ns - newest_ns), range_m) for t_ns, range_m, _ in past if t_ns >= newest_ns - LINE_NS]
    if len(recent) < LINE_MIN:
        return 0.0
    slope = median([(r2 - r1) / (t2 - t1) for (t1, r1), (t2, r2) in combinations(recent, 2)])
    return newest_m - median([r - slope * t for t, r in recent])
