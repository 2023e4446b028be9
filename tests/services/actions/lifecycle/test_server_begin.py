"""The begin of goals: with a bridge that replies late, a position that gets lost, and inputs that do not come."""

from typing import Any

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.runtime.service import Health
from jezero.schemas import topics
from jezero.schemas.actions import (
    Accepted,
    Cancel,
    GetRunning,
    Modify,
    ModifyReply,
    Pause,
    PauseReply,
    PlanReply,
    Rejected,
    Result,
    RunningGoal,
)
from jezero.schemas.commands import Acquire, Release, ReleaseReply
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.goals import GetImagesGoal, GoToGoal
from jezero.schemas.state import Status, StatusCode
from jezero.services.actions.motion.behaviour import Plan, Preparation, Prepared
from tests.services.actions.lifecycle.bench import GRANTED, HOVER, Bench, Hovers, S, calls, published, replies
from tests.services.actions.rig import FAR


class PreparedHover(Hovers):
    """A planner whose goals need some work first."""

    def plan(self, goal: GoToGoal, status: Status) -> Plan:
        return Plan(Preparation(work=lambda state: int, start=lambda value: Prepared(self.start)))


# -- a bridge that is not there yet, or replies late --


def test_a_server_starts_until_the_first_status_comes_and_is_degraded_when_none_comes_any_more() -> None:
    bench = Bench()
    assert bench.step_alone() == [Health("starting", "waiting for the vehicle's status")]
    assert bench.step() == [Health("ok", "ready for a goal")]
    assert bench.step_alone(0.9) == []
    assert bench.step_alone(0.2) == [Health("degraded", "the vehicle's status doesn't arrive any more")]


@pytest.mark.parametrize("plan_from_ned_m", [None, (10.0, 0.0, -8.0)])
def test_without_a_bridge_there_is_no_plan_either(plan_from_ned_m: Vec3 | None) -> None:
    bench = Bench()
    bench.request_plan(replace(FAR, plan_from_ned_m=plan_from_ned_m))
    (reply,) = replies(bench.step_alone(), PlanReply)
    assert (reply.accepted, reply.code) == (False, None)
    assert reply.reason == "the vehicle's status is unknown: is vehicle_bridge running?"


def test_a_refusal_has_the_age_of_a_status_that_does_not_come_any_more() -> None:
    bench = Bench()
    bench.step()
    bench.request(FAR)
    (refused,) = replies(bench.step_alone(2.5), Rejected)
    assert refused.reason == "the vehicle's status is 2.5 s old: is vehicle_bridge running?"


def test_a_grant_that_comes_within_a_second_is_taken() -> None:
    """Or the bridge would have given control to a goal that is refused."""
    bench = Bench()
    bench.request(FAR)
    call = bench.step(flies=False)
    assert not replies(bench.step(0.9, flies=False), Rejected)
    bench.respond(call, GRANTED)
    assert replies(bench.step(0.05, flies=False), Accepted)


def test_a_bridge_that_never_replies_refuses_the_goal_within_two_seconds() -> None:
    """Also when the call's own time-out gets lost."""
    bench = Bench()
    bench.request(FAR)
    (call,) = calls(bench.step(flies=False), Acquire)
    assert call.timeout_s == pytest.approx(1.0, abs=0.3)
    outputs = [output for _ in range(20) for output in bench.step(0.1, flies=False)]
    assert [refused.reason for refused in replies(outputs, Rejected)] == ["the vehicle bridge did not reply"]


@pytest.mark.parametrize(("ahead_s", "refused"), [(0.8, False), (1.5, True)])
def test_a_goal_of_a_clock_that_is_a_little_ahead_is_taken_and_one_from_before_a_restart_is_not(
    ahead_s: float, refused: bool
) -> None:
    bench = Bench()
    bench.step()
    bench.request(replace(FAR, issued_t_ns=bench.t_ns + round(ahead_s * S)))
    reasons = [each.reason for each in replies(bench.step(0.0), Rejected)]
    assert bool(reasons) is refused
    assert all("in the future: the vehicle restarted" in reason for reason in reasons)


def test_a_goal_is_canceled_at_once_also_while_the_bridge_does_not_reply() -> None:
    bench = Bench(HOVER, PreparedHover())
    bench.request(FAR)
    assert calls(bench.step(flies=False), Acquire)
    bench.request(Cancel(goal_id="far"))
    bench.step(flies=False)
    outputs = bench.step(flies=False)
    assert [refused.reason for refused in replies(outputs, Rejected)] == ["canceled by a client"]


# -- a position that is not known, or gets lost while the goal begins --


@pytest.mark.parametrize(
    ("not_ready_reason", "reason"), [("", "no odometry yet"), ("no GNSS fix yet", "no GNSS fix yet")]
)
def test_a_goal_for_a_vehicle_without_a_position_is_refused_with_what_the_bridge_waits_for(
    not_ready_reason: str, reason: str
) -> None:
    bench = Bench()
    assert bench.status is not None
    bench.odometry = None
    bench.status = replace(bench.status, ready=not not_ready_reason, not_ready_reason=not_ready_reason)
    bench.request(FAR)
    (refused,) = replies(bench.step(), Rejected)
    assert refused.reason == f"the vehicle's position is unknown: {reason}"


