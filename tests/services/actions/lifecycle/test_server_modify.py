"""Changes of goals that are flown, against a bridge with a point mass, on the bus in virtual time."""

import dataclasses
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.base.frames import distance, norm
from jezero.runtime.service import BackgroundTask, CancelTask, Output, Reply, Response
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, Feedback, GetRunning, Modify, ModifyReply, Pause, Result, Resume, RunningGoal
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.goals import (
    AreaCoverageGoal,
    GetImagesGoal,
    GoToGoal,
    LandOnSpotGoal,
    TakeoffGoal,
)
from jezero.schemas.rows import Action
from jezero.schemas.state import Battery, Status, StatusCode
from jezero.schemas.topics import AREA_COVERAGE, STATUS
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.server import Modification, changed_goal
from jezero.services.actions.motion.behaviour import Plan, Preparation, Prepared, Refusal, VehicleState
from jezero.services.actions.motion.capture import Capture
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.lifecycle.bench import HOVER, Bench, Hovers, S, published, replies
from tests.services.actions.lifecycle.test_server_pause import assert_continuous, request
from tests.services.actions.rig import CONFIG, FAR, World


def modify(world: World, goal_id: str, action: Action[Any] = topics.GO_TO, **fields: Any) -> ModifyReply:
    """The reply to a change, after the vehicle has braked for it."""
    sent = world.bus.send_request(action.modify, Modify(goal_id=goal_id, fields=fields))
    assert world.bus.run_for(10.0, lambda: sent.ended)
    reply = sent.replies[0]
    assert isinstance(reply, ModifyReply)
    return reply


def test_a_flight_goes_on_to_its_new_target_without_a_jump() -> None:
    world = World()
    answers = world.flying()
    world.bus.run_for(3.0)
    assert modify(world, "far", target_ned_m=[5.0, 10.0, -6.0]) == ModifyReply(modified=True)
    result = world.end(answers, 30.0)
    assert result.outcome == "succeeded"
    assert distance(result.result.pos_uav_ned_m, (5.0, 10.0, -6.0)) < 0.15
    assert not any(setpoint.paused for setpoint in world.bridge.setpoints)
    assert_continuous(world.bridge.setpoints)


def test_a_flight_goes_on_at_its_new_speed() -> None:
    world = World()
    answers = world.flying()
    assert modify(world, "far", speed_mps=0.5).modified
    world.bus.run_for(5.0)
    assert norm(world.bridge.vel_ned_mps) == pytest.approx(0.5, abs=0.05)
    assert modify(world, "far", speed_mps=4.0).modified
    assert not modify(world, "far", speed_mps=-1.0).modified
    assert world.end(answers, 30.0).outcome == "succeeded"
    assert [reply.changes for reply in answers.replies if isinstance(reply, Feedback)][-1] == 2
    assert_continuous(world.bridge.setpoints)


def test_a_paused_goal_that_is_modified_stays_paused() -> None:
    world = World()
    answers = world.flying()
    request(world, Pause(goal_id="far"))
    assert modify(world, "far", target_ned_m=[-5.0, 0.0, -3.0]).modified
    before_ned_m = world.bridge.pos_ned_m
    world.bus.run_for(10.0)
    assert distance(world.bridge.pos_ned_m, before_ned_m) < 0.1
    assert not answers.ended
    assert answers.replies[-1].paused


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({}, "no field is given: while it is flown, go_to can change target_ned_m, yaw_rad, speed_mps"),
        ({"frame": "rover"}, "frame can't change while the goal is flown: go_to can change target_ned_m, yaw_rad"),
        ({"sped_mps": 2.0}, "go_to: there is no field 'sped_mps'; did you mean 'speed_mps'? Known are target_ned_m"),
        ({"speed_mps": "fast"}, "go_to: speed_mps: expected a number or nothing, not a text"),
        ({"speed_mps": 11.0}, "speed 11 m/s is not within 0.1 to 10 m/s"),
        ({"target_ned_m": [0.0, 0.0, 5.0]}, "5 m up is −5"),
    ],
)
def test_what_a_new_goal_could_not_be_is_refused_and_the_goal_goes_on(fields: dict[str, Any], reason: str) -> None:
    world = World()
    answers = world.flying()
    reply = modify(world, "far", **fields)
    assert not reply.modified
    assert reason in reply.reason
    result = world.end(answers, 30.0)
    assert distance(result.result.pos_uav_ned_m, FAR.target_ned_m) < 0.15


