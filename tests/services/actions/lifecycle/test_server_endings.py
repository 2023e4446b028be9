"""Ends of goals before their time: canceled, with their client, without their bridge or vehicle, and in any order."""

from collections.abc import Callable
from itertools import pairwise
from math import isfinite
from typing import Any, Literal

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.base.codec import decode, encode
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, Rejected, Result
from jezero.schemas.commands import Release, ReleaseReply, Setpoint
from jezero.schemas.goals import GoToGoal
from jezero.schemas.state import Status, StatusCode
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Done
from jezero.services.actions.table import action_server
from tests.services.actions.fake_bridge import FakeBridge
from tests.services.actions.lifecycle.bench import HOVER, Bench, Hovers, calls, published, replies
from tests.services.actions.rig import FAR, World

# -- canceled, or with their client --


def test_a_canceled_goal_is_released_and_says_so() -> None:
    world = World()
    goal = world.flying()
    reply = world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    result = world.end(goal)
    assert reply.replies[0].canceled
    assert result.outcome == "canceled"
    assert not result.result.completed
    assert world.bridge.releases[0].outcome == "canceled"
    late = world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    other = world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="nobody"))
    world.bus.run_for(0.2)
    assert (late.replies[0].canceled, late.replies[0].reason) == (False, "the goal was already canceled")
    assert (other.replies[0].canceled, other.replies[0].reason) == (False, "no goal nobody is known to go_to")


def test_a_goal_whose_cancel_comes_before_it_does_not_fly() -> None:
    world = World()
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    world.bus.run_for(1.0)
    reply = world.fly(FAR)
    assert isinstance(reply, Rejected)
    assert reply.reason == "the goal was canceled before it arrived: send it again with another goal_id"
    assert world.bridge.grants == 0


@pytest.mark.parametrize(
    ("client_id", "reason"),
    [
        ("me", "canceled by a client"),
        ("", "canceled by a client"),
        ("py-0123456789ab", "canceled by another client, py-0123456789ab"),
    ],
)
def test_a_goal_that_another_client_cancels_says_which(client_id: str, reason: str) -> None:
    world = World()
    goal = world.flying()
    reply = world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"), client_id=client_id)
    result = world.end(goal)
    assert reply.replies[0].canceled
    assert (result.outcome, result.reason) == ("canceled", reason)


def test_a_cancel_that_comes_before_the_grant_still_cancels() -> None:
    world = World()
    goal = world.send(FAR)
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    result = world.end(goal)
    assert result.outcome == "canceled"
    assert world.bridge.setpoints == []
    assert world.bridge.control_id == ""


def test_a_vanished_client_ends_its_goal_only_when_asked_to() -> None:
    cases: tuple[tuple[Literal["continue", "cancel"], str], ...] = (("continue", "succeeded"), ("cancel", "canceled"))
    for loss, outcome in cases:
        world = World()
        goal = GoToGoal(target_ned_m=(3.0, 0.0, -3.0), goal_id="g", on_client_loss=loss)
        answers = world.flying(goal, "gone")
        world.bus.client_departs("somebody")
        world.bus.run_for(0.2)
        assert not answers.ended
        world.bus.client_departs("gone")
        assert world.end(answers, 30.0).outcome == outcome


def test_a_goal_with_two_clients_outlives_one_of_them() -> None:
    world = World()
    goal = GoToGoal(target_ned_m=(9.0, 0.0, -3.0), goal_id="g", on_client_loss="cancel")
    first = world.flying(goal, "a")
    world.send(goal, "b")
    world.bus.run_for(0.1)
    world.bus.client_departs("a")
    world.bus.run_for(0.5)
    assert not first.ended
    world.bus.client_departs("b")
    assert world.end(first).outcome == "canceled"


def test_a_goal_that_nobody_can_watch_over_says_so() -> None:
    world = World()
    goal = GoToGoal(target_ned_m=(9.0, 0.0, -3.0), goal_id="g", on_client_loss="cancel")
    unnamed, named = world.flying(goal, ""), world.send(goal, "me")
    world.bus.run_for(0.1)
    assert "on_client_loss has no effect" in unnamed.replies[0].warning
    assert world.bus.run_for(0.1) is False
    assert isinstance(named.replies[0], Accepted)
    watched = World().flying(goal, "me")
    assert watched.replies[0].warning == ""


# -- without control, bridge or vehicle, or without a reply to their release --


@pytest.mark.parametrize("code", [StatusCode.ABORT, StatusCode.EXTERNAL, StatusCode.HOVER])
def test_control_taken_away_ends_the_goal_with_the_bridges_words(code: StatusCode) -> None:
    world = World()
    goal = world.flying()
    world.bridge.revoke(code, "aborted: somebody said so")
    result = world.end(goal, 0.2)
    assert (result.outcome, result.reason) == ("aborted", "aborted: somebody said so")
    assert world.bridge.releases == []


