"""One plan is shown, judged and flown: a goal names it by its id, and is refused when the plan doesn't fit any more."""

from typing import Any

import msgspec
import numpy as np
import pytest

from jezero.runtime import memory_bus
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, PlannedCoverage, PlanReply, Rejected, Result
from jezero.schemas.goals import AreaCoverageGoal, GoToGoal
from jezero.schemas.state import Status
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.area_coverage.planner import KEPT_MAX, KEPT_S, ShownPlan, ShownPlans, describe
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Refusal
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.rig import World
from tests.services.actions.test_behaviours import a_status

GOAL = AreaCoverageGoal(
    polygon_ned_m=((1.0, 0.0), (7.0, 0.0), (7.0, 5.0), (1.0, 5.0)), z_ned_m=-4.0, resolution_m=1.5, speed_mps=3.0
)


def changed(goal: AreaCoverageGoal = GOAL, **fields: Any) -> AreaCoverageGoal:
    return msgspec.structs.replace(goal, **fields)


@pytest.fixture
def world() -> World:
    made = World()
    made.bus.add(FakeCamera())
    made.bus.run_for(0.3)
    return made


def plan_reply(world: World, goal: AreaCoverageGoal = GOAL) -> PlanReply:
    request = world.bus.send_request(topics.AREA_COVERAGE.plan, goal, "me")
    assert world.bus.run_for(5.0, lambda: request.ended)
    reply = request.replies[-1]
    assert isinstance(reply, PlanReply)
    return reply


def shown(world: World, goal: AreaCoverageGoal = GOAL) -> PlannedCoverage:
    reply = plan_reply(world, goal)
    assert reply.coverage is not None, reply.reason
    return reply.coverage


def rejection(world: World, goal: AreaCoverageGoal) -> str:
    reply = world.fly(goal)
    assert isinstance(reply, Rejected)
    return reply.reason


def result_of(world: World, goal: AreaCoverageGoal) -> Any:
    ended = world.fly(goal, 120.0)
    assert isinstance(ended, Result)
    assert ended.outcome == "succeeded", ended.reason
    return ended.result


def test_exactly_the_plan_that_was_shown_is_flown_after_the_vehicle_has_drifted(world: World) -> None:
    """From its new position the vehicle would begin at another corner."""
    plan = shown(world)
    assert world.fly(GoToGoal(target_ned_m=(4.5, 0.0, -3.0)), 30.0).outcome == "succeeded"
    assert shown(world).path_ned_m[0] != plan.path_ned_m[0]
    result = result_of(world, changed(plan_id=plan.plan_id))
    assert len(result.images) == len(plan.pictures_ned_m)
    taken_m = np.array([image.pos_uav_ned_m[:2] for image in result.images])
    assert np.linalg.norm(taken_m - np.array(plan.pictures_ned_m), axis=1).max() < 0.3
    assert result.photographed == pytest.approx(plan.photographed, abs=0.02)
    assert result.covered == pytest.approx(plan.covered, abs=0.05)


