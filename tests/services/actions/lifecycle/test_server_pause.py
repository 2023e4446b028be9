"""Pause and resume of goals, against a bridge with a point mass, on the bus in virtual time."""

from itertools import pairwise
from typing import Any

import pytest

from jezero.base.frames import distance, norm, subtract
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, Feedback, Pause, PauseReply, Resume, ResumeReply
from jezero.schemas.commands import Setpoint
from jezero.schemas.goals import GetImagesGoal, GoToGoal
from jezero.schemas.rows import Action
from jezero.schemas.state import StatusCode
from tests.services.actions.rig import CONFIG, FAR, World

ACCELERATION_MAX_MPS2 = 2.0 * CONFIG.move.accel_mps2
"""Greatest acceleration of the setpoints: that of the path plus that of the pause."""
END_STEP_MPS = 0.07
"""The last step of a path to rest, whether or not it was paused."""


def request(world: World, payload: Any, action: Action[Any] = topics.GO_TO) -> Any:
    """The reply to a request about a goal."""
    endpoints: dict[Any, Any] = {Pause: action.pause, Resume: action.resume, Cancel: action.cancel}
    endpoint = endpoints[type(payload)]
    sent = world.bus.send_request(endpoint, payload)
    world.bus.run_for(0.1)
    assert sent.ended
    return sent.replies[0]


def assert_continuous(setpoints: list[Setpoint]) -> None:
    """Positions move no faster than their velocities say, and velocities change no faster than the acceleration."""
    for one, other in pairwise(setpoints):
        dt_s = (other.t_ns - one.t_ns) / 1e9
        assert one.pos_ned_m is not None
        assert other.pos_ned_m is not None
        assert one.vel_ned_mps is not None
        assert other.vel_ned_mps is not None
        fastest_mps = max(norm(one.vel_ned_mps), norm(other.vel_ned_mps))
        assert distance(one.pos_ned_m, other.pos_ned_m) <= fastest_mps * dt_s + 0.002
        assert norm(subtract(other.vel_ned_mps, one.vel_ned_mps)) <= ACCELERATION_MAX_MPS2 * dt_s + END_STEP_MPS


def test_a_paused_goal_brakes_hovers_and_goes_on_to_the_same_end() -> None:
    world = World()
    answers = world.flying()
    world.bus.run_for(4.0)
    assert request(world, Pause(goal_id="far")) == PauseReply(paused=True)
    world.bus.run_for(4.0)
    held_ned_m = world.bridge.pos_ned_m
    assert norm(world.bridge.vel_ned_mps) < 0.05
    world.bus.run_for(100.0)
    assert distance(world.bridge.pos_ned_m, held_ned_m) < 0.05
    assert world.bridge.code == StatusCode.GO_TO
    assert [setpoint.paused for setpoint in world.bridge.setpoints[-3:]] == [True] * 3
    assert answers.replies[-1].paused
    assert request(world, Resume(goal_id="far")) == ResumeReply(resumed=True)
    result = world.end(answers, 30.0)
    assert result.outcome == "succeeded"
    assert distance(result.result.pos_uav_ned_m, FAR.target_ned_m) < 0.15
    assert [setpoint.paused for setpoint in world.bridge.setpoints[-3:]] == [False] * 3
    assert_continuous(world.bridge.setpoints)


@pytest.mark.parametrize("after_s", [0.1, 0.5, 1.5, 3.0, 9.0, 10.5])
def test_a_pause_and_a_resume_at_any_time_make_no_jump(after_s: float) -> None:
    world = World()
    answers = world.flying()
    for wait_s in (after_s, 0.3, 0.2, 5.0):
        world.bus.run_for(wait_s)
        request(world, Pause(goal_id="far"))
        world.bus.run_for(0.5)
        request(world, Resume(goal_id="far"))
    assert world.end(answers, 30.0).outcome == "succeeded"
    assert_continuous(world.bridge.setpoints)


def test_the_remaining_time_stands_still_in_a_pause() -> None:
    world = World()
    answers = world.flying()
    request(world, Pause(goal_id="far"))
    world.bus.run_for(3.0)
    before = answers.replies[-1]
    world.bus.run_for(30.0)
    after = answers.replies[-1]
    assert isinstance(before, Feedback)
    assert before.remaining_s == after.remaining_s
    request(world, Resume(goal_id="far"))
    resumed_ns = world.bus.t_ns
    world.end(answers, 30.0)
    assert (world.bus.t_ns - resumed_ns) / 1e9 == pytest.approx(before.remaining_s, abs=1.5)