def test_a_goal_that_does_not_run_is_not_modified() -> None:
    assert modify(World(), "far", speed_mps=1.0).reason == "no goal far is known to go_to"


def test_a_takeoff_climbs_to_its_new_altitude_above_the_ground() -> None:
    world = World((0.0, 0.0, 0.0))
    answers = world.send(TakeoffGoal(altitude_m=8.0, goal_id="up"))
    world.bus.run_for(3.0)
    assert modify(world, "up", topics.TAKEOFF, altitude_m=4.0).modified
    result = world.end(answers, 30.0)
    assert result.result.pos_uav_ned_m[2] == pytest.approx(-4.0, abs=0.15)


def test_a_takeoff_of_go_to_is_over_before_its_target_changes() -> None:
    world = World((0.0, 0.0, 0.0))
    world.send(GoToGoal(target_ned_m=(5.0, 0.0, -3.0), do_takeoff=True, goal_id="up"))
    world.bus.run_for(1.0)
    assert "still takes off" in modify(world, "up", speed_mps=1.0).reason


def test_a_landing_changes_its_spot_on_the_way_to_it_only() -> None:
    world = World((0.0, 0.0, -5.0))
    landing = LandOnSpotGoal(landing_spot_ned_m=(8.0, 0.0, 0.0), use_uwb=False, use_tag=False, goal_id="down")
    answers = world.flying(landing)
    assert modify(world, "down", topics.LAND_ON_SPOT, landing_spot_ned_m=[0.0, 4.0, 0.0]).modified
    assert world.bus.run_for(30.0, lambda: answers.replies[-1].feedback.phase == "descent")
    reply = modify(world, "down", topics.LAND_ON_SPOT, landing_spot_ned_m=[0.0, 0.0, 0.0])
    assert "descends onto its spot already" in reply.reason
    result = world.end(answers, 60.0)
    assert distance(result.result.touchdown_ned_m, (0.0, 4.0, 0.0)) < 0.3


def test_a_goal_that_is_not_accepted_yet_is_not_modified() -> None:
    goal = GetImagesGoal(center_ned_m=(0.0, 0.0, -4.0), radius_m=2.0, num_images=4, goal_id="orbit")
    world = World()
    world.send(goal)
    world.bus.run_for(0.2)
    assert modify(world, "orbit", topics.GET_IMAGES, num_images=8).reason == "the goal does not fly yet"


def test_a_goal_that_is_ending_or_stands_on_the_ground_refuses_a_change_at_once() -> None:
    world = World()
    world.flying()
    world.bridge.lost_releases = 1000
    request(world, Cancel(goal_id="far"))
    ending = world.bus.send_request(topics.GO_TO.modify, Modify(goal_id="far", fields={"speed_mps": 1.0}))
    assert world.bus.run_for(0.1, lambda: ending.ended)
    assert ending.replies[0] == ModifyReply(modified=False, reason="the goal is ending already")
    world = World((0.0, 0.0, 0.0))
    up = world.send(TakeoffGoal(altitude_m=8.0, goal_id="up"))
    assert world.bus.run_for(1.0, lambda: bool(up.replies))
    standing = world.bus.send_request(topics.TAKEOFF.modify, Modify(goal_id="up", fields={"altitude_m": 4.0}))
    assert world.bus.run_for(0.01, lambda: standing.ended)
    assert "on the ground" in standing.replies[0].reason


def test_other_clients_read_the_way_of_a_goal_and_its_new_way_after_a_change() -> None:
    world = World()
    world.flying()

    def way_end_ned_m() -> Any:
        read = world.bus.send_request(topics.GO_TO.running, GetRunning())
        assert world.bus.run_for(1.0, lambda: read.ended)
        return read.replies[0].path_ned_m[-1]

    assert way_end_ned_m() == FAR.target_ned_m
    assert modify(world, "far", target_ned_m=[5.0, 10.0, -6.0]).modified
    assert way_end_ned_m() == (5.0, 10.0, -6.0)


