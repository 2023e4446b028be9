"""Statistics of innovations: whiteness, consistency (NIS), and the noise that makes them consistent.

Source: Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation, §5.4 and §11.6.
"""

from collections.abc import Callable, Sequence
from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np

from jezero.base.arrays import Array

CONFIDENCE = 0.95
MEDIAN_OF_CHI2 = 0.454936
"""Median of a squared standard normal variable."""
OUTLIER_CHI2, MEAN_WITHOUT_OUTLIERS = 10.8, 0.98816
"""Limit of normalised squared innovations that are not outliers, exceeded by one normal variable in thousand, and the
mean square of a standard normal variable within this limit."""
STD_ERROR_OF_MEAN_SQUARE = 0.7071
"""Relative standard error of a standard deviation that is estimated by a mean square, times the root of the count."""
LAGS_MAX = 200
SHARE_MIN = 0.2
"""Where measurement noise makes up less of the predicted variance, innovations show the state's error only."""
SEARCH_FACTOR = 1e3
SEARCH_STEPS = 60


def autocorrelation(z: Array, lag: int = 1) -> float:
    """Autocorrelation of a series whose expected mean is 0.

    Args:
        z: (n,) samples with n > lag; not all 0.
        lag: number of samples between the factors of a product.
    """
    return float(z[lag:] @ z[:-lag]) / float(z @ z)


def significant_correlations(z: Array) -> list[float]:
    """Autocorrelations from lag 1 up to the first that is not distinguishable from 0 at the 95 % level."""
    noise = 2.0 / sqrt(len(z))
    found: list[float] = []
    for lag in range(1, min(LAGS_MAX, len(z) - 1)):
        correlation = autocorrelation(z, lag)
        if abs(correlation) < noise:
            break
        found.append(correlation)
    return found


def effective_count(count: int, correlations: Sequence[float]) -> float:
    """Number of independent samples whose mean square is as certain as that of `count` correlated samples.

    The squares of normal variables with the correlation r have the correlation r².

    Args:
        count: number of samples.
        correlations: autocorrelations of the samples from lag 1 on.
    """
    return count / (1.0 + 2.0 * sum(r * r for r in correlations))


def chi2_band(dof: float) -> tuple[float, float]:
    """The 95 % band of a mean of squared standard normal variables.

    Args:
        dof: number of independent ones.
    """
    from scipy.stats import chi2

    low, high = chi2.ppf((0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE), dof) / dof
    return float(low), float(high)


class ConsistentSetting(NamedTuple):
    """Noise setting that makes innovations consistent.

    Attributes:
        value: the setting.
        std_relative: standard error of the setting, relative to its value.
        is_bound: whether the value is only the greatest possible one: even without any measurement noise, the predicted
            error of the state would explain the innovations.
    """

    value: float
    std_relative: float
    is_bound: bool


def consistent_setting(
    residual: Array, var_state: Array, var_per_setting: Array, start: float, count: float
) -> ConsistentSetting:
    """Find the setting v with which the innovations are as large as predicted.

    The predicted variance of an innovation is `var_state` + v² `var_per_setting`. Each innovation counts with the share
    of the measurement noise in its variance, as in a maximum-likelihood estimate. A median, which stands up to outliers
    and to any number of rejected measurements, finds the setting roughly; the mean square of those that are no outliers
    then finds it exactly.

    Args:
        residual: (n,) innovations, rejected ones too.
        var_state: (n,) predicted variances of the state's part.
        var_per_setting: (n,) variances of the measurement noise for a setting of 1.
        start: setting in use; the result lies within a factor of 1000.
        count: number of independent ones among the innovations.
    """
    found = _solve(residual, var_state, var_per_setting, start)
    noise = found * found * var_per_setting
    weights = noise / (var_state + noise)
    share = float(weights @ weights / weights.sum())
    if share < SHARE_MIN:
        bound = _solve(residual, np.zeros_like(var_state), var_per_setting, start)
        return ConsistentSetting(bound, STD_ERROR_OF_MEAN_SQUARE / sqrt(count), True)
    evenness = float(weights.sum()) ** 2 / (len(weights) * float(weights @ weights))
    return ConsistentSetting(found, STD_ERROR_OF_MEAN_SQUARE / sqrt(count * evenness) / share, False)


def _solve(residual: Array, var_state: Array, var_per_setting: Array, start: float) -> float:
    """The setting that makes the innovations as large as predicted."""
    square = residual * residual

    def excess_of_median(setting: float) -> float:
        noise = setting * setting * var_per_setting
        cov = var_state + noise
        return weighted_median(square / cov, noise / cov) - MEDIAN_OF_CHI2

    rough = _root(excess_of_median, start)
    kept = square <= OUTLIER_CHI2 * (var_state + rough * rough * var_per_setting)

    def excess_of_mean(setting: float) -> float:
        noise = setting * setting * var_per_setting[kept]
        cov = var_state[kept] + noise
        return float(np.average(square[kept] / cov, weights=noise / cov)) - MEAN_WITHOUT_OUTLIERS

    return _root(excess_of_mean, start)


def _root(excess: Callable[[float], float], start: float) -> float:
    """Where a falling function is 0, by bisection of the logarithm; an end of the search range when it is nowhere."""
    low, high = log(start / SEARCH_FACTOR), log(start * SEARCH_FACTOR)
    for _ in range(SEARCH_STEPS):
        middle = 0.5 * (low + high)
        if excess(exp(middle)) > 0.0:
            low = middle
        else:
            high = middle
    return exp(0.5 * (low + high))


def weighted_median(values: Array, weights: Array) -> float:
    """The least value up to which lies half of all weight."""
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, 0.5 * summed[-1])])
