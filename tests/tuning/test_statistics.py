"""Statistics of innovations, by numbers worked out by hand."""

from math import sqrt

import numpy as np
import pytest

from jezero.base.arrays import Array
from jezero.tuning.statistics import (
    autocorrelation,
    chi2_band,
    consistent_setting,
    effective_count,
    significant_correlations,
    weighted_median,
)


def normals(n: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal(n)


def test_the_autocorrelation_is_the_mean_product_of_neighbours_over_the_mean_square() -> None:
    z = np.array([1.0, 2.0, -1.0, 0.0, 2.0])  # squares 1 + 4 + 1 + 0 + 4 = 10
    assert autocorrelation(z) == pytest.approx((2.0 - 2.0 + 0.0 + 0.0) / 10.0)
    assert autocorrelation(z, lag=2) == pytest.approx((-1.0 + 0.0 - 2.0) / 10.0)


def test_a_constant_error_correlates_fully() -> None:
    assert autocorrelation(np.ones(100)) == pytest.approx(0.99)


def test_correlated_samples_count_less() -> None:
    assert effective_count(100, ()) == 100.0
    assert effective_count(100, (0.5,)) == pytest.approx(100.0 / 1.5)  # 1 + 2 · 0.5²
    assert effective_count(100, (0.5, -0.5)) == pytest.approx(50.0)  # 1 + 2 · 0.25 + 2 · 0.25
    assert effective_count(90, (1.0,)) == pytest.approx(30.0)


def test_samples_that_each_occur_twice_count_as_two_thirds() -> None:
    """Each has the correlation 0.5 with its neighbours on average: with one 1, with the other 0."""
    z = np.repeat(normals(5000), 2)
    correlations = significant_correlations(z)
    assert correlations[0] == pytest.approx(0.5, abs=0.05)
    assert effective_count(len(z), correlations) == pytest.approx(len(z) / 1.5, rel=0.05)


def test_white_noise_has_no_significant_correlation() -> None:
    assert significant_correlations(normals(1000)) == []


def test_the_band_of_nis_is_that_of_chi_square_over_its_degrees_of_freedom() -> None:
    assert list(chi2_band(10.0)) == pytest.approx([0.3247, 2.0483], abs=1e-4)  # table: 3.247 and 20.483
    nearly_normal = [1.0 - 0.0877, 1.0 + 0.0877]  # 1 ± 1.96 · √(2 / 1000)
    assert list(chi2_band(1000.0)) == pytest.approx(nearly_normal, abs=2e-3)


def test_a_weighted_median_has_half_of_the_weight_on_each_side() -> None:
    values = np.array([3.0, 1.0, 2.0])
    assert weighted_median(values, np.ones(3)) == 2.0
    assert weighted_median(values, np.array([5.0, 1.0, 1.0])) == 3.0
    assert weighted_median(values, np.array([1.0, 4.0, 1.0])) == 1.0


@pytest.mark.parametrize("wrong", [0.1, 1.0, 10.0])
def test_the_noise_is_what_the_innovations_have_beyond_the_error_of_the_state(wrong: float) -> None:
    n = 4000
    residual = sqrt(0.03**2 + 0.04**2) * normals(n)
    found = consistent_setting(residual, np.full(n, 0.03**2), np.ones(n), 0.04 * wrong, n)
    assert not found.is_bound
    assert found.value == pytest.approx(0.04, rel=0.06)
    assert found.std_relative == pytest.approx(0.7071 / sqrt(n) / 0.64, rel=0.05)  # 0.64 = 0.04² / (0.03² + 0.04²)


def test_the_standard_error_is_the_spread_over_many_flights() -> None:
    n, state = 300, np.full(300, 0.03**2)
    found = [consistent_setting(0.05 * normals(n, seed), state, np.ones(n), 0.04, n) for seed in range(200)]
    values = [each.value for each in found]
    assert np.std(values) / np.mean(values) == pytest.approx(np.mean([each.std_relative for each in found]), rel=0.2)


def test_outliers_hardly_change_the_noise() -> None:
    residual = 0.05 * normals(2000)
    residual[::10] = 3.0
    found = consistent_setting(residual, np.zeros(2000), np.ones(2000), 0.05, 2000)
    assert found.value == pytest.approx(0.05, rel=0.1)


def test_innovations_smaller_than_the_error_of_the_state_give_a_bound_only() -> None:
    found = consistent_setting(0.02 * normals(2000), np.full(2000, 0.1**2), np.ones(2000), 0.05, 2000)
    assert found.is_bound
    assert found.value == pytest.approx(0.02, rel=0.05)  # as if the state had no error


def test_measurements_whose_noise_is_hidden_by_the_state_hardly_count() -> None:
    """Half of them are from far away, where the state's error is overestimated tenfold; the others show the noise."""
    n = 4000
    far = np.arange(n) % 2 == 0
    residual = np.where(far, 0.1, 0.02) * normals(n)
    found = consistent_setting(residual, np.where(far, 1.0**2, 1e-6), np.ones(n), 0.05, n)
    assert found.value == pytest.approx(0.02, rel=0.1)