def test_a_goal_whose_way_leaves_the_fence_is_refused_before_it_gets_control() -> None:
    wall = Zone(name="wall", corners_ned_m=((10.0, -50.0), (60.0, -50.0), (60.0, 50.0), (10.0, 50.0)))
    bench = Bench()
    assert bench.status is not None
    bench.status = replace(bench.status, fence_id="f")
    bench.inbox.add_message(topics.FENCE.name, FenceState(t_ns=0, fence=Fence(keep_out=(wall,)), fence_id="f"))
    bench.request(FAR)
    outputs = bench.step()
    assert not calls(outputs, Acquire)
    (refused,) = replies(outputs, Rejected)
    assert "wall" in refused.reason


LOST = "the vehicle's position is not known any more: is vehicle_bridge running?"


def test_a_plan_whose_vehicle_loses_its_position_meanwhile_is_refused() -> None:
    bench = Bench()
    bench.request_plan(FAR)
    call = bench.step(flies=False)
    bench.odometry = None
    bench.respond(call, replace(GRANTED, control_id=""))
    (reply,) = replies(bench.step(), PlanReply)
    assert (reply.accepted, reply.reason) == (False, LOST)


def test_a_goal_that_waits_for_the_camera_is_refused_when_the_position_gets_lost_meanwhile() -> None:
    bench = Bench(topics.GET_IMAGES)
    bench.request(GetImagesGoal(center_ned_m=(5.0, 0.0, -3.0), radius_m=3.0, num_images=4))
    call = bench.step(flies=False)
    bench.odometry = None
    bench.respond(call, GRANTED)
    refused = [each for _ in range(20) for each in replies(bench.step(0.1), Rejected)]
    assert [each.reason for each in refused] == [LOST]


def test_a_goal_that_waits_for_the_camera_is_canceled_at_once_and_is_none_that_flies() -> None:
    bench = Bench(topics.GET_IMAGES)
    bench.request(GetImagesGoal(center_ned_m=(5.0, 0.0, -3.0), radius_m=3.0, num_images=4, goal_id="orbit"))
    bench.respond(bench.step(flies=False), GRANTED)
    bench.step()
    bench.request(GetRunning())
    assert [running.goal_id for running in replies(bench.step(), RunningGoal)] == [""]
    bench.request(Cancel(goal_id="orbit"))
    bench.step()
    (refused,) = replies(bench.step(), Rejected)
    assert refused.reason == "canceled by a client"


def test_a_goal_without_the_pictures_that_it_waits_for_is_refused_within_two_seconds() -> None:
    bench = Bench(topics.GET_IMAGES)
    bench.request(GetImagesGoal(center_ned_m=(5.0, 0.0, -3.0), radius_m=3.0, num_images=4))
    bench.respond(bench.step(flies=False), GRANTED)
    refused = [bool(replies(bench.step(0.1), Rejected)) for _ in range(20)]
    assert not any(refused[:10]), "the camera's first picture may come late"
    assert sum(refused) == 1


@pytest.mark.parametrize("works_already", [False, True])
def test_a_goal_that_needs_work_is_refused_when_the_position_gets_lost_before_it_or_meanwhile(
    works_already: bool,
) -> None:
    bench = Bench(HOVER, PreparedHover())
    bench.request(FAR)
    outputs = bench.step(flies=False)
    bench.respond(outputs, GRANTED)
    if works_already:
        outputs = bench.step(flies=False)
        bench.respond(outputs, 0)
    bench.odometry = None
    (refused,) = replies(bench.step(), Rejected)
    assert refused.reason == LOST


def test_a_goal_without_feedback_of_its_preparation_publishes_none_while_it_is_prepared() -> None:
    bench = Bench(HOVER, PreparedHover())
    bench.request(FAR)
    bench.respond(bench.step(flies=False), GRANTED)
    outputs = [output for _ in range(5) for output in bench.step(0.2, flies=False)]
    assert not published(outputs, topics.feedback_of(HOVER))


@pytest.mark.parametrize(
    ("change", "reply"),
    [
        (Pause(goal_id="far"), PauseReply(paused=False, reason="the vehicle's position is unknown")),
        (
            Modify(goal_id="far", fields={"speed_mps": 1.0}),
            ModifyReply(modified=False, reason="the vehicle's position is unknown"),
        ),
    ],
    ids=["pause", "modify"],
)
def test_a_goal_whose_position_is_lost_before_its_first_setpoint_is_not_changed_and_ends_with_a_result(
    change: Any, reply: Any
) -> None:
    bench = Bench()
    bench.request(FAR)
    bench.respond(bench.step(flies=False), GRANTED)
    bench.odometry = None
    bench.request(change)
    assert replies(bench.step(), Accepted | type(reply)) == [Accepted(goal_id="far"), reply]  # type: ignore[arg-type]
    bench.give_control()
    outputs = bench.step()
    assert not published(outputs, topics.SETPOINT)
    (release,) = calls(outputs, Release)
    assert (release.payload.outcome, release.payload.then) == ("aborted", "hover")  # type: ignore[attr-defined]
    bench.respond(outputs, ReleaseReply(released=True, code=int(StatusCode.HOVER)))
    (result,) = replies(bench.step(), Result)
    assert (result.outcome, result.position_deg) == ("aborted", None)
    assert result.reason == "the vehicle's position is unknown: no odometry for 0.5 s"
