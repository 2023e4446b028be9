"""Goals that are planned and not flown, and the rest of the flight in the feedback of those that fly."""

from itertools import pairwise
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3, distance
from jezero.schemas import topics
from jezero.schemas.actions import (
    Accepted,
    Cancel,
    CancelReply,
    Feedback,
    GetResult,
    GetRunning,
    Pause,
    PauseReply,
    PlanReply,
    Rejected,
    Result,
    ResultReply,
    RunningGoal,
)
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, Goal, GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Battery, StatusCode
from jezero.services.actions.motion.behaviour import Done, Remaining
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.lifecycle.bench import GRANTED, HOVER, Bench, Hovers, replies
from tests.services.actions.lifecycle.test_vehicle_view import relative_estimate, rover_estimate
from tests.services.actions.rig import CONFIG, FAR, World

GROUND = (0.0, 0.0, 0.0)
FEEDBACK = "action/area_coverage/feedback"
FIELD = AreaCoverageGoal(polygon_ned_m=((0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0)), z_ned_m=-4.0, resolution_m=2.0)
CIRCLE = GetImagesGoal(center_ned_m=(5.0, 0.0, -3.0), radius_m=4.0, num_images=6)
SPOT = LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=(6.0, 0.0, 0.0))


def world_at(pos_ned_m: tuple[float, float, float], *, with_camera: bool = True) -> World:
    world = World(pos_ned_m)
    if with_camera:
        world.bus.add(FakeCamera())
        world.bus.run_for(0.3)
    return world


def plan(world: World, goal: Goal) -> PlanReply:
    action = next(a for a in topics.ACTIONS.values() if a.goal_type is type(goal))
    request = world.bus.send_request(action.plan, goal, "me")
    assert world.bus.run_for(5.0, lambda: request.ended)
    (reply,) = request.replies
    assert isinstance(reply, PlanReply)
    return reply


@pytest.mark.parametrize(
    ("start", "goal"),
    [
        (GROUND, TakeoffGoal(altitude_m=6.0)),
        (GROUND, GoToGoal(target_ned_m=(9.0, 3.0, -6.0), do_takeoff=True)),
        ((0.0, 0.0, -3.0), GoToGoal(target_ned_m=(30.0, 0.0, -8.0), yaw_rad=2.0)),
        ((0.0, 0.0, -3.0), CIRCLE),
        ((0.0, 0.0, -3.0), FIELD),
        ((0.0, 0.0, -3.0), SPOT),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Goal) else "",
)
def test_a_flight_takes_the_time_of_its_plan(start: tuple[float, float, float], goal: Goal) -> None:
    world = world_at(start)
    planned = plan(world, goal)
    assert planned.accepted, planned.reason
    assert planned.duration_s is not None
    assert planned.distance_m is not None
    assert planned.battery_used == pytest.approx(CONFIG.vehicle.battery.used(planned.duration_s))
    assert world.bridge.setpoints == []
    assert world.bridge.grants == 0
    answers = world.send(goal)
    track = [world.bridge.pos_ned_m]
    start_ns = world.bus.t_ns
    while not answers.ended:
        world.bus.run_for(0.5)
        track.append(world.bridge.pos_ned_m)
        assert len(track) < 400, answers.replies[-1]
    assert isinstance(answers.replies[-1], Result)
    flown_s = (world.bus.t_ns - start_ns) / 1e9
    assert planned.duration_s == pytest.approx(flown_s, rel=0.1, abs=3.0)
    flown_m = sum(distance(before, after) for before, after in pairwise(track))
    assert planned.distance_m == pytest.approx(flown_m, rel=0.15, abs=1.0)


