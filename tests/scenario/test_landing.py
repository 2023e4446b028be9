"""A few landings of the landing benchmark; `jezero bench landing` gives figures from many."""

from functools import partial
from math import degrees

import pytest

from jezero.base.frames import tilt_from_quat
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas import topics
from jezero.schemas.goals import LandOnSpotGoal
from jezero.services.simulator.config import RoverConfig, SimulatorConfig, TerrainConfig
from jezero.trials.landing.benchmark import fly_landings
from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions
from jezero.trials.platform import off_platform_reason
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight


def test_a_plain_landing_gives_a_report() -> None:
    seeds: list[int] = []
    report = fly_landings(Conditions(case="none"), 1, 3, 1, lambda landing: seeds.append(landing.seed))
    assert seeds == [3]
    assert (report.n, report.landed, report.failed_seeds) == (1, 1, [])
    assert report.touchdown_error_m["max"] is not None
    assert report.touchdown_error_m["max"] < 1.0
    assert report.time_s["median"] == report.time_s["p95"]
    assert report.rmse_m == {"below_3m": None, "3_to_8m": None}


@pytest.mark.long
@pytest.mark.parametrize(
    ("conditions", "error_max_m"),
    [
        (Conditions(case="uwb+tag", rover="turn", hide_tag=True), 0.09),
        (Conditions(case="tag"), 0.08),
        (Conditions(case="uwb"), 0.3),
    ],
    ids=["uwb+tag, turning, tag hidden twice", "tag", "uwb"],
)
def test_it_lands_on_the_rover(conditions: Conditions, error_max_m: float) -> None:
    landing = fly_landing(2, conditions)
    assert landing.failure == ""
    assert landing.error_m < error_max_m
    assert landing.time_s < 30.0
    assert landing.impact_mps <= 0.6


@pytest.mark.long
def test_the_benchmark_flies_the_weather_and_the_faults_that_it_names() -> None:
    conditions = Conditions(
        case="uwb+tag",
        rover="zigzag",
        wind_mps=4.0,
        wind_change_mps=2.0,
        tilt_deg=3.0,
        uwb_bias_m=(0.01,),
        tag_until_m=0.3,
    )
    report = fly_landings(conditions, 1, 2, 1)
    assert (report.landed, report.crashed) == (1, 0)
    assert [(one.seed, one.landed, one.crashed, one.reason) for one in report.outcomes] == [(2, True, False, "")]
    assert report.gone_around == sum(one.go_arounds > 0 for one in report.outcomes)


def test_it_takes_off_from_a_hillside_and_lands_on_a_rover_that_leans_with_it() -> None:
    world = SimulatorConfig(
        terrain=TerrainConfig(slope_deg=8.0, slope_towards_deg=40.0), rover=RoverConfig(tilts_with_ground=True)
    )
    flight = Flight(2, partial(build_stack, simulator=world))
    flight.take_off(4.0)
    flight.do(topics.LAND_ON_SPOT, LandOnSpotGoal())
    robot = VehicleConfig()
    assert off_platform_reason(flight.truth, 0.5 * robot.platform.side_m, robot.airframe.height_stand_m) == ""
    assert degrees(tilt_from_quat(flight.truth.q_ned_from_frd)) > 4.0
    assert not flight.status.armed
