"""Limits of the points of goals."""

from typing import Any

import pytest

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, GoToGoal, TakeoffGoal
from jezero.schemas.rows import Action
from jezero.schemas.topics import AREA_COVERAGE, GET_IMAGES, GO_TO, TAKEOFF
from jezero.services.actions.motion.limits import point_refusal
from tests.services.actions.test_behaviours import refusal_of

LOW = -0.3
TRIANGLE = ((0.0, 0.0), (4.0, 0.0), (0.0, 4.0))
LOW_GOALS: list[tuple[Action[Any], Any]] = [
    (GO_TO, GoToGoal(target_ned_m=(1.0, 0.0, LOW))),
    (GO_TO, GoToGoal(target_ned_m=(1.0, 0.0, LOW), frame="rover")),
    (GET_IMAGES, GetImagesGoal(center_ned_m=(0.0, 0.0, LOW), radius_m=2.0, num_images=4)),
    (GET_IMAGES, GetImagesGoal(center_ned_m=(0.0, 0.0, LOW), radius_m=2.0, num_images=4, frame="rover")),
    (AREA_COVERAGE, AreaCoverageGoal(polygon_ned_m=TRIANGLE, z_ned_m=LOW, resolution_m=1.0)),
    (AREA_COVERAGE, AreaCoverageGoal(polygon_ned_m=TRIANGLE, z_ned_m=LOW, resolution_m=1.0, frame="rover")),
]


@pytest.mark.parametrize(("action", "goal"), LOW_GOALS)
def test_every_kind_of_goal_that_is_too_low_is_refused_with_both_numbers(action: Action[Any], goal: Any) -> None:
    assert "z = -0.3 m is 0.3 m up, below the limit of 0.5 m" in refusal_of(action, goal)


def test_a_takeoff_that_is_too_low_is_refused_with_both_numbers() -> None:
    assert (
        refusal_of(TAKEOFF, TakeoffGoal(altitude_m=0.3)) == "altitude 0.3 m is not within 0.5 to 120 m above the ground"
    )


@pytest.mark.parametrize(
    ("point_ned_m", "reason"),
    [
        ((0.0, 0.0, -0.05), "is 0.05 m up, below the limit of 0.5 m"),
        ((0.0, 0.0, 0.0), "5 m up is −5"),
        ((0.0, 0.0, float("nan")), "5 m up is −5"),
        ((0.0, 0.0, -121.0), "beyond the limit of 120 m"),
    ],
)
def test_a_point_outside_the_limits_of_altitude_is_refused(point_ned_m: Vec3, reason: str) -> None:
    assert reason in point_refusal(point_ned_m, VehicleLimitsConfig())


def test_a_point_at_the_least_altitude_is_allowed() -> None:
    assert point_refusal((0.0, 0.0, -0.5), VehicleLimitsConfig()) == ""