@pytest.mark.parametrize(
    "goal", [GoToGoal(target_ned_m=(20.0, 0.0, -3.0)), CIRCLE, FIELD], ids=["go_to", "circle", "field"]
)
def test_the_feedback_shows_the_rest_of_the_flight(goal: Goal) -> None:
    world = world_at((0.0, 0.0, -3.0))
    answers = world.send(goal)
    assert world.bus.run_for(120.0, lambda: answers.ended)
    feedback = [reply for reply in answers.replies if isinstance(reply, Feedback)]
    end_ns = answers.replies[-1].t_ns
    for sent in feedback[:: len(feedback) // 8]:
        assert sent.remaining_s == pytest.approx((end_ns - sent.t_ns) / 1e9, abs=3.0)
    remaining = [sent.remaining_s for sent in feedback if sent.remaining_s is not None]
    assert len(remaining) == len(feedback)
    assert max(after - before for before, after in pairwise(remaining)) < 0.5


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        (TakeoffGoal(altitude_m=500.0), "altitude 500 m"),
        (GetImagesGoal(center_ned_m=(0.0, 0.0, -3.0), radius_m=0.1, num_images=4), "radius 0.1 m is too small"),
        (AreaCoverageGoal(polygon_ned_m=((0.0, 0.0), (1.0, 0.0)), z_ned_m=-4.0, resolution_m=1.0), "corners"),
    ],
)
def test_what_would_be_refused_has_no_plan_but_the_same_reason(goal: Goal, reason: str) -> None:
    world = world_at((0.0, 0.0, -3.0))
    planned = plan(world, goal)
    assert (planned.accepted, planned.code, planned.duration_s) == (False, StatusCode.HOVER, None)
    assert reason in planned.reason
    refused = world.fly(goal)
    assert isinstance(refused, Rejected)
    assert refused.reason == planned.reason


@pytest.mark.parametrize("goal", [CIRCLE, FIELD, GoToGoal(target_ned_m=(1.0, 0.0, -3.0), frame="rover")])
def test_the_bridges_reason_comes_before_a_missing_input(goal: Goal) -> None:
    """On the ground the goal is refused by the bridge, also while camera and estimator are silent."""
    world = world_at(GROUND, with_camera=False)
    world.bridge.refuse = "it is on the ground: take off first"
    assert plan(world, goal).reason == world.bridge.refuse
    refused = world.fly(goal)
    assert isinstance(refused, Rejected)
    assert refused.reason == world.bridge.refuse


def test_a_refused_plan_says_whether_an_input_is_missing_that_may_be_there_in_flight() -> None:
    missing = plan(World(), CIRCLE)
    assert (missing.accepted, missing.input_missing) == (False, True)
    assert missing.reason.startswith("no pictures")
    beyond = plan(World(), GoToGoal(target_ned_m=(0.0, 0.0, -200.0)))
    assert (beyond.accepted, beyond.input_missing) == (False, False)


def test_a_plan_says_what_the_battery_has_and_what_the_flight_takes_of_it() -> None:
    world = World()
    goal = GoToGoal(target_ned_m=(20.0, 0.0, -3.0))
    unknown = plan(world, goal)
    assert (unknown.battery_remaining, unknown.battery_critical) == (None, None)
    world.bridge.battery = Battery(voltage_v=15.0, remaining=0.6, critical=0.07)
    world.bus.run_for(0.2)
    planned = plan(world, goal)
    assert (planned.battery_remaining, planned.battery_critical) == (0.6, 0.07)
    assert planned.duration_s is not None
    assert planned.battery_used == pytest.approx(CONFIG.vehicle.battery.used(planned.duration_s))
    assert (planned.code, planned.accepted, planned.warning) == (StatusCode.HOVER, True, "")
    assert planned.path_ned_m[-1] == (20.0, 0.0, -3.0)


def test_a_flying_server_makes_no_plans() -> None:
    world = World()
    world.flying()
    assert "busy: another goal go to is running" in plan(world, FAR).reason


