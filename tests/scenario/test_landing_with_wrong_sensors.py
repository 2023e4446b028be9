"""Landings with a sensor that is wrong all the time, or becomes wrong: they land, or end with the reason."""

import pytest

from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    "conditions",
    [
        Conditions(case="uwb+tag", uwb_bias_m=(0.3,)),
        Conditions(case="uwb+tag", uwb_bias_m=(0.3, 0.0, 0.0, 0.0)),
        Conditions(case="uwb+tag", anchors_rotated=True),
        Conditions(case="uwb+tag", rover_compass_deg=90.0),
        Conditions(case="uwb+tag", compass_step_deg=45.0),
        Conditions(case="tag", tag_side_m=0.5),
    ],
    ids=["all ranges long", "one anchor long", "anchors mislabelled", "rover compass", "compass jumps", "other tag"],
)
def test_a_landing_with_one_wrong_sensor_lands_by_the_others(conditions: Conditions) -> None:
    landing = fly_landing(0, conditions)
    assert landing.failure == ""
    assert not landing.crashed


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_landing_by_uwb_alone_with_mislabelled_anchors_lands_or_names_what_contradicts_them(seed: int) -> None:
    landing = fly_landing(seed, Conditions(case="uwb", anchors_rotated=True))
    assert not landing.crashed
    if landing.failure:
        assert any(word in landing.failure for word in ("anchor", "compass", "altimeter")), landing.failure
