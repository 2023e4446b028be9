"""The actions of a stack, and the goal that is flown, whichever client sent it."""

import msgspec
import pytest

from jezero import Refused, Unreachable, Vehicle
from jezero.client.actions import described
from jezero.schemas.actions import CancelReply, RunningGoal
from jezero.schemas.commands import Phase
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.rows import Action
from jezero.schemas.topics import GO_TO, TAKEOFF
from tests.client.rig import Server, endpoint, server, vehicle

__all__ = ["endpoint", "server", "vehicle"]


def test_the_descriptions_of_all_servers_are_found_by_one_request(vehicle: Vehicle, server: Server) -> None:
    assert vehicle.actions.descriptions() == []
    for action in (TAKEOFF, GO_TO):
        server.serve(action.describe.name, action.description)
    assert [description.name for description in vehicle.actions.descriptions()] == ["go_to", "takeoff"]


def test_the_goal_that_is_flown_is_found_among_servers_that_fly_none(vehicle: Vehicle, server: Server) -> None:
    server.serve(TAKEOFF.running.name, RunningGoal(action="takeoff"))
    assert vehicle.actions.running() is None
    flown = RunningGoal(action="go_to", goal_id="theirs-1", clients=("theirs",), goal={"speed_mps": None})
    server.serve(GO_TO.running.name, flown)
    assert vehicle.actions.running() == flown


def test_a_goal_of_another_client_is_canceled_by_its_id(vehicle: Vehicle, server: Server) -> None:
    server.serve(GO_TO.cancel.name, CancelReply(canceled=True))
    vehicle.actions.cancel("go_to", "theirs-1")
    assert server.asked[-1][2] == {"goal_id": "theirs-1"}


def test_a_cancel_that_comes_too_late_tells_why(vehicle: Vehicle, server: Server) -> None:
    with pytest.raises(Unreachable):
        vehicle.actions.cancel("go_to", "theirs-1")
    server.serve(GO_TO.cancel.name, CancelReply(canceled=False, reason="goal theirs-1 has already succeeded"))
    with pytest.raises(Refused, match="already succeeded"):
        vehicle.actions.cancel("go_to", "theirs-1")


def test_an_installed_action_keeps_its_own_types() -> None:
    assert described(GO_TO.description) is GO_TO


def test_an_action_that_only_the_stack_has_is_sent_with_the_fields_of_its_description() -> None:
    other = Action("spiral", TakeoffGoal, dict, dict, Phase.ACTION)
    action = described(other.description)
    assert (action.endpoint.name, action.plan.name) == ("@action/spiral", "@action/spiral/plan")
    goal = msgspec.convert({"altitude_m": 3.0, "goal_id": "a-1"}, action.goal_type)
    assert msgspec.to_builtins(goal) == {
        "goal_id": "a-1", "issued_t_ns": None, "on_client_loss": "continue", "plan_from_ned_m": None,
        "altitude_m": 3.0,
    }  # fmt: skip
    with pytest.raises(msgspec.ValidationError, match="height"):
        msgspec.convert({"height": 3.0}, action.goal_type)