@pytest.mark.parametrize(
    ("prepare", "payload", "reply"),
    [
        ("none", Pause(goal_id="far"), PauseReply(paused=False, reason="no goal far is known to go_to")),
        ("fly", Pause(goal_id="x"), PauseReply(paused=False, reason="no goal x is known to go_to")),
        ("fly", Resume(goal_id="far"), ResumeReply(resumed=False, reason="the goal is not paused")),
        ("pause", Pause(goal_id="far"), PauseReply(paused=True)),
        ("end", Pause(goal_id="far"), PauseReply(paused=False, reason="the goal was already canceled")),
        ("end", Resume(goal_id="far"), ResumeReply(resumed=False, reason="the goal was already canceled")),
    ],
)
def test_what_can_not_be_paused_or_resumed_is_refused_with_the_reason(prepare: str, payload: Any, reply: Any) -> None:
    world = World()
    if prepare != "none":
        answers = world.flying()
        if prepare == "pause":
            request(world, Pause(goal_id="far"))
        elif prepare == "end":
            request(world, Cancel(goal_id="far"))
            world.end(answers)
    assert request(world, payload) == reply


def test_a_goal_that_does_not_fly_yet_or_is_ending_is_neither_paused_nor_resumed() -> None:
    """The camera is silent, so that the goal waits for it."""
    world = World()
    world.send(GetImagesGoal(center_ned_m=(0.0, 0.0, -4.0), radius_m=2.0, num_images=4, goal_id="orbit"))
    early = request(world, Pause(goal_id="orbit"), topics.GET_IMAGES)
    assert early == PauseReply(paused=False, reason="the goal does not fly yet")
    world = World()
    world.flying()
    world.bridge.lost_releases = 1000
    request(world, Cancel(goal_id="far"))
    world.bus.run_for(0.2)
    assert request(world, Pause(goal_id="far")) == PauseReply(paused=False, reason="the goal is ending already")
    assert request(world, Resume(goal_id="far")) == ResumeReply(resumed=False, reason="the goal is ending already")


def test_a_goal_that_has_arrived_and_waits_for_the_bridge_is_not_paused() -> None:
    world = World()
    world.bridge.lost_releases = 1000
    world.send(GoToGoal(target_ned_m=(1.0, 0.0, -3.0), goal_id="near"))
    assert world.bus.run_for(30.0, lambda: world.bridge.lost_releases < 1000)
    assert request(world, Pause(goal_id="near")) == PauseReply(paused=False, reason="the goal is ending already")


def test_a_goal_on_the_ground_is_not_paused() -> None:
    world = World((0.0, 0.0, 0.0))
    goal = GoToGoal(target_ned_m=(5.0, 0.0, -3.0), do_takeoff=True, goal_id="up")
    world.send(goal)
    world.bus.run_for(0.02)
    reply = request(world, Pause(goal_id="up"))
    assert not reply.paused
    assert "on the ground" in reply.reason


@pytest.mark.parametrize(
    ("issued_s_ago", "reason"), [(31.0, "expired after 30 s"), (-5.0, "in the future"), (3.0, "a newer request")]
)
def test_a_late_request_has_no_effect(issued_s_ago: float, reason: str) -> None:
    world = World()
    world.bus.run_for(40.0)
    world.flying()
    now_ns = world.bus.t_ns
    request(world, Pause(goal_id="far", issued_t_ns=now_ns - 10**9))
    request(world, Resume(goal_id="far", issued_t_ns=now_ns))
    reply = request(world, Pause(goal_id="far", issued_t_ns=now_ns - int(issued_s_ago * 1e9)))
    assert not reply.paused
    assert reason in reply.reason


def test_a_request_without_a_time_counts_from_its_arrival() -> None:
    world = World()
    world.bus.run_for(5.0)
    world.flying()
    begin_ns = world.bus.t_ns
    world.bus.run_for(0.5)
    assert request(world, Pause(goal_id="far")).paused
    late = request(world, Resume(goal_id="far", issued_t_ns=begin_ns))
    assert (late.resumed, late.reason) == (False, "a newer request came before this one")
    assert request(world, Resume(goal_id="far")).resumed
    assert not request(world, Pause(goal_id="far", issued_t_ns=begin_ns)).paused


@pytest.mark.parametrize("how", ["cancel", "revoke"])
def test_a_paused_goal_ends_as_ever(how: str) -> None:
    world = World()
    answers = world.flying()
    request(world, Pause(goal_id="far"))
    world.bus.run_for(5.0)
    if how == "cancel":
        request(world, Cancel(goal_id="far"))
        assert world.end(answers).outcome == "canceled"
    else:
        world.bridge.revoke(StatusCode.EXTERNAL, "a pilot took over")
        result = world.end(answers)
        assert (result.outcome, result.reason) == ("aborted", "a pilot took over")
    assert world.is_idle("go_to")
