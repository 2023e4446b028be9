"""Requests to actions that don't exist."""

import pytest

from jezero.schemas.actions import CancelReply, PlanReply, Rejected, UnknownAction
from jezero.schemas.topics import ACTIONS, UNKNOWN_ACTION
from jezero.services.vehicle_bridge.requests import unknown_action_reply
from tests.services.vehicle_bridge.rig import Rig

KNOWN = "known are takeoff, go_to, fly_velocity, get_images, area_coverage, land_on_spot, return_home."


def test_a_goal_of_an_action_that_does_not_exist_is_refused_with_those_that_do() -> None:
    refusal = unknown_action_reply("@action/fly", tuple(ACTIONS))
    assert isinstance(refusal, Rejected)
    assert refusal.reason.startswith(f"there is no action 'fly'; {KNOWN} `action/*/description`")


@pytest.mark.parametrize(
    ("written", "meant"),
    [("takeof", "takeoff"), ("goto", "go_to"), ("land_on_the_spot", "land_on_spot"), ("Go_to", "go_to")],
)
def test_the_nearest_name_is_suggested(written: str, meant: str) -> None:
    refusal = unknown_action_reply(f"@action/{written}", tuple(ACTIONS))
    assert isinstance(refusal, Rejected)
    assert f"did you mean '{meant}'?" in refusal.reason


def test_an_action_of_a_package_is_known_and_suggested() -> None:
    known = (*ACTIONS, "spiral")
    assert unknown_action_reply("@action/spiral", known) is None
    refusal = unknown_action_reply("@action/spirale", known)
    assert isinstance(refusal, Rejected) and "did you mean 'spiral'?" in refusal.reason


def test_a_plan_and_a_cancel_get_replies_of_their_own_kind() -> None:
    plan, cancel = (unknown_action_reply(f"@action/fly/{request}", tuple(ACTIONS)) for request in ("plan", "cancel"))
    assert isinstance(plan, PlanReply) and not plan.accepted and KNOWN in plan.reason
    assert isinstance(cancel, CancelReply) and not cancel.canceled and KNOWN in cancel.reason


@pytest.mark.parametrize("key", ["@action/takeoff", "@action/takeoff/plan", "@action/result", "@action/fly/nonsense"])
def test_a_request_that_an_action_server_has_or_nobody_understands_gets_no_refusal(key: str) -> None:
    assert unknown_action_reply(key, tuple(ACTIONS)) is None


def test_the_bridge_replies_whatever_it_does() -> None:
    for rig in (Rig(), Rig().ready().fly()):
        refusal = rig.request(UNKNOWN_ACTION, UnknownAction(key="@action/" + "x" * 5000))
        assert isinstance(refusal, Rejected) and len(refusal.reason) < 300
