"""What the pictures of a coverage show: by hand for one picture, before the flight for a plan, and as flown."""

from math import pi, radians, tan
from typing import Any

import msgspec
import numpy as np
import pytest
from shapely.geometry import box

from jezero.base.vehicle_config import CameraMountConfig
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, PlanReply, Rejected, Result
from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.actions.area_coverage.area import AreaError
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.area_coverage.ground import photographed_fraction, planned_footprint
from jezero.services.actions.config import ActionsConfig
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.rig import World

CAMERA = CameraMountConfig()
FIELD = ((0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0))
GOAL = AreaCoverageGoal(polygon_ned_m=FIELD, z_ned_m=-5.0, resolution_m=10.0)
HALF_WIDE_M = 5.0 * tan(radians(40.0))
HALF_LONG_M = 0.75 * HALF_WIDE_M
"""Half a picture from 5 m: 80 degrees across 640 pixels, 480 pixels along."""


def changed(**fields: Any) -> AreaCoverageGoal:
    return msgspec.structs.replace(GOAL, **fields)


def corners(footprint_m: Any) -> set[tuple[float, float]]:
    return {(round(float(north_m), 2), round(float(east_m), 2)) for north_m, east_m in footprint_m}


def all_signs(north_m: float, east_m: float) -> set[tuple[float, float]]:
    return {(round(n * north_m, 2), round(e * east_m, 2)) for n in (-1, 1) for e in (-1, 1)}


def test_a_picture_is_wide_across_the_heading() -> None:
    assert corners(planned_footprint(CAMERA, 0.0, 5.0)) == all_signs(HALF_LONG_M, HALF_WIDE_M)
    assert corners(planned_footprint(CAMERA, 0.5 * pi, 5.0)) == all_signs(HALF_WIDE_M, HALF_LONG_M)


def test_a_camera_that_looks_ahead_shows_ground_ahead() -> None:
    ahead = CameraMountConfig(pitch_offset_rad=0.3)
    assert float(planned_footprint(ahead, 0.0, 5.0)[:, 0].mean()) > 1.0
    horizon = planned_footprint(CameraMountConfig(pitch_offset_rad=1.5), 0.0, 5.0)
    assert np.isfinite(horizon).all()


def test_the_photographed_fraction_is_that_of_all_pictures_together() -> None:
    footprint_m = planned_footprint(CAMERA, 0.0, 5.0)
    area = box(0.0, 0.0, 20.0, 20.0)  # north, east
    one = 4.0 * HALF_LONG_M * HALF_WIDE_M / 400.0
    middle, same, corner = (10.0, 10.0), (10.0, 10.0), (0.0, 0.0)
    assert photographed_fraction(area, np.array([middle]), footprint_m) == pytest.approx(one, rel=0.03)
    assert photographed_fraction(area, np.array([middle, same]), footprint_m) == pytest.approx(one, rel=0.03)
    assert photographed_fraction(area, np.array([middle, corner]), footprint_m) == pytest.approx(1.25 * one, rel=0.03)


def test_a_resolution_larger_than_a_picture_is_refused_with_what_the_pictures_would_show() -> None:
    with pytest.raises(AreaError, match=r"only 6\d % of the area would be in the pictures") as refused:
        plan_coverage(GOAL, ActionsConfig())
    assert "each shows 8.4 m x 6.3 m of the ground, lines are 10 m and pictures 10 m apart" in str(refused.value)
    assert "take a resolution of 3.1 m" in str(refused.value)
    with pytest.raises(AreaError, match="lines are 1000 m and pictures 1000 m apart"):
        plan_coverage(changed(resolution_m=1000.0), ActionsConfig())
    followed = plan_coverage(changed(resolution_m=3.1), ActionsConfig())
    assert followed.photographs.fraction > 0.999
    assert followed.warning == ""


def test_with_force_it_is_planned_and_both_fractions_are_told() -> None:
    plan = plan_coverage(changed(force=True), ActionsConfig())
    assert plan.covered > 0.99
    assert plan.photographs.fraction < 0.7
    assert plan.warning.startswith("only 6")
    assert "pictures overlap by 0 % along the lines and 0 % across them" in plan.warning


