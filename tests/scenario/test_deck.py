"""Landings on a platform that heaves and tilts, on a rover on rocks, and on a fast one."""

import pytest

from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions

WAVES = (0.5, 5.0, 5.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("conditions", "error_max_m"),
    [
        (Conditions(case="uwb+tag", sea=WAVES), 0.1),
        (Conditions(case="uwb+tag", rover="turn", sea=(1.0, 7.0, 5.0)), 0.1),
        (Conditions(case="tag", sea=WAVES), 0.1),
        (Conditions(case="uwb", sea=WAVES), 0.3),
        (Conditions(case="uwb+tag", rover="turn", rocks=True), 0.1),
        (Conditions(case="uwb+tag", rover="fast"), 0.1),
    ],
    ids=["waves", "high waves, turning", "waves, tag", "waves, uwb", "rocks", "fast"],
)
def test_it_lands_on_a_platform_that_moves(conditions: Conditions, error_max_m: float) -> None:
    landing = fly_landing(4, conditions)
    assert landing.failure == ""
    assert landing.error_m < error_max_m
    assert landing.impact_mps < 0.8


@pytest.mark.long
def test_a_deck_beyond_the_limits_is_refused_with_its_figures_and_the_vehicle_hovers() -> None:
    landing = fly_landing(4, Conditions(case="uwb+tag", sea=(2.5, 6.0, 15.0)))
    assert "the platform heaves with" in landing.failure and "a landing is limited to" in landing.failure
    assert not landing.crashed
