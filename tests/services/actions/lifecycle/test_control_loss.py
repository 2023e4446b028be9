"""Ends of goals that lose their control, their bridge or their vehicle, or whose release gets no reply."""

import msgspec
import pytest

from jezero.codec import decode, encode
from jezero.schemas import topics
from jezero.schemas.actions import Cancel
from jezero.schemas.goals import GoToGoal
from jezero.schemas.state import Status, StatusCode
from tests.services.actions.rig import FAR, World


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


def test_a_release_that_is_never_answered_is_given_up() -> None:
    world = World()
    world.bridge.lost_releases = 10_000
    goal = world.flying()
    world.bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="far"))
    result = world.end(goal, 21.0)
    assert result.outcome == "aborted"
    assert "did not confirm the end of the goal" in result.reason