@pytest.mark.parametrize(("overlap", "warned"), [(0.3, True), (0.49, True), (0.5, False), (0.65, False)])
def test_an_overlap_below_a_half_is_warned_of(overlap: float, warned: bool) -> None:
    plan = plan_coverage(changed(resolution_m=None, overlap=overlap), ActionsConfig())
    assert ("leave gaps" in plan.warning) == warned


def test_one_picture_of_the_whole_area_needs_no_overlap() -> None:
    small = changed(polygon_ned_m=((0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)), resolution_m=100.0)
    plan = plan_coverage(small, ActionsConfig())
    assert (plan.photographs.count, plan.photographs.fraction, plan.warning) == (1, 1.0, "")


@pytest.mark.parametrize("words", [{"overlap": 0.65, "sidelap": 0.2}, {"overlap": 0.2, "sidelap": 0.65}])
def test_the_smaller_of_overlap_and_sidelap_counts(words: dict[str, float]) -> None:
    assert "leave gaps" in plan_coverage(changed(resolution_m=None, **words), ActionsConfig()).warning


def test_the_number_of_pictures_is_judged_by_the_path() -> None:
    """A strip much narrower than the lines' distance has little area and a long path."""
    strip = changed(polygon_ned_m=((0.0, 0.0), (400.0, 0.0), (400.0, 0.05), (0.0, 0.05)), resolution_m=0.1)
    assert 400.0 * 0.05 / 0.1**2 < 3000
    with pytest.raises(AreaError, match=r"the path of \d+ m needs \d+ pictures, more than 3000"):
        plan_coverage(strip, ActionsConfig())


def test_a_flight_too_high_for_a_map_is_refused_before_it() -> None:
    with pytest.raises(AreaError, match=r"at 12 m the altimeter does not reach the ground.* is at 9\.9 m: fly lower"):
        plan_coverage(changed(z_ned_m=-12.0), ActionsConfig())
    assert plan_coverage(changed(z_ned_m=-9.9, resolution_m=5.0), ActionsConfig()).warning == ""
    forced = plan_coverage(changed(z_ned_m=-12.0, resolution_m=5.0, force=True), ActionsConfig())
    assert forced.warning.startswith("at 12 m the altimeter does not reach the ground, so jezero makes no map")


def test_a_speed_that_the_camera_limits_is_warned_of() -> None:
    plan = plan_coverage(changed(resolution_m=1.0, speed_mps=9.0), ActionsConfig())
    assert plan.warning.startswith("flown at 7.5 m/s instead of 9 m/s")


# -- through the server --

SMALL = AreaCoverageGoal(
    polygon_ned_m=((0.0, 0.0), (12.0, 0.0), (12.0, 12.0), (0.0, 12.0)), z_ned_m=-4.0, resolution_m=8.0, speed_mps=3.0
)


@pytest.fixture
def world() -> World:
    made = World()
    made.bus.add(FakeCamera())
    made.bus.run_for(0.3)
    return made


def plan_reply(world: World, goal: AreaCoverageGoal) -> PlanReply:
    request = world.bus.send_request(topics.AREA_COVERAGE.plan, goal, "me")
    assert world.bus.run_for(5.0, lambda: request.ended)
    reply = request.replies[-1]
    assert isinstance(reply, PlanReply)
    return reply


def test_plan_and_goal_are_refused_alike_and_warned_of_alike(world: World) -> None:
    refused, rejected = plan_reply(world, SMALL), world.fly(SMALL)
    assert isinstance(rejected, Rejected)
    assert refused.reason == rejected.reason
    assert "of the area would be in the pictures" in refused.reason
    forced = msgspec.structs.replace(SMALL, force=True)
    warned = plan_reply(world, forced)
    assert warned.accepted
    answers = world.send(forced)
    assert world.bus.run_for(5.0, lambda: bool(answers.replies))
    accepted = answers.replies[0]
    assert isinstance(accepted, Accepted)
    assert accepted.warning == warned.warning != ""


def test_the_result_tells_what_was_covered_and_what_was_photographed(world: World) -> None:
    goal = msgspec.structs.replace(SMALL, force=True)
    planned = plan_coverage(goal, ActionsConfig(), (0.0, 0.0))
    ended = world.fly(goal, 120.0)
    assert isinstance(ended, Result) and ended.result is not None
    assert ended.result.covered > 0.95
    assert ended.result.photographed == pytest.approx(planned.photographs.fraction, abs=0.05)
    assert ended.result.photographed < 0.9