@pytest.mark.parametrize("after_s", [0.0, 0.05, 1.0])
@pytest.mark.parametrize("ahead_s", [-0.3, 0.0, 0.4])
def test_a_status_from_before_the_grant_ends_nothing(after_s: float, ahead_s: float) -> None:
    """Whatever its time says: the bridge's clock may run ahead while the simulator stands still, and go back then."""
    world = World()
    published: list[bytes] = []
    world.bus.observe(lambda t_ns, name, data: published.append(data) if name == topics.STATUS.name else None)
    world.bus.run_for(0.2)
    before = decode(Status, published[-1])
    goal = world.send(FAR)
    assert world.bus.run_for(1.0, lambda: bool(goal.replies))
    world.bus.run_for(after_s)
    stale = msgspec.structs.replace(before, t_ns=world.bus.t_ns + int(ahead_s * 1e9), text="long ago")
    world.bus.publish("vehicle_bridge", topics.STATUS, encode(stale))
    world.bus.run_for(1.0)
    assert not goal.ended, goal.replies[-1]


@pytest.mark.parametrize(
    ("name", "reason"), [("boot_id", "the vehicle bridge restarted"), ("epoch_id", "the vehicle restarted")]
)
def test_another_boot_or_epoch_ends_the_goal(name: str, reason: str) -> None:
    world = World()
    goal = world.flying()
    setattr(world.bridge, name, 8)
    result = world.end(goal, 0.2)
    assert (result.outcome, result.reason) == ("aborted", reason)


def test_a_restarted_bridge_that_does_not_know_the_epoch_yet_is_no_restart_of_the_vehicle() -> None:
    world = World()
    goal = world.flying()
    world.bridge.boot_id, world.bridge.epoch_id = 8, 0
    result = world.end(goal, 0.2)
    assert (result.outcome, result.reason) == ("aborted", "the vehicle bridge restarted")


def test_a_dead_bridge_ends_the_goal_within_1_2_s() -> None:
    world = World()
    goal = world.flying()
    world.bus.remove("vehicle_bridge")
    result = world.end(goal, 1.2)
    assert result.outcome == "aborted"
    assert "the vehicle bridge has been silent for 1 s" in result.reason


def test_lost_odometry_aborts_after_half_a_second_and_releases() -> None:
    world = World()
    goal = world.flying()
    world.bridge.mute_odometry = True
    result = world.end(goal, 0.7)
    assert (result.outcome, result.reason) == ("aborted", "the vehicle's position is unknown: no odometry for 0.5 s")
    assert world.bridge.releases[0].outcome == "aborted"


def test_setpoints_go_on_25_times_a_second_while_odometry_is_late() -> None:
    """The autopilot ends the flight without them."""
    world = World()
    world.flying()
    world.bridge.mute_odometry = True
    muted_ns = world.bus.t_ns
    world.bus.run_for(0.45)
    times_ns = [muted_ns, *(setpoint.t_ns for setpoint in world.bridge.setpoints if setpoint.t_ns > muted_ns)]
    assert world.bus.t_ns - times_ns[-1] < 60_000_000
    assert max(after - before for before, after in pairwise(times_ns)) < 60_000_000


def test_no_setpoint_follows_the_loss_of_control() -> None:
    world = World()
    goal = world.flying()
    world.bridge.revoke(StatusCode.ABORT, "aborted")
    world.end(goal, 0.2)
    late: list[int] = []
    world.bus.observe(lambda t_ns, name, data: late.append(t_ns) if name == "command/setpoint" else None)
    world.bus.run_for(1.0)
    assert late == []


@pytest.mark.parametrize("way", ["lost_releases", "lost_replies"])
def test_a_release_whose_answer_is_lost_is_asked_again(way: str) -> None:
    world = World()
    setattr(world.bridge, way, 2)
    answers = world.send(GoToGoal(target_ned_m=(1.0, 0.0, -3.0), goal_id="g"))
    result = world.end(answers, 30.0)
    assert result.outcome == "succeeded"
    assert world.bridge.code == StatusCode.HOVER
    assert world.is_idle("go_to")


def test_a_canceled_goal_whose_release_was_carried_out_without_a_reply_is_canceled() -> None:
    world = World()
    world.bridge.lost_replies = 1
    goal = world.flying()
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"), "me")
    result = world.end(goal, 21.0)
    assert (result.outcome, result.reason) == ("canceled", "canceled by a client")
    assert [release.outcome for release in world.bridge.releases] == ["canceled", "canceled"]