def test_other_clients_read_the_plan_of_a_coverage_and_its_new_plan_after_a_change() -> None:
    world = World((0.0, 0.0, -4.0))
    world.bus.add(FakeCamera())
    world.bus.run_for(0.3)
    square = ((0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0))
    goal = AreaCoverageGoal(polygon_ned_m=square, z_ned_m=-4.0, resolution_m=2.0, speed_mps=1.0, goal_id="map")
    answers = world.send(goal)
    assert world.bus.run_for(30.0, lambda: sum(isinstance(reply, Feedback) for reply in answers.replies) > 5)

    def northernmost_m() -> float:
        read = world.bus.send_request(topics.AREA_COVERAGE.running, GetRunning())
        assert world.bus.run_for(1.0, lambda: read.ended)
        northernmost_m: float = max(north_m for north_m, _ in read.replies[0].coverage.path_ned_m)
        return northernmost_m

    assert 4.0 < northernmost_m() < 6.1
    longer = [[0.0, 0.0], [12.0, 0.0], [12.0, 6.0], [0.0, 6.0]]
    assert modify(world, "map", topics.AREA_COVERAGE, polygon_ned_m=longer).modified
    assert 10.0 < northernmost_m() < 12.1


# -- a picture that comes while a change is planned --

STILL = (0.0, 0.0, 0.0)
STATE = VehicleState((0.0, 0.0, -4.0), STILL, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False)
HOVERING = Status(
    t_ns=0,
    code=3,
    name=StatusCode.HOVER.name,
    armed=True,
    landed=False,
    in_charge="hover",
    bridge_boot_id=1,
    ready=True,
)
AREA = AreaCoverageGoal(polygon_ned_m=((0.0, 0.0), (4.0, 0.0), (4.0, 4.0)), z_ned_m=-4.0, goal_id="g")


def work() -> int:
    return 7


class HoveringRun:
    """A goal that hovers for its change, and that may still get a picture. It is also the planner and the inbox.

    Attributes:
        taken: number of pictures so far.
        planned_with: number of pictures at each plan.
        in_force: number of pictures with which the plan that came into force was made; None before.
    """

    stage = "flying"
    action = AREA_COVERAGE
    goal_id = "g"
    config = ActionsConfig()
    behaviour: Any = None

    def __init__(self) -> None:
        self.capture = self
        self.taken = 0
        self.planned_with: list[int] = []
        self.in_force: int | None = None
        self.responses: tuple[Response, ...] = ()

    def brake(self, t_ns: int, inbox: Any) -> VehicleState:
        return STATE

    def goal_time_ns(self, t_ns: int) -> int:
        return t_ns

    def go_on_changed(self, goal: Any, behaviour: Any, path_ned_m: Any, coverage: Any) -> None:
        self.in_force = behaviour

    def replan(self, goal: Any, status: Status, running: Any) -> Plan:
        taken = self.taken
        self.planned_with.append(taken)
        return Plan(
            Preparation(work=lambda state: work, start=lambda made: Prepared(start=lambda t_ns, state: taken))  # type: ignore[arg-type, return-value]
        )

    def latest(self, topic: Any) -> Any:
        return HOVERING if topic is STATUS else None


def tasks(outputs: list[Output]) -> list[str]:
    return [output.tag for output in outputs if isinstance(output, BackgroundTask)]


def test_a_change_is_planned_again_when_a_picture_comes_while_it_is_planned() -> None:
    run: Any = HoveringRun()
    change = Modification(run, 1, AREA, run)
    (first,) = tasks(list(change.step(1_000, run)))
    run.taken = 1
    outputs = list(change.step(2_000, run))
    assert CancelTask(first) in outputs
    (second,) = tasks(outputs)
    run.responses = (Response(first, None, "canceled"), Response(second, 7))
    outputs = list(change.step(3_000, run))
    assert [output.payload for output in outputs if isinstance(output, Reply)] == [ModifyReply(modified=True)]
    assert (run.planned_with, run.in_force) == ([0, 1], 1)


# -- step by step: what refuses a change, and what ends it --

HOVER_CHANGES = dataclasses.replace(HOVER, changeable=("speed_mps",))
SLOWER = Modify(goal_id="far", fields={"speed_mps": 1.0})


def reply_to_change(bench: Bench, change: Modify, *, within_s: float = 3.0) -> ModifyReply:
    """The reply to a change of a goal, while the vehicle hovers."""
    bench.request(change)
    for _ in range(round(within_s / 0.02)):
        if found := replies(bench.step(), ModifyReply):
            reply: ModifyReply = found[0]
            return reply
    raise AssertionError("no reply to the change")


