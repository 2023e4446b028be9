"""Landings whose contact with the platform goes wrong, or looks so: slopes and wind."""

import pytest

from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions


@pytest.mark.long
@pytest.mark.parametrize("tilt_deg", [pytest.param(10.0, marks=pytest.mark.slow), 15.0])
def test_a_platform_that_is_tilted_is_a_slope_and_not_an_edge(tilt_deg: float) -> None:
    """By the tags alone."""
    landing = fly_landing(0, Conditions(case="tag", tilt_deg=tilt_deg))
    assert landing.failure == ""
    assert not landing.crashed


@pytest.mark.long
def test_a_landing_in_strong_wind_with_gusts_needs_no_go_around() -> None:
    landing = fly_landing(0, Conditions(case="uwb+tag", wind_mps=8.0, std_gust_mps=1.5))
    assert landing.failure == ""
    assert landing.go_arounds == 0


@pytest.mark.long
def test_a_platform_too_steep_to_stand_on_ends_the_landing_after_three_go_arounds_with_its_slope() -> None:
    landing = fly_landing(0, Conditions(case="uwb+tag", tilt_deg=25.0))
    assert "the vehicle was tilted by 2" in landing.failure
    assert "in spite of 3 go-arounds: land where it is level" in landing.failure
    assert not landing.crashed


@pytest.mark.long
def test_a_tag_that_is_hidden_near_the_platform_ends_the_landing_with_the_height_below_which_nothing_is_seen() -> None:
    landing = fly_landing(0, Conditions(case="tag", tag_until_m=1.5))
    assert "the descent was interrupted 4 times, 1." in landing.failure
    assert "no measurement of the rover" in landing.failure
    assert not landing.crashed


@pytest.mark.long
def test_pictures_that_come_too_late_are_named_when_the_landing_by_the_tags_alone_ends() -> None:
    landing = fly_landing(0, Conditions(case="tag", camera_delay_s=0.45))
    assert "measurements by the tag arrive 0.4" in landing.failure
    assert "0.4 s are permitted (max_age_s)" in landing.failure
    assert not landing.crashed
