"""Outlier rejection for UWB ranges: noise, ranges without line of sight (NLOS), and frozen anchors."""

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence
from itertools import combinations
from statistics import median

from jezero.base.detectors import FrozenSensorDetector
from jezero.schemas.sensors import UwbRange
from jezero.schemas.units import NS_PER_S

NOISE_WINDOW_NS = 2 * NS_PER_S
TREND_WINDOW_NS = NS_PER_S // 2
TREND_SAMPLES_MIN = 5
QUANTILE, QUANTILE_OF_NORMAL = 0.3, 0.385
"""The noise is estimated from a low quantile of the second differences: when a fifth of the ranges is NLOS, half of
the second differences are affected."""
VARIANCE_OF_DIFFERENCE = 6.0
NOISE_SAMPLES_MIN = 20
NLOS_SIGMAS, NLOS_MARGIN_M = 3.0, 0.12
"""A range that exceeds the linear trend of its anchor by more than this is dropped; the margin allows for curvature."""


RangeHistory = deque[tuple[int, float, float | None]]
"""Ranges of one anchor: time, range in m, and absolute second difference in m, None for the first two ranges."""


class RangeOutlierFilter:
    """Compares each range with the last two seconds of its anchor.

    Attributes:
        std_m: estimated standard deviation of a range's white noise, 0 before there are enough samples.
    """

    def __init__(self) -> None:
        self.std_m = 0.0
        self._history: dict[int, RangeHistory] = {}
        self._second_differences_m: list[float] = []
        """All anchors' second differences within the window, in ascending order."""
        self._freeze_detectors: dict[int, FrozenSensorDetector] = {}
        self._frozen: set[int] = set()

    def clear(self) -> None:
        self._history.clear()
        self._second_differences_m.clear()
        self._freeze_detectors.clear()
        self._frozen.clear()
        self.std_m = 0.0

    def filter(self, ranges: Sequence[UwbRange], std_m: float) -> tuple[UwbRange, ...]:
        """Ranges that are neither frozen nor NLOS.

        Args:
            ranges: those of one message.
            std_m: standard deviation that the filter assumes for a range.
        """
        for r in ranges:
            history = self._history.setdefault(r.anchor, deque())
            if history and r.t_ns <= history[-1][0]:
                continue
            self._detect_freeze(r)
            second_difference_m = None
            if len(history) > 1:
                second_difference_m = abs((r.range_m - history[-1][1]) - (history[-1][1] - history[-2][1]))
                insort(self._second_differences_m, second_difference_m)
            history.append((r.t_ns, r.range_m, second_difference_m))
            while history[0][0] < r.t_ns - NOISE_WINDOW_NS:
                _, _, dropped_m = history.popleft()
                if dropped_m is not None:
                    del self._second_differences_m[bisect_left(self._second_differences_m, dropped_m)]
        self._estimate_noise()
        limit_m = NLOS_SIGMAS * max(std_m, self.std_m) + NLOS_MARGIN_M
        return tuple(r for r in ranges if r.anchor not in self._frozen and not self._is_nlos(r, limit_m))

    def _detect_freeze(self, r: UwbRange) -> None:
        if self._freeze_detectors.setdefault(r.anchor, FrozenSensorDetector()).is_frozen(r.range_m):
            self._frozen.add(r.anchor)
        else:
            self._frozen.discard(r.anchor)

    def _is_nlos(self, r: UwbRange, limit_m: float) -> bool:
        """Whether the anchor's newest range is NLOS; for late ranges the filter's innovation gate decides."""
        history = self._history[r.anchor]
        return history[-1][0] == r.t_ns and _excess_over_trend_m(history) > limit_m

    def _estimate_noise(self) -> None:
        """Estimate the noise from second differences, which are independent of speed and nearly so of acceleration."""
        if len(self._second_differences_m) >= NOISE_SAMPLES_MIN:
            self.std_m = _quantile(self._second_differences_m, QUANTILE) / (
                QUANTILE_OF_NORMAL * VARIANCE_OF_DIFFERENCE**0.5
            )


def _quantile(ordered: list[float], fraction: float) -> float:
    """Quantile of a sorted list, interpolated linearly; the rounding equals numpy's."""
    below, weight = divmod(fraction * (len(ordered) - 1), 1.0)
    low, high = ordered[int(below)], ordered[int(below) + 1]
    return low + (high - low) * weight if weight < 0.5 else high - (high - low) * (1.0 - weight)


def _excess_over_trend_m(history: RangeHistory) -> float:
    """Distance of the newest range above the linear trend of the last half second.

    The trend is robust against outliers. Source: the Theil–Sen estimator, the median of the slopes of all pairs.
    """
    newest_ns, newest_m, _ = history[-1]
    recent = [
        (1e-9 * (t_ns - newest_ns), range_m) for t_ns, range_m, _ in history if t_ns >= newest_ns - TREND_WINDOW_NS
    ]
    if len(recent) < TREND_SAMPLES_MIN:
        return 0.0
    slope = median([(r2 - r1) / (t2 - t1) for (t1, r1), (t2, r2) in combinations(recent, 2)])
    return newest_m - median([r - slope * t for t, r in recent])