def test_a_change_that_the_goal_can_not_stop_for_any_more_is_refused_and_the_goal_goes_on() -> None:
    """The goal would stop within half a second."""
    bench = Bench(HOVER_CHANGES, Hovers(pause_refusal=lambda t_ns: "it touches down" if t_ns > 10.2 * S else ""))
    bench.fly(FAR)
    assert reply_to_change(bench, SLOWER) == ModifyReply(modified=False, reason="it touches down")
    (feedback, *_) = replies(bench.step(0.1), Feedback)
    assert (feedback.changes, feedback.paused) == (0, False)
    assert reply_to_change(bench, SLOWER, within_s=0.02).reason == "it touches down", "the next one at once"


def test_a_change_is_refused_by_the_check_of_the_inputs_of_its_plan() -> None:
    bench = Bench(HOVER_CHANGES, hovers := Hovers())
    bench.fly(FAR)
    hovers.fields["check_inputs"] = lambda state: "the rover is out of sight"
    assert reply_to_change(bench, SLOWER) == ModifyReply(modified=False, reason="the rover is out of sight")
    hovers.fields["check_inputs"] = lambda state: ""
    assert reply_to_change(bench, SLOWER) == ModifyReply(modified=True)


def test_after_a_pause_a_changed_goal_starts_at_its_own_time() -> None:
    bench = Bench(HOVER_CHANGES, hovers := Hovers())
    bench.fly(FAR)
    bench.request(Pause(goal_id="far"))
    for _ in range(250):
        bench.step()
    assert hovers.stepped_ns < bench.t_ns - 4 * S, "the goal's own time stands still in a pause"
    bench.request(Resume(goal_id="far"))
    assert reply_to_change(bench, SLOWER).modified
    assert hovers.started_ns == pytest.approx(hovers.stepped_ns, abs=0.1 * S)


def test_a_change_waits_for_the_pictures_that_were_requested_before() -> None:
    capture = Capture(CONFIG.capture, CONFIG.vehicle.airframe, 4)
    bench = Bench(dataclasses.replace(HOVER_CHANGES, takes_pictures=True), Hovers({"capture": capture}))
    bench.fly(FAR)
    assert reply_to_change(bench, SLOWER, within_s=1.0).modified
    capture.request(0, bench.t_ns)
    bench.request(SLOWER)
    outputs = [output for _ in range(50) for output in bench.step()]
    assert not replies(outputs, ModifyReply), "no picture has come yet"


def test_a_second_change_waits_for_the_reply_to_the_first() -> None:
    bench = Bench()
    bench.fly(FAR)
    first = bench.request(SLOWER)
    bench.step()
    second = reply_to_change(bench, Modify(goal_id="far", fields={"speed_mps": 2.0}), within_s=0.02)
    assert second.reason == "the goal is being modified: send the request again in a moment"
    outputs = [output for _ in range(100) for output in bench.step()]
    assert [output.request_id for output in outputs if isinstance(output, Reply) and output.final] == [first]
    assert replies(outputs, ModifyReply) == [ModifyReply(modified=True)]
    assert reply_to_change(bench, SLOWER).modified


def test_a_changed_flight_begins_at_the_setpoint_at_which_the_goal_has_stopped() -> None:
    """The vehicle is behind: a way from its own position would be a jump."""
    bench = Bench()
    bench.fly(FAR)
    setpoints = [each for _ in range(60) for each in published(bench.step(), topics.SETPOINT)]
    assert setpoints[-1].pos_ned_m[0] > 0.3
    assert reply_to_change(bench, Modify(goal_id="far", fields={"target_ned_m": (0.0, 9.0, -3.0)})).modified
    bench.request(GetRunning())
    outputs = bench.step()
    (running,), (setpoint,) = replies(outputs, RunningGoal), published(outputs, topics.SETPOINT)
    assert running.path_ned_m[0] == pytest.approx(setpoint.pos_ned_m, abs=0.02)
    assert setpoint.pos_ned_m[0] > 0.3


class PreparesChanges(Hovers):
    """A planner whose changes need some work."""

    def replan(self, goal: GoToGoal, status: Status, running: Any) -> Plan:
        return Plan(Preparation(work=lambda state: int, start=lambda value: Prepared(self.start)))


def test_the_work_for_a_change_ends_with_its_goal() -> None:
    bench = Bench(HOVER_CHANGES, PreparesChanges())
    bench.fly(FAR)
    bench.request(SLOWER)
    outputs = [output for _ in range(50) for output in bench.step()]
    (tag,) = tasks(outputs)
    bench.take_control()
    outputs = bench.step()
    assert CancelTask(tag) in outputs
    assert replies(outputs, ModifyReply) == [ModifyReply(modified=False, reason="the goal has ended")]


