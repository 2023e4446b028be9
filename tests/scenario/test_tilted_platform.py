"""The relative position over a rover whose platform isn't level."""

import pytest

from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import CaseName, Conditions


@pytest.mark.parametrize("tilt_deg", [pytest.param(10.0, marks=pytest.mark.slow), 15.0])
@pytest.mark.parametrize(("case", "rmse_max_m"), [("uwb+tag", 0.2), ("uwb", 0.6)])
def test_over_a_tilted_platform_the_estimate_is_as_good_as_over_a_level_one(
    tilt_deg: float, case: CaseName, rmse_max_m: float
) -> None:
    """With anchors turned by the rover's heading alone, the error at 5 m is that height times the tilt: 0.9 m."""
    landing = fly_landing(0, Conditions(case=case, tilt_deg=tilt_deg))
    assert landing.failure == ""
    far_m, near_m = landing.errors.rmse_m(1), landing.errors.rmse_m(0)
    assert far_m is not None and far_m < rmse_max_m
    assert near_m is not None and near_m < 0.1