def test_a_goal_does_not_wait_for_somebody_elses_plan() -> None:
    """The camera is silent, so that the plan waits for it."""
    world = World()
    waiting = world.bus.send_request(topics.GET_IMAGES.plan, CIRCLE, "other")
    world.bus.run_for(0.5)
    assert not waiting.ended
    second = plan(world, CIRCLE)
    assert "another goal is being planned" in second.reason
    world.bus.add(FakeCamera())
    answers = world.send(CIRCLE)
    assert world.bus.run_for(2.0, lambda: bool(answers.replies))
    assert isinstance(answers.replies[0], Accepted)
    assert "ask for the plan again" in waiting.replies[0].reason


def test_a_landing_whose_rover_nobody_knows_has_a_plan_without_a_duration() -> None:
    planned = plan(World(), LandOnSpotGoal())
    assert planned.accepted
    assert (planned.duration_s, planned.distance_m, planned.battery_used) == (None, None, None)


def test_a_landing_with_the_rovers_rough_position_is_planned_by_it() -> None:
    near: Any = plan(World(), LandOnSpotGoal(use_uwb=False, landing_spot_ned_m=(5.0, 0.0, -0.5)))
    far: Any = plan(World(), LandOnSpotGoal(use_uwb=False, landing_spot_ned_m=(40.0, 0.0, -0.5)))
    assert far.distance_m - near.distance_m == pytest.approx(35.0)
    follows_s = 35.0 / CONFIG.land_on_spot.rover.platform_control.speed_max_mps
    searches_s = 3.0 + (40.0 - CONFIG.vehicle.uwb.range_max_m) / 1.5
    assert far.duration_s - near.duration_s == pytest.approx(follows_s + searches_s, abs=1.0)


def test_a_flight_that_is_planned_from_another_place_begins_in_a_hover_also_while_the_vehicle_stands() -> None:
    goal = GoToGoal(target_ned_m=(30.0, 0.0, -8.0), do_takeoff=True)
    there = msgspec.structs.replace(goal, plan_from_ned_m=(10.0, 0.0, -8.0))
    assert plan(world_at(GROUND), there).path_ned_m == ((10.0, 0.0, -8.0), (30.0, 0.0, -8.0))
    from_here = plan(world_at(GROUND), goal).path_ned_m
    assert len(from_here) == 3 and from_here[0] == GROUND, "it takes off first"


@pytest.mark.parametrize(
    ("plan_from_ned_m", "reason"),
    [
        ((0.0, 0.0, -130.0), "altitude 130 m is beyond the limit of 120 m"),
        ((600.0, 0.0, -8.0), "600 m from the origin"),
    ],
)
def test_a_flight_is_not_planned_from_a_place_beyond_the_limits(plan_from_ned_m: Vec3, reason: str) -> None:
    planned = plan(World(), GoToGoal(target_ned_m=(30.0, 0.0, -8.0), plan_from_ned_m=plan_from_ned_m))
    assert (planned.accepted, planned.code) == (False, StatusCode.HOVER)
    assert planned.reason.startswith("plan_from_ned_m: ") and reason in planned.reason


def test_a_flight_is_planned_from_another_place_whatever_the_bridge_says_of_the_vehicle_here() -> None:
    world, goal = world_at((0.0, 0.0, -3.0)), CIRCLE
    world.bridge.refuse = "a person flies"
    assert plan(world, goal).reason == "a person flies"
    assert plan(world, msgspec.structs.replace(goal, plan_from_ned_m=(10.0, 0.0, -8.0))).accepted


def test_a_plan_begins_where_the_vehicle_is_though_the_autopilot_has_corrected_its_position_before() -> None:
    world = world_at((0.0, 0.0, -4.0))
    world.bridge.step_position((50.0, 0.0, 0.0))
    planned = plan(world, FIELD)
    assert planned.coverage is not None
    assert planned.coverage.start_ned_m == pytest.approx((50.0, 0.0))


def test_a_goal_is_refused_when_the_autopilot_corrects_its_position_while_the_flight_is_planned() -> None:
    world = world_at((0.0, 0.0, -4.0))
    feedback: list[bytes] = []
    world.bus.observe(lambda _, name, message: feedback.append(message) if name == FEEDBACK else None)
    request = world.send(FIELD)
    assert world.bus.run_for(5.0, lambda: bool(feedback)), request.replies
    assert b'"planning"' in feedback[0]
    world.bridge.step_position((2.0, 0.0, 0.0))
    assert world.bus.run_for(5.0, lambda: request.ended)
    assert "send the goal again" in request.replies[-1].reason
    assert world.bridge.setpoints == []