def test_a_goal_whose_vehicle_somebody_else_has_taken_meanwhile_is_no_success() -> None:
    world = World()
    world.bridge.lost_replies = 1
    answers = world.send(GoToGoal(target_ned_m=(1.0, 0.0, -3.0), goal_id="g"))
    assert world.bus.run_for(30.0, lambda: bool(world.bridge.releases))
    world.bridge.code = StatusCode.EXTERNAL
    result = world.end(answers, 21.0)
    assert (result.outcome, result.reason) == ("aborted", "this control is not in charge")


def test_a_goal_whose_first_release_is_refused_is_no_success_though_the_vehicle_hovers() -> None:
    world = World()
    published: list[bytes] = []
    world.bus.observe(lambda t_ns, name, data: published.append(data) if name == topics.STATUS.name else None)
    answers = world.send(GoToGoal(target_ned_m=(1.0, 0.0, -3.0), goal_id="g"))
    server = world.servers["go_to"]
    assert world.bus.run_for(30.0, lambda: server._run is not None and server._run.stage == "releasing")
    world.bridge.revoke(StatusCode.HOVER, "hover was asked for")
    hovering = msgspec.structs.replace(
        decode(Status, published[-1]), t_ns=world.bus.t_ns, code=int(StatusCode.HOVER), in_charge="hover", grant=0
    )
    world.bus.publish("vehicle_bridge", topics.STATUS, encode(hovering))  # it overtakes the reply
    result = world.end(answers)
    assert (result.outcome, result.reason) == ("aborted", "this control is not in charge")


def test_a_release_that_is_never_answered_is_given_up() -> None:
    world = World()
    world.bridge.lost_releases = 10_000
    goal = world.flying()
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    result = world.end(goal, 21.0)
    assert result.outcome == "aborted"
    assert "did not confirm the end of the goal" in result.reason


# -- whatever happens, every goal ends exactly once --

FREE_AGAIN_S = 50.0
GOAL = GoToGoal(target_ned_m=(6.0, -3.0, -4.0), goal_id="g", on_client_loss="cancel")
Fault = Callable[[MemoryBus, FakeBridge], object]

FAULTS: dict[str, Fault] = {
    "cancel": lambda bus, bridge: bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="g")),
    "send again": lambda bus, bridge: bus.send_request(topics.GO_TO.endpoint, GOAL, "second"),
    "client gone": lambda bus, bridge: bus.client_departs("me"),
    "second client gone": lambda bus, bridge: bus.client_departs("second"),
    "abort": lambda bus, bridge: bridge.revoke(StatusCode.ABORT, "aborted"),
    "pilot": lambda bus, bridge: bridge.revoke(StatusCode.EXTERNAL, "taken over"),
    "hover": lambda bus, bridge: bridge.revoke(StatusCode.HOVER, "hover was asked for"),
    "bridge restarts": lambda bus, bridge: setattr(bridge, "boot_id", bridge.boot_id + 1),
    "vehicle restarts": lambda bus, bridge: setattr(bridge, "epoch_id", bridge.epoch_id + 1),
    "odometry stops": lambda bus, bridge: setattr(bridge, "mute_odometry", True),
    "odometry resumes": lambda bus, bridge: setattr(bridge, "mute_odometry", False),
    "status stops": lambda bus, bridge: setattr(bridge, "mute_status", True),
    "status resumes": lambda bus, bridge: setattr(bridge, "mute_status", False),
    "releases are lost": lambda bus, bridge: setattr(bridge, "lost_releases", 3),
    "replies are lost": lambda bus, bridge: setattr(bridge, "lost_replies", 3),
    "all releases are lost": lambda bus, bridge: setattr(bridge, "lost_releases", 10_000),
    "reset": lambda bus, bridge: bridge.step_position((0.7, -0.4, 0.1)),
    "bridge dies": lambda bus, bridge: bus.remove("vehicle_bridge") if "vehicle_bridge" in bus._ports else None,
}


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.sampled_from(sorted(FAULTS))), max_size=5))
def test_a_goal_ends_exactly_once_whatever_happens(faults: list[tuple[float, str]]) -> None:
    bus = MemoryBus(seed=2)
    bridge = FakeBridge((0.0, 0.0, -3.0))
    server = action_server("go_to", 5, ActionsConfig())
    bus.add(bridge)
    bus.add(server)
    setpoints: list[Setpoint] = []

    def note(t_ns: int, name: str, data: bytes) -> None:
        if name == topics.SETPOINT.name:
            setpoints.append(decode(Setpoint, data))

    bus.observe(note)
    bus.run_for(0.5)
    answers = bus.send_request(topics.GO_TO.endpoint, GOAL, "me")
    for after_s, name in faults:
        bus.run_for(after_s)
        FAULTS[name](bus, bridge)
    assert bus.run_for(FREE_AGAIN_S, lambda: answers.ended and server._run is None)
    assert isinstance(answers.replies[0], Accepted | Rejected)
    assert [r for r in answers.replies if isinstance(r, Result | Rejected)] == [answers.replies[-1]]
    last = answers.replies[-1]
    if isinstance(last, Result) and last.outcome != "succeeded":
        assert last.reason
    sequence = [s.sequence for s in setpoints]
    assert sequence == sorted(set(sequence))
    assert all(isfinite(x) for s in setpoints if s.pos_ned_m for x in s.pos_ned_m)
    sent = len(setpoints)
    bus.run_for(1.0)
    assert len(setpoints) == sent