def test_a_change_of_a_goal_that_ends_meanwhile_gets_a_reply() -> None:
    bench = Bench()
    bench.fly(FAR)
    bench.request(SLOWER)
    bench.step()
    bench.take_control()
    outputs = bench.step()
    assert replies(outputs, Result)
    assert replies(outputs, ModifyReply) == [ModifyReply(modified=False, reason="the goal has ended")]


def test_a_change_that_no_plan_could_have_is_refused_at_once_without_a_stop() -> None:
    bench = Bench()
    bench.fly(FAR)
    beyond = Modify(goal_id="far", fields={"target_ned_m": (0.0, 0.0, -200.0)})
    assert "beyond the limit of 120 m" in reply_to_change(bench, beyond, within_s=0.02).reason
    for _ in range(3):
        bench.step()
    assert reply_to_change(bench, SLOWER).modified, "no other change is pending"


def test_a_change_whose_way_leaves_the_fence_is_refused() -> None:
    square = Zone(name="field", corners_ned_m=((-30.0, -30.0), (30.0, -30.0), (30.0, 30.0), (-30.0, 30.0)))
    bench = Bench()
    assert bench.status is not None
    bench.status = replace(bench.status, fence_id="f")
    bench.inbox.add_message(topics.FENCE.name, FenceState(t_ns=0, fence=Fence(keep_in=square), fence_id="f"))
    bench.fly(FAR)
    outside = Modify(goal_id="far", fields={"target_ned_m": (40.0, 0.0, -3.0)})
    refused = reply_to_change(bench, outside)
    assert not refused.modified and refused.reason.startswith("the way leaves the fence 'fence'")
    assert reply_to_change(bench, Modify(goal_id="far", fields={"target_ned_m": (25.0, 0.0, -3.0)})).modified


def test_a_change_is_checked_and_shown_where_the_autopilot_has_it_after_a_step_of_its_position() -> None:
    """The fence begins 30 m to the north. The goal's points have moved north by 0.9 m since its start."""
    bench = Bench()
    assert bench.status is not None and bench.odometry is not None
    wall = Zone(name="wall", corners_ned_m=((30.0, -50.0), (60.0, -50.0), (60.0, 50.0), (30.0, 50.0)))
    bench.status = replace(bench.status, fence_id="f")
    bench.inbox.add_message(topics.FENCE.name, FenceState(t_ns=0, fence=Fence(keep_out=(wall,)), fence_id="f"))
    bench.fly(FAR)
    bench.odometry = replace(
        bench.odometry, pos_uav_ned_m=(0.9, 0.0, -3.0), reset_counter=1, reset_offset_ned_m=(0.9, 0.0, 0.0)
    )
    into = reply_to_change(bench, Modify(goal_id="far", fields={"target_ned_m": (29.5, 0.0, -3.0)}))
    assert "wall" in into.reason
    assert reply_to_change(bench, Modify(goal_id="far", fields={"target_ned_m": (28.5, 0.0, -3.0)})).modified
    bench.request(GetRunning())
    (running,) = replies(bench.step(), RunningGoal)
    assert running.path_ned_m[-1] == pytest.approx((29.4, 0.0, -3.0))


def test_a_change_to_a_flight_that_the_battery_does_not_hold_is_refused() -> None:
    bench = Bench()
    bench.fly(FAR)
    assert bench.status is not None
    bench.status = replace(bench.status, battery=Battery(voltage_v=15.0, remaining=0.1, critical=0.07))
    refused = reply_to_change(bench, Modify(goal_id="far", fields={"target_ned_m": (400.0, 0.0, -3.0)}))
    assert not refused.modified and refused.reason.startswith("the battery is too low")


def test_an_action_whose_fields_can_not_change_says_so() -> None:
    refusals = [changed_goal(HOVER, FAR, fields) for fields in ({}, {"speed_mps": 1.0}, {"sped_mps": 1.0})]
    assert refusals[0] == Refusal("no field is given: while it is flown, no field of hover_a_while can change")
    assert refusals[1] == Refusal(
        "speed_mps can't change while the goal is flown: no field of hover_a_while can change"
    )
    assert isinstance(refusals[2], Refusal) and refusals[2].reason.startswith("hover_a_while: there is no field")
