"""Speed profiles of straight paths, by numbers worked out by hand."""

import pytest

from jezero.services.actions.motion.straight_path import SpeedProfile


def test_a_profile_goes_from_rest_to_rest() -> None:
    profile = SpeedProfile(4.0, 1.0, 0.5)
    assert profile.duration_s == pytest.approx(6.0)
    assert profile.at(-1.0) == (0.0, 0.0, 0.0)
    assert profile.at(1.0) == pytest.approx((0.25, 0.5, 0.5))
    assert profile.at(3.0) == pytest.approx((2.0, 1.0, 0.0))
    assert profile.at(5.0) == pytest.approx((3.75, 0.5, -0.5))
    assert profile.at(9.0) == (4.0, 0.0, 0.0)
    short = SpeedProfile(0.5, 1.0, 0.5)
    assert short.top_mps == pytest.approx(0.5)
    assert short.duration_s == pytest.approx(2.0)
    assert SpeedProfile(0.0, 1.0, 0.5).at(0.0) == (0.0, 0.0, 0.0)