def test_a_second_cancel_reads_that_the_goal_is_ending_already() -> None:
    world = World()
    goal = world.flying()
    world.bridge.lost_releases = 10_000
    first, second = (world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far")) for _ in range(2))
    world.bus.run_for(0.1)
    assert not goal.ended
    assert [each.replies[0].canceled for each in (first, second)] == [True, False]
    assert second.replies[0].reason == "the goal is ending already"


# -- step by step: the release --


@pytest.mark.parametrize(
    ("case", "reason"),
    [
        ("hovers", "canceled by a client"),
        ("in charge", "canceled by a client; not yet"),
        ("old status", "canceled by a client; not yet"),
    ],
)
def test_a_refused_release_counts_as_carried_out_only_by_a_new_status_without_the_goal_in_charge(
    case: str, reason: str
) -> None:
    bench = Bench()
    bench.fly(FAR)
    bench.request(Cancel(goal_id="far"))
    bench.step()
    outputs = bench.step()
    assert calls(outputs, Release)
    bench.respond(outputs, None, "timeout")
    bench.step()
    second = bench.step(0.3)
    assert calls(second, Release)
    bench.take_control()
    if case == "in charge":
        bench.give_control(StatusCode.HOVER)
    bench.step()
    bench.respond(second, ReleaseReply(released=False, code=int(StatusCode.HOVER), reason="not yet"))
    outputs = bench.step_alone(1.1) if case == "old status" else bench.step()
    (result,) = replies(outputs, Result)
    assert (result.outcome, result.reason) == ("canceled", reason)


@pytest.mark.parametrize(
    ("then", "code", "outcome"),
    [
        ("hover", StatusCode.HOVER, "succeeded"),
        ("hover", StatusCode.IDLE, "aborted"),
        ("disarm", StatusCode.IDLE, "succeeded"),
        ("disarm", StatusCode.HOVER, "aborted"),
    ],
)
def test_a_success_whose_reply_was_lost_is_one_only_in_the_state_that_it_wanted(
    then: Any, code: StatusCode, outcome: str
) -> None:
    bench = Bench(HOVER, hovers := Hovers())
    bench.fly(FAR)
    hovers.done = Done("succeeded", then=then)
    outputs = bench.step()
    bench.respond(outputs, None, "timeout")
    bench.step()
    second = bench.step(0.3)
    assert calls(second, Release)
    bench.take_control(code)
    bench.respond(second, ReleaseReply(released=False, code=int(code), reason="another state"))
    (result,) = replies(bench.step(), Result)
    assert (result.outcome, result.reason) == (outcome, "" if outcome == "succeeded" else "another state")


@pytest.mark.parametrize(("outcome", "streams"), [("succeeded", True), ("aborted", False)])
def test_setpoints_go_on_until_the_bridge_confirms_a_success_and_end_with_anything_else(
    outcome: Any, streams: bool
) -> None:
    bench = Bench(HOVER, hovers := Hovers())
    bench.fly(FAR)
    hovers.done = Done(outcome)
    assert calls(bench.step(), Release)
    setpoints = [len(published(bench.step(), topics.SETPOINT)) for _ in range(10)]
    assert setpoints == [int(streams)] * 10
    bench.take_control()
    assert not published(bench.step(), topics.SETPOINT), "another is in charge"


@pytest.mark.parametrize(("then", "least_s", "most_s"), [("hover", 4.0, 8.0), ("disarm", 9.0, 15.0)])
def test_a_disarm_is_awaited_longer_than_a_hover_before_its_release_is_sent_again(
    then: Any, least_s: float, most_s: float
) -> None:
    bench = Bench(HOVER, hovers := Hovers())
    bench.fly(FAR)
    hovers.done = Done("succeeded", then=then)
    (call,) = calls(bench.step(), Release)
    assert least_s < call.timeout_s < most_s