def test_a_goal_with_a_plan_is_accepted_without_planning_again(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = shown(world)
    monkeypatch.setattr(memory_bus, "BACKGROUND_TASK_S", 3600.0)
    answers = world.send(changed(plan_id=plan.plan_id))
    assert world.bus.run_for(3.0, lambda: bool(answers.replies))
    assert isinstance(answers.replies[0], Accepted)


def test_a_plan_can_be_flown_twice_and_counts_anew(world: World) -> None:
    plan = shown(world)
    first = result_of(world, changed(plan_id=plan.plan_id, goal_id="first"))
    assert world.fly(GoToGoal(target_ned_m=(0.0, 0.0, -3.0)), 30.0).outcome == "succeeded"
    answers = world.send(changed(plan_id=plan.plan_id, goal_id="second"))
    world.bus.run_for(5.0)
    assert world.servers["area_coverage"]._run is not None
    world.bus.send_request(topics.AREA_COVERAGE.cancel, Cancel(goal_id="second"))
    second = world.end(answers).result
    assert first.covered > 0.95 > second.covered
    assert second.resume.plan_id == ""
    assert second.resume.start_ned_m == pytest.approx(plan.start_ned_m)


def test_the_reply_has_the_path_its_pictures_and_both_fractions(world: World) -> None:
    reply = plan_reply(world)
    plan = reply.coverage
    assert plan is not None
    assert plan.start_ned_m == pytest.approx((0.0, 0.0), abs=0.1)
    assert plan.covered > 0.99
    assert plan.photographed > 0.99
    steps_m = np.linalg.norm(np.diff(np.array(plan.path_ned_m), axis=0), axis=1)
    assert steps_m.sum() == pytest.approx(plan.length_m, rel=0.01)
    assert reply.duration_s is not None
    assert reply.duration_s > plan.duration_s  # the way to the begin comes before it


def test_the_same_goal_from_the_same_place_has_the_same_plan_and_any_other_goal_another(world: World) -> None:
    ids = [shown(world, goal).plan_id for goal in (changed(start_ned_m=(1.0, 0.0)), changed(start_ned_m=(7.0, 5.0)))]
    assert ids[0] == shown(world, changed(start_ned_m=(1.0, 0.0))).plan_id
    assert ids[0] != ids[1]
    assert shown(world, changed(start_ned_m=(1.0, 0.0), speed_mps=2.0)).plan_id != ids[0]


def test_a_plan_that_nobody_was_shown_is_refused_with_what_to_do(world: World) -> None:
    assert rejection(world, changed(plan_id="0123abc")).startswith("plan 0123abc is not known")
    assert "leave plan_id out" in plan_reply(world, changed(plan_id="0123abc")).reason


def test_a_plan_is_refused_for_another_goal(world: World) -> None:
    plan_id = shown(world).plan_id
    assert "other fields: request the plan of this goal" in rejection(world, changed(plan_id=plan_id, z_ned_m=-5.0))


def test_a_plan_is_refused_when_the_vehicle_has_moved_away(world: World) -> None:
    plan_id = shown(world).plan_id
    assert world.fly(GoToGoal(target_ned_m=(-12.0, 0.0, -3.0)), 60.0).outcome == "succeeded"
    reason = f"the vehicle is 12 m away from where it was when plan {plan_id} was made, more than 5 m"
    assert rejection(world, changed(plan_id=plan_id)).startswith(reason)


# -- the store --


def a_plan(start_m: tuple[float, float]) -> ShownPlan:
    made = plan_coverage(changed(start_ned_m=start_m), ActionsConfig())
    return ShownPlan(made, describe(GOAL, made))


def at(seconds: float, epoch_id: int = 1) -> Status:
    return msgspec.structs.replace(a_status(3), t_ns=int(seconds * 1e9), epoch_id=epoch_id)


@pytest.mark.parametrize(
    ("status", "found"),
    [(at(KEPT_S - 1.0), True), (at(KEPT_S + 1.0), False), (at(1.0, epoch_id=2), False)],
    ids=["young", "old", "of the vehicle before its restart"],
)
def test_a_plan_is_kept_for_ten_minutes_of_one_life_of_the_vehicle(status: Status, found: bool) -> None:
    plans, plan = ShownPlans(), a_plan((1.0, 0.0))
    plans.add(GOAL, at(0.0), plan)
    named = changed(plan_id=plan.shown.plan_id)
    assert isinstance(plans.find(named, status), ShownPlan if found else Refusal)


def test_only_the_newest_plans_are_kept() -> None:
    plans = ShownPlans()
    plan = a_plan((1.0, 0.0))
    for number in range(KEPT_MAX + 1):
        numbered = msgspec.structs.replace(plan.shown, plan_id=str(number))
        plans.add(GOAL, at(0.0), ShownPlan(plan.plan, numbered))
    assert isinstance(plans.find(changed(plan_id="0"), at(1.0)), Refusal)
    assert isinstance(plans.find(changed(plan_id="1"), at(1.0)), ShownPlan)
