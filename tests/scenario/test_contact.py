"""Landings whose contact with the platform goes wrong, or looks so: slopes and wind."""

import pytest

from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions


@pytest.mark.parametrize("tilt_deg", [10.0, 15.0])
def test_a_platform_that_is_tilted_is_a_slope_and_not_an_edge(tilt_deg: float) -> None:
    """By the tags alone."""
    landing = fly_landing(0, Conditions(case="tag", tilt_deg=tilt_deg))
    assert landing.failure == ""
    assert not landing.crashed


def test_a_landing_in_strong_wind_with_gusts_needs_no_go_around() -> None:
    landing = fly_landing(0, Conditions(case="uwb+tag", wind_mps=8.0, std_gust_mps=1.5))
    assert landing.failure == ""
    assert landing.go_arounds == 0