# -- step by step --


def test_the_plan_of_a_goal_is_not_the_goal_itself_which_neither_runs_nor_can_be_canceled_meanwhile() -> None:
    bench = Bench()
    bench.request_plan(FAR)
    call = bench.step(flies=False)
    for payload in (GetResult(goal_id="far"), GetRunning(), Pause(goal_id="far"), Cancel(goal_id="far")):
        bench.request(payload)
    outputs = bench.step(flies=False)
    assert not replies(outputs, ResultReply)
    assert [running.goal_id for running in replies(outputs, RunningGoal)] == [""]
    unknown = "no goal far is known to go_to"
    assert replies(outputs, PauseReply) == [PauseReply(paused=False, reason=unknown)]
    assert replies(outputs, CancelReply) == [CancelReply(canceled=False, reason=unknown)]
    bench.respond(call, GRANTED)
    assert [planned.accepted for planned in replies(bench.step(flies=False), PlanReply)] == [True]


def test_the_plan_of_a_goal_that_would_end_at_once_is_refused_with_its_reason() -> None:
    for done, reason in (
        (Done("aborted", "there is nothing to do"), "there is nothing to do"),
        (Done("succeeded"), "the goal would end at once"),
    ):
        bench = Bench(HOVER, Hovers(done=done))
        bench.request_plan(FAR)
        bench.respond(bench.step(flies=False), GRANTED)
        (reply,) = replies(bench.step(flies=False), PlanReply)
        assert (reply.accepted, reply.reason) == (False, reason)


@pytest.mark.parametrize(("hover_s", "counts_s"), [(None, 100.0), (150.0, 150.0)])
def test_a_plan_counts_the_battery_of_the_hover_that_uses_as_much(hover_s: float | None, counts_s: float) -> None:
    bench = Bench(HOVER, Hovers(rest=Remaining(100.0, 30.0, hover_s)))
    bench.request_plan(FAR)
    bench.respond(bench.step(flies=False), GRANTED)
    (reply,) = replies(bench.step(flies=False), PlanReply)
    assert (reply.accepted, reply.duration_s, reply.distance_m) == (True, 100.0, 30.0)
    assert reply.code == StatusCode.HOVER
    assert reply.battery_used == pytest.approx(CONFIG.vehicle.battery.used(counts_s))


def test_the_plan_of_a_landing_waits_for_the_estimate_of_the_rover() -> None:
    bench = Bench(topics.LAND_ON_SPOT)
    bench.request_plan(LandOnSpotGoal())
    bench.respond(bench.step(flies=False), GRANTED)
    assert not replies(bench.step(), PlanReply) and not replies(bench.step(), PlanReply)
    for topic, estimate in ((topics.RELATIVE, relative_estimate()), (topics.ROVER_ESTIMATE, rover_estimate())):
        bench.inbox.add_message(topic.name, replace(estimate, t_ns=bench.t_ns))
    bench.inbox.add_message(topics.ALTIMETER.name, Altimeter(t_ns=bench.t_ns, range_m=3.0))
    (reply,) = replies(bench.step(), PlanReply)
    assert reply.accepted and reply.duration_s is not None


@pytest.mark.parametrize("goal", [GoToGoal(target_ned_m=(80.0, 0.0, -4.0)), CIRCLE, FIELD, SPOT])
def test_each_goal_is_flown_after_an_earlier_correction_of_the_position(goal: Goal) -> None:
    world = world_at((0.0, 0.0, -4.0))
    world.bridge.step_position((50.0, 0.0, 0.0))
    world.bus.run_for(0.3)
    assert isinstance(world.flying(goal).replies[0], Accepted)
