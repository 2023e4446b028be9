"""Requests for control: which are granted, and which are refused with what reason."""

from dataclasses import replace
from typing import Any

import pytest

from jezero.schemas.commands import Abort, Acquire, Phase
from jezero.schemas.topics import ABORT, ACQUIRE, ACTIONS
from tests.services.vehicle_bridge.rig import Rig

SOMERSAULT: Any = "somersault"
"""A phase that no version of the bridge knows; only a newer schema could carry it."""


@pytest.mark.parametrize(
    ("action", "do_takeoff", "granted"),
    [("takeoff", False, True), ("go_to", True, True), ("go_to", False, False), ("land_on_spot", False, False)],
)
def test_on_the_ground_only_what_takes_off_is_accepted(action: str, do_takeoff: bool, granted: bool) -> None:
    reply = Rig().ready().acquire(action, do_takeoff=do_takeoff)
    assert reply.granted == granted
    assert granted or "take off first" in reply.reason


@pytest.mark.parametrize(("action", "granted"), [("takeoff", False), ("go_to", True), ("land_on_spot", True)])
def test_in_hover_everything_but_a_takeoff_is_accepted(action: str, granted: bool) -> None:
    reply = Rig().fly().acquire(action)
    assert reply.granted == granted
    assert granted or "the vehicle hovers" in reply.reason


@pytest.mark.parametrize("vel_mps", [(0.0, 0.0), (0.2, -0.2), (0.4, 0.0), (0.0, -0.4)])
def test_nothing_takes_off_from_ground_that_moves(vel_mps: tuple[float, float]) -> None:
    rig = Rig().ready()
    rig.autopilot.vel[:2] = vel_mps
    rig.run(0.2)
    moves = max(map(abs, vel_mps)) > 0.3
    assert rig.status.ready is not moves
    assert rig.acquire().granted is not moves
    if moves:
        expected = "the ground under the vehicle moves at 0.40 m/s: stop the rover, 0.3 m/s is the limit"
        assert rig.status.not_ready_reason == expected


def test_the_status_names_the_goal_that_got_control_and_not_one_that_only_asked() -> None:
    rig = Rig().fly()
    asked = rig.request(ACQUIRE, Acquire(goal_id="later", action="go_to", check_only=True))
    assert asked.reason == "" and "in charge" not in rig.status.text
    assert rig.acquire("go_to").granted
    rig.step()
    assert rig.status.text == "the goal go to is in charge"


def test_a_second_goal_is_refused_with_who_is_in_charge_and_the_status() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    reply = rig.request(ACQUIRE, Acquire(goal_id="other", action="go_to"))
    assert not reply.granted
    assert reply.reason == "the goal go to is in charge: wait for it or abort it"
    rig.step()
    assert rig.status.text == "the goal go to has begun"


def test_of_two_goals_in_one_step_the_first_is_accepted() -> None:
    rig = Rig().ready()
    first = rig.post(ACQUIRE, Acquire(goal_id="a", action="takeoff"))
    second = rig.post(ACQUIRE, Acquire(goal_id="b", action="takeoff"))
    rig.step()
    assert rig.replies[first].granted
    assert not rig.replies[second].granted


def test_an_acquire_that_is_repeated_because_its_reply_was_lost_gets_the_same_control() -> None:
    rig = Rig().ready()
    assert rig.acquire(goal_id="g").control_id == rig.acquire(goal_id="g").control_id != ""


def test_a_goal_that_flies_already_gets_no_second_control() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    reply = rig.acquire("go_to", goal_id="goal-go_to")
    assert not reply.granted and reply.control_id == ""
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(1.0, 0.0, -2.0))
    rig.step()
    assert rig.autopilot.setpoints[-1].x == 1.0, "the first control is as it was"


@pytest.mark.parametrize(
    ("age_s", "refusal"),
    [
        (0.0, ""),
        (0.8, ""),
        (1.2, "the request is 1.2 s old"),
        (-0.8, ""),
        (-3600.0, "the request is 3600.0 s ahead of vehicle time"),
    ],
)
def test_an_old_request_for_control_is_refused(age_s: float, refusal: str) -> None:
    rig = Rig().ready()
    issued_t_ns = rig.t_ns - int(age_s * 1e9)
    reply = rig.request(ACQUIRE, Acquire(goal_id="g", action="takeoff", issued_t_ns=issued_t_ns))
    assert reply.granted == (not refusal)
    assert refusal in reply.reason


