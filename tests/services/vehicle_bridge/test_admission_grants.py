"""The grants of a bridge: what it remembers of those that have ended, and when a silent goal loses its own."""

import pytest

from jezero.schemas.commands import Acquire
from jezero.schemas.state import StatusCode
from jezero.services.vehicle_bridge.admission import Grants
from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot

HOVERING = VehicleSnapshot(t_ns=0, timer_ns=0, armed=True)


def acquire(grants: Grants, goal_id: str) -> str:
    """Acquire control for a goal; returns the refusal."""
    return grants.acquire(Acquire(goal_id=goal_id, action="go_to"), StatusCode.HOVER, "", HOVERING)


def test_the_owners_of_the_last_32_grants_get_the_reason_why_their_control_ended() -> None:
    grants, control_ids = Grants("secret"), []
    for number in range(33):
        assert acquire(grants, f"goal {number}") == ""
        assert grants.present is not None
        control_ids.append(grants.present.control_id)
        grants.end(f"end {number}")
    assert [grants.end_reason(control_id) for control_id in control_ids[1:]] == [f"end {n}" for n in range(1, 33)]
    assert grants.end_reason(control_ids[0]) == "this control was never given"
    assert len(set(control_ids)) == 33


@pytest.mark.parametrize("again", [False, True], ids=["each once", "one of them twice"])
def test_the_last_100_goals_that_have_flown_do_not_fly_again(again: bool) -> None:
    grants = Grants("secret")
    for number in range(101):
        grants.add_flown(f"goal {number}")
        if again and number < 100:
            grants.add_flown(f"goal {number}")
    assert all("has flown already" in acquire(grants, f"goal {number}") for number in range(1, 101))
    assert acquire(grants, "goal 0") == ""
