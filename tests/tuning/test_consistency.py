"""Consistency of innovations that are made by hand; the predicted standard deviation is 0.05 = √(0.03² + 0.04²)."""

import numpy as np
import pytest

from jezero.tuning.consistency import COUNT_MIN, Consistency, fit_setting, judge, setting_in_use
from tests.tuning.rig import an_innovation


def judged(*residuals: list[float], rejected: int = 0) -> Consistency:
    size = len(residuals[0])
    found = judge([[an_innovation(i, each, accepted=[i >= rejected] * size) for i, each in enumerate(residuals)]])
    assert found is not None
    return found


def test_nis_is_the_mean_square_over_the_predicted_variance() -> None:
    found = judged(*([0.05 * sign] for sign in [1.0, -1.0] * 20))
    assert found.count == 40
    assert found.nis == pytest.approx(1.0)
    assert list(found.mean) == pytest.approx([0.0])
    assert list(found.std) == pytest.approx([0.05])
    assert list(found.std_predicted) == pytest.approx([0.05])
    assert found.autocorrelation == pytest.approx(-39.0 / 40.0)


def test_nis_is_divided_by_the_number_of_components() -> None:
    found = judged(*([0.1 * sign, 0.0, 0.0] for sign in [1.0, 1.0, -1.0, -1.0] * 10))
    assert found.nis == pytest.approx(4.0 / 3.0)  # (0.1 / 0.05)² + 0 + 0, over 3
    assert list(found.std) == pytest.approx([0.1, 0.0, 0.0])


def test_a_mean_that_stays_is_shown() -> None:
    found = judged(*([0.01 + 0.05 * sign] for sign in [1.0, -1.0] * 20))
    assert list(found.mean) == pytest.approx([0.01])
    assert list(found.std) == pytest.approx([0.05])


def test_rejected_measurements_count_as_such_and_not_for_nis() -> None:
    found = judged(*([5.0] if i < 10 else [0.05] for i in range(40)), rejected=10)
    assert found.rejected == pytest.approx(0.25)
    assert found.nis == pytest.approx(1.0)
    assert list(found.mean) == pytest.approx([0.05])


def test_a_sensor_that_is_rejected_always_has_no_nis_but_a_noise_that_fits() -> None:
    innovations = [an_innovation(i, [0.5 * (-1.0) ** i], accepted=[False]) for i in range(40)]
    found = judge([innovations])
    assert found is not None
    assert (found.rejected, found.nis, found.mean) == (1.0, None, (None,))
    fit = fit_setting([innovations], 40.0)
    assert fit is not None and fit.value == pytest.approx(0.5, rel=0.02)


def test_too_few_measurements_are_not_judged() -> None:
    innovations = [an_innovation(i, [0.05]) for i in range(COUNT_MIN)]
    assert judge([innovations]) is not None
    assert judge([innovations[1:]]) is None


def test_rounds_with_a_missing_range_count_for_nis_only() -> None:
    innovations = [an_innovation(i, [0.05, 0.05] if i % 4 else [-0.05]) for i in range(40)]
    found = judge([innovations])
    assert found is not None
    assert found.count == 40 and len(found.mean) == 2
    assert found.nis == pytest.approx(1.0)


def test_the_autocorrelation_does_not_reach_from_one_flight_into_the_next() -> None:
    flight = [an_innovation(i, [0.05 * (-1.0) ** (i // 2)]) for i in range(40)]  # + + - - + + …
    found = judge([flight, flight])
    assert found is not None
    assert found.autocorrelation == pytest.approx((20.0 - 19.0) / 40.0)


def test_a_noise_without_a_setting_is_not_fitted() -> None:
    innovations = [an_innovation(i, [0.05], setting=None) for i in range(40)]
    assert fit_setting([innovations], 40.0) is None
    assert setting_in_use([innovations]) is None


def test_the_fitted_setting_scales_the_noise_that_it_stands_for() -> None:
    """A factor of 2 on a noise of 0.02 gives the innovations' noise of 0.04; the state's error is known exactly."""
    rng = np.random.default_rng(2)
    innovations = [
        an_innovation(i, [0.04 * float(rng.standard_normal())], std_state=1e-6, std_noise=0.02, setting=1.0)
        for i in range(2000)
    ]
    fit = fit_setting([innovations], 2000.0)
    assert fit is not None and fit.value == pytest.approx(2.0, rel=0.05)