def test_an_action_of_a_package_needs_a_hovering_vehicle() -> None:
    reply = Rig().ready().acquire("somersault")
    assert "somersault needs a hovering vehicle," in reply.reason


def test_an_action_whose_phase_the_bridge_does_not_know_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    somersault = replace(ACTIONS["go_to"], name="somersault", phase=SOMERSAULT)
    monkeypatch.setitem(ACTIONS, "somersault", somersault)
    reply = Rig().fly().acquire("somersault")
    assert not reply.granted
    assert "doesn't know phase 'somersault'" in reply.reason


def test_before_the_autopilot_is_ready_a_takeoff_is_refused_with_what_is_missing() -> None:
    rig = Rig()
    rig.autopilot.armable = False
    rig.run(0.2)
    reply = rig.acquire()
    assert not reply.granted
    assert "arming checks" in reply.reason
    assert rig.status.not_ready_reason in reply.reason


def test_a_goal_that_was_being_prepared_during_an_abort_is_not_flown() -> None:
    rig = Rig().fly()
    came_ns = rig.t_ns
    rig.run(0.3)
    rig.request(ABORT, Abort())
    rig.run(0.2)
    late = rig.request(ACQUIRE, Acquire(goal_id="late", action="go_to", goal_t_ns=came_ns))
    assert not late.granted
    assert late.reason == "this goal came before the last abort: send it again"
    assert rig.request(ACQUIRE, Acquire(goal_id="new", action="go_to", goal_t_ns=rig.t_ns)).granted


def test_a_goal_from_before_the_bridge_started_is_not_flown_as_nobody_may_remember_that_it_flew() -> None:
    rig = Rig()
    before_ns = rig.t_ns
    rig.fly()
    old = rig.request(ACQUIRE, Acquire(goal_id="old", action="go_to", goal_t_ns=rig.t_ns, goal_issued_t_ns=before_ns))
    assert not old.granted
    assert old.reason == "this goal is from before the bridge started and may have flown: send it with a new id"
    assert rig.request(ACQUIRE, Acquire(goal_id="new", action="go_to", goal_issued_t_ns=rig.t_ns)).granted


def test_a_goal_that_has_flown_is_not_flown_again_and_one_that_sent_no_setpoint_may_still_be() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.setpoint(control_id, Phase.GO_TO)
    assert rig.release(control_id, hover_pos_ned_m=(0.0, 0.0, -2.0)).released
    again = rig.acquire("go_to", goal_id="goal-go_to")
    assert not again.granted
    assert again.reason == "this goal has flown already, and a goal runs once: send it with a new id"
    waiting = rig.acquire("go_to", goal_id="waiting")
    assert rig.release(waiting.control_id, "canceled").released
    assert rig.acquire("go_to", goal_id="waiting").granted


def test_a_goal_that_has_sent_a_single_setpoint_has_flown() -> None:
    rig = Rig().fly()
    control_id = rig.acquire("go_to", goal_id="short").control_id
    rig.setpoint(control_id, Phase.GO_TO)
    rig.step()
    assert rig.release(control_id, "canceled").released
    assert "has flown already" in rig.acquire("go_to", goal_id="short").reason


def test_a_request_that_only_checks_gets_the_decision_and_changes_nothing() -> None:
    rig = Rig().fly()
    before = rig.status

    def check(action: str) -> Any:
        return rig.request(ACQUIRE, Acquire(goal_id="plan", action=action, check_only=True))

    assert check("go_to").granted
    assert check("go_to").control_id == ""
    assert "it flies already" in check("takeoff").reason
    rig.run(0.2)
    assert (rig.status.in_charge, rig.status.grants, rig.status.text) == ("hover", before.grants, before.text)
    rig.go("go_to", Phase.GO_TO)
    assert "is in charge" in check("get_images").reason


def test_the_refusal_on_the_ground_names_no_option_of_one_interface() -> None:
    reply = Rig().ready().acquire("go_to")
    advice = "take off first, or let the goal begin with a takeoff"
    assert reply.reason == f"go to needs a hovering vehicle, and the vehicle is on the ground: {advice}"
