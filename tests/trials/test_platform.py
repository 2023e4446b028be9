"""Where the vehicle stands on the platform, on numbers worked out by hand."""

import pytest

from jezero.trials.platform import off_platform_reason, on_platform_m
from tests.trials.landing.test_judge import truth


def test_the_touchdown_error_is_in_the_rovers_axes() -> None:
    standing = truth(0, (10.0, 0.3, -0.52), yaw_rad=1.5707963)
    assert on_platform_m(standing) == pytest.approx((0.3, 0.0, -0.02), abs=1e-6)
    assert off_platform_reason(standing, 0.5) == ""
    assert "0.60 m from the middle" in off_platform_reason(truth(0, (10.0, 0.6, -0.5)), 0.5)
    assert "0.50 m above" in off_platform_reason(truth(0, (10.0, 0.0, -1.0)), 0.5)
