"""What many ranges of a vehicle that stands still say of each anchor."""

from collections.abc import Sequence
from math import sqrt
from statistics import fmean, median

import msgspec

from jezero.schemas.units import NS_PER_S

MAD_TO_STD = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""
OUTLIER_STDS, OUTLIER_MIN_M = 4.0, 0.1
"""A range is an outlier when it is farther from the median than both."""


class AnchorStatistics(msgspec.Struct, frozen=True):
    """Ranges of one anchor.

    Attributes:
        count: number of ranges.
        rate_hz: ranges per second.
        median_m: median range.
        std_m: standard deviation of the ranges without outliers.
        outliers: number of ranges far from the median.
    """

    count: int
    rate_hz: float
    median_m: float
    std_m: float
    outliers: int


def statistics_of(ranges_m: Sequence[float], duration_ns: int) -> AnchorStatistics:
    """Statistics of one anchor's ranges.

    Args:
        ranges_m: one or more.
        duration_ns: time in which they were measured.
    """
    middle_m = median(ranges_m)
    spread_m = MAD_TO_STD * median(abs(each - middle_m) for each in ranges_m)
    limit_m = max(OUTLIER_STDS * spread_m, OUTLIER_MIN_M)
    good = [each for each in ranges_m if abs(each - middle_m) <= limit_m]
    mean_m = fmean(good)
    variance_m2 = sum((each - mean_m) ** 2 for each in good) / max(1, len(good) - 1)
    rate_hz = len(ranges_m) * NS_PER_S / duration_ns
    return AnchorStatistics(len(ranges_m), rate_hz, middle_m, sqrt(variance_m2), len(ranges_m) - len(good))
