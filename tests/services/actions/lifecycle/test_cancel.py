"""Goals that end before their time: canceled, or with their client."""

from typing import Literal

import pytest

from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, Rejected
from jezero.schemas.goals import GoToGoal
from tests.services.actions.rig import FAR, World


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
    assert (late.replies[0].canceled, late.replies[0].reason) == (False, "the goal has already canceled")
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
