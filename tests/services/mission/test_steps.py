"""A mission from its first step to its end: what flies next, and what a person who intervenes can rely on."""

from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from jezero.base.codec import decode, encode
from jezero.runtime.service import Response
from jezero.schemas.actions import Cancel, PauseReply, Result, ResultReply, Resume, ResumeReply
from jezero.schemas.goals import AreaCoverageGoal, CoverageResult
from jezero.schemas.mission import (
    FailurePolicy,
    GoalStep,
    Mission,
    MissionCommand,
    MissionProgress,
    MissionReply,
    Step,
    WaitStep,
)
from jezero.schemas.state import Status
from jezero.services.mission.record import MissionRecord
from tests.client.rig import a_result
from tests.services.mission.rig import FLYING, LANDED, STEP, Flown, at_altitude

WAIT = WaitStep(label="look around", duration_s=10.0)
LAND = GoalStep(label="land", action="land_on_spot", goal={})
HOVER_REQUESTED = replace(FLYING, interventions=1, text="hover requested")
EXTERNAL = replace(FLYING, in_charge="external", text="POSCTL")


def started(*steps: Step, status: Status = FLYING) -> Flown:
    """A mission whose first goal or wait has begun."""
    flown = Flown()
    assert flown.ask(status, Mission(name="survey", steps=steps)).accepted
    flown.step(status)
    return flown


def with_policy(retries: int = 0, then: Any = "stop") -> GoalStep:
    return replace(STEP, on_failure=FailurePolicy(retries=retries, then=then))


def in_charge(goal_id: str, action: str = "go_to") -> Status:
    return replace(FLYING, in_charge="goal", goal_id=goal_id, action=action)


def canceled(calls: list[tuple[str, Any]]) -> list[str]:
    """Goals to which requests to end them were sent; the same one may be sent twice."""
    return list(dict.fromkeys(payload.goal_id for _, payload in calls if isinstance(payload, Cancel)))


def test_a_mission_flies_its_steps_one_after_the_other_and_succeeds() -> None:
    flown = started(STEP, WAIT, STEP)
    assert (flown.progress.goal_id, flown.progress.step, flown.progress.steps) == ("mission-1-1.1.1", 1, 3)
    assert flown.end_goal(FLYING) == []
    for _ in range(9):
        flown.step(FLYING)
        assert (flown.progress.label, flown.progress.attempt) == ("look around", 1)
    ((tag, _),) = flown.calls(FLYING)
    assert tag == "mission-1-1.3.1/goal"
    flown.end_goal(FLYING)
    assert (flown.state, flown.progress.reason) == ("succeeded", "")
    assert flown.health == "survey: succeeded"
    assert flown.calls(FLYING) == []
    assert flown.ask(FLYING, Mission(name="again", steps=(STEP,))).mission_id == "mission-1-2"


def test_a_mission_begins_when_the_vehicles_status_is_known() -> None:
    flown = Flown()
    assert flown.ask(None, Mission(name="survey", steps=(STEP,))).accepted
    assert flown.goals(None) == []
    assert [name for name, _ in flown.goals(FLYING)] == ["go_to"]


def test_a_step_that_fails_is_tried_again_and_then_ends_the_mission() -> None:
    flown = started(with_policy(retries=2), STEP)
    for attempt in (2, 3):
        ((tag, _),) = flown.end_goal(FLYING, "aborted", "too much wind")
        assert tag == f"mission-1-1.1.{attempt}/goal"
        assert (flown.state, flown.progress.reason) == ("running", "tried again: too much wind")
    assert flown.end_goal(FLYING, "aborted", "too much wind") == []
    assert (flown.state, flown.progress.reason) == ("failed", "too much wind")


def test_the_tries_of_one_step_are_not_those_of_the_next() -> None:
    flown = started(with_policy(retries=1), with_policy(retries=1))
    flown.end_goal(FLYING, "aborted", "wind")
    ((tag, _),) = flown.end_goal(FLYING)
    assert tag == "mission-1-1.2.1/goal"
    flown.end_goal(FLYING, "aborted", "wind")
    assert flown.state == "running"


def test_a_step_that_is_done_in_part_is_tried_again_with_its_rest_until_more_of_it_is_done() -> None:
    corners = ((0.0, 0.0), (0.0, 5.0), (5.0, 5.0))
    area = GoalStep(label="map", action="area_coverage", goal={"polygon_ned_m": corners, "z_ned_m": -4.0})
    flown = started(replace(area, on_failure=FailurePolicy(retries=2)))
    rest = AreaCoverageGoal(goal_id="old", polygon_ned_m=corners, z_ned_m=-4.0, first_picture=7)
    for attempt, resume in ((1, rest), (2, None)):
        done = CoverageResult(completed=False, pos_uav_ned_m=(0.0, 0.0, -4.0), covered=0.5, resume=resume)
        goal_id = f"mission-1-1.1.{attempt}"
        ended = Result(goal_id=goal_id, t_ns=2, outcome="aborted", reason="wind", result=done)
        ((_, goal),) = flown.calls(FLYING, Response(f"{goal_id}/goal", ended))
        assert (goal.goal_id, goal.first_picture) == (f"mission-1-1.1.{attempt + 1}", 7)


def test_a_step_that_may_be_left_out_is_counted_and_named() -> None:
    flown = started(with_policy(then="skip"), STEP)
    ((tag, _),) = flown.end_goal(FLYING, "aborted", "too much wind")
    assert tag == "mission-1-1.2.1/goal"
    assert flown.progress.reason == "left out step 1, go: too much wind"
    flown.end_goal(FLYING)
    assert (flown.state, flown.progress.reason) == ("succeeded", "1 of 2 steps left out")
    assert flown.progress.left_out == 1
    flown = started(with_policy(then="skip"))
    flown.end_goal(FLYING, "aborted", "too much wind")
    assert (flown.state, flown.progress.reason) == ("succeeded", "1 of 1 steps left out")


@pytest.mark.parametrize(("then", "action"), [("land", "land_on_spot"), ("return", "return_home")])
@pytest.mark.parametrize("last_succeeds", [True, False])
def test_a_failed_mission_lands_or_returns_as_its_step_says(then: str, action: str, last_succeeds: bool) -> None:
    flown = started(with_policy(then=then), STEP)
    flown.step(FLYING, None, flown.result("mission-1-1.1.1", "aborted", "too much wind"))
    assert flown.progress.goal_id == "mission-1-1.end.1.1.1"
    assert flown.state == "running"
    assert flown.progress.reason == "step 1, go: too much wind"
    flown.end_goal(FLYING, *(() if last_succeeds else ("aborted", "no place")))
    assert flown.state == "failed"
    added = "" if last_succeeds else f"; then {'land here' if then == 'land' else 'return home'}: no place"
    assert flown.progress.reason == f"step 1, go: too much wind{added}"
    assert flown.calls(FLYING) == []


@pytest.mark.parametrize("status", [None, replace(FLYING, odometry=None), LANDED], ids=["silent", "lost", "landed"])
def test_without_a_known_place_in_the_air_a_failed_mission_ends_where_it_is(status: Status | None) -> None:
    flown = started(with_policy(then="land"), STEP)
    assert flown.end_goal(status, "aborted", "too much wind") == []
    assert flown.state == "failed"


def test_a_mission_takes_off_with_a_takeoff_of_its_own_before_the_step_that_was_interrupted() -> None:
    record = MissionRecord(mission=Mission(name="m", steps=(STEP, STEP)), mission_id="m-1", state="interrupted")
    flown = Flown(replace(record, altitude_m=5.0))
    assert flown.command(LANDED, "resume").accepted
    ((tag, goal),) = flown.calls(LANDED)
    assert (tag, goal.altitude_m) == ("m-1.1.1.takeoff/goal", 5.0)
    ((tag, goal),) = flown.end_goal(FLYING)
    assert tag == "m-1.1.1/goal"
    assert goal.target_ned_m == (1.0, 0.0, -3.0)
    ((tag, _),) = flown.end_goal(FLYING)
    assert tag == "m-1.2.1/goal"


def test_a_takeoff_that_fails_is_no_step_that_is_done() -> None:
    record = MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1", state="interrupted")
    flown = Flown(replace(record, altitude_m=5.0))
    flown.command(LANDED, "resume")
    flown.step(LANDED)
    flown.end_goal(LANDED, "aborted", "the motors don't turn")
    assert (flown.state, flown.progress.step) == ("failed", 1)
    assert flown.command(LANDED, "resume").accepted
    ((name, goal),) = flown.goals(LANDED)
    assert (name, goal.altitude_m) == ("takeoff", 5.0)


@pytest.mark.parametrize("lands", [True, False])
def test_a_takeoff_that_succeeds_while_a_person_intervenes_is_flown_again_if_the_vehicle_lands(lands: bool) -> None:
    record = MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1", state="interrupted")
    flown = Flown(replace(record, altitude_m=5.0))
    flown.command(LANDED, "resume")
    assert [tag for tag, _ in flown.calls(LANDED)] == ["m-1.1.1.takeoff/goal"]
    high = replace(at_altitude(5.0), interventions=1)
    flown.step(high)
    flown.end_goal(high)
    assert flown.state == "interrupted"
    later = replace(LANDED, interventions=1) if lands else high
    assert flown.command(later, "resume").accepted
    assert [tag for tag, _ in flown.calls(later)] == [f"m-1.1.2{'.takeoff' if lands else ''}/goal"]


def test_a_mission_that_begins_on_the_ground_with_its_own_takeoff_takes_off_once() -> None:
    takeoff = GoalStep(label="up", action="takeoff", goal={"altitude_m": 7.0})
    record = MissionRecord(mission=Mission(name="m", steps=(takeoff,)), mission_id="m-1", state="interrupted")
    flown = Flown(replace(record, altitude_m=5.0))
    flown.command(LANDED, "resume")
    ((_, goal),) = flown.goals(LANDED)
    assert goal.altitude_m == 7.0


def test_no_step_begins_while_the_goal_of_another_client_is_in_charge() -> None:
    flown = started(STEP, STEP)
    assert flown.end_goal(in_charge("c-7", "area_coverage")) == []
    assert (flown.state, flown.progress.step) == ("interrupted", 2)
    assert flown.progress.reason == "the goal area coverage of another client is in charge"


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (HOVER_REQUESTED, "a hover, an abort or a kill was requested: hover requested"),
        (replace(FLYING, bridge_boot_id=2, text="new"), "the vehicle bridge was restarted: new"),
        (EXTERNAL, "POSCTL"),
        (replace(EXTERNAL, in_charge="failsafe", text="RTL"), "RTL"),
    ],
)
def test_a_person_or_a_failsafe_interrupts_the_mission_and_ends_its_goal(status: Status, reason: str) -> None:
    flown = started(STEP, STEP)
    assert canceled(flown.calls(status)) == ["mission-1-1.1.1"]
    assert (flown.state, flown.progress.reason) == ("interrupted", reason)
    flown.end_goal(status, "canceled", "canceled by a client")
    assert (flown.state, flown.progress.reason, flown.progress.step) == ("interrupted", reason, 1)
    assert flown.calls(status) == []
    later = replace(status, in_charge="hover")
    assert flown.command(later, "resume").accepted
    ((tag, _),) = flown.calls(later)
    assert tag == "mission-1-1.1.2/goal", "a goal with the id of the first would not be flown again"


def test_a_step_that_succeeds_while_a_person_intervenes_is_not_flown_again() -> None:
    flown = started(STEP, STEP)
    flown.step(HOVER_REQUESTED)
    flown.end_goal(HOVER_REQUESTED)
    assert (flown.state, flown.progress.step) == ("interrupted", 2)
    flown = started(STEP)
    flown.step(HOVER_REQUESTED)
    flown.end_goal(HOVER_REQUESTED)
    assert flown.state == "succeeded"


def test_a_goal_that_another_client_cancels_interrupts_the_mission() -> None:
    flown = started(STEP)
    flown.end_goal(FLYING, "canceled", "canceled by a client")
    assert (flown.state, flown.progress.reason) == ("interrupted", "go: canceled by a client")


def test_a_mission_that_has_ended_is_not_interrupted() -> None:
    flown = started(STEP)
    flown.end_goal(FLYING)
    flown.step(HOVER_REQUESTED)
    flown.epoch_id = 2
    flown.step(EXTERNAL)
    assert flown.state == "succeeded"


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (EXTERNAL, "somebody else has control: POSCTL"),
        (replace(EXTERNAL, in_charge="failsafe", text="RTL"), "somebody else has control: RTL"),
    ],
)
def test_a_step_that_is_left_out_while_a_person_or_a_failsafe_flies_does_not_begin_the_next(
    status: Status, reason: str
) -> None:
    flown = started(STEP, STEP)
    flown.step(status)
    assert flown.command(status, "skip").accepted
    calls = flown.end_goal(status, "canceled", "canceled by a client")
    assert [tag for tag, _ in calls if tag.endswith("/goal")] == []
    assert (flown.state, flown.progress.step, flown.progress.reason) == ("interrupted", 2, reason)


@pytest.mark.parametrize(("command", "state", "step"), [("stop", "stopped", 1), ("skip", "interrupted", 2)])
def test_a_command_whose_goal_is_lost_with_its_vehicle_is_carried_out(command: str, state: str, step: int) -> None:
    flown = Flown()
    flown.epoch_id = 1
    assert flown.ask(FLYING, Mission(name="m", steps=(STEP, STEP))).accepted
    flown.step(FLYING)
    assert flown.command(FLYING, command).accepted
    flown.epoch_id = 2
    flown.step(LANDED)
    assert (flown.state, flown.progress.step) == (state, step)
    assert flown.command(LANDED, "resume").accepted is (command == "skip")


def test_a_wait_that_is_interrupted_or_paused_goes_on_with_its_rest() -> None:
    flown = started(WAIT, STEP)
    for _ in range(3):
        flown.step(FLYING)
    assert flown.command(FLYING, "pause").accepted
    for _ in range(20):
        flown.step(FLYING)
    assert flown.state == "paused"
    assert flown.command(FLYING, "resume").accepted
    flown.step(FLYING)
    flown.step(HOVER_REQUESTED)
    assert flown.state == "interrupted"
    assert flown.command(HOVER_REQUESTED, "resume").accepted
    left_s = 0
    while not flown.calls(HOVER_REQUESTED):
        left_s += 1
        assert left_s < 10
    assert left_s == 10 - 4 - 1, "four seconds have passed before the pause, and one after it"


def waiting_on_the_ground() -> Flown:
    """A mission that has landed and waits for its next step."""
    flown = started(LAND, WAIT, STEP, status=at_altitude(6.0))
    flown.end_goal(LANDED)
    flown.step(LANDED)
    assert flown.progress.label == "look around"
    return flown


def test_a_wait_on_the_ground_that_is_interrupted_goes_on_without_a_takeoff() -> None:
    flown = waiting_on_the_ground()
    aborted = replace(LANDED, interventions=1, text="no goal was in charge")
    flown.step(aborted)
    assert flown.state == "interrupted"
    assert flown.command(aborted, "resume").accepted
    assert flown.goals(aborted) == []
    assert (flown.state, flown.progress.label) == ("running", "look around")


def test_a_wait_on_the_ground_goes_on_without_a_takeoff_after_a_restart_of_the_service() -> None:
    flown = Flown(waiting_on_the_ground().records[-1])
    assert flown.command(LANDED, "resume").accepted
    assert flown.goals(LANDED) == []
    assert (flown.state, flown.progress.label) == ("running", "look around")


def test_a_restarted_vehicle_interrupts_the_mission_and_ids_differ_from_those_before() -> None:
    flown = Flown()
    flown.epoch_id = 5
    assert flown.ask(FLYING, Mission(name="m", steps=(STEP,))).accepted
    flown.step(FLYING)
    flown.step(FLYING)
    assert flown.state == "running"
    flown.epoch_id = 6
    flown.step(FLYING)
    assert (flown.state, flown.progress.reason) == ("interrupted", "the vehicle was restarted")
    assert flown.progress.goal_id == ""
    assert flown.command(FLYING, "resume").accepted
    ((tag, _),) = flown.calls(FLYING)
    assert tag == "mission-1-1.1.2/goal"


def pausing() -> Flown:
    """A mission whose goal was asked for a pause."""
    flown = started(STEP, STEP)
    ((tag, _),) = flown.calls(FLYING, request=MissionCommand(command="pause"))
    assert tag == "mission-1-1.1.1/pause"
    assert flown.state == "running"
    return flown


@pytest.mark.parametrize(
    ("response", "refusal"),
    [
        (Response("mission-1-1.1.1/pause", PauseReply(paused=True)), ""),
        (Response("mission-1-1.1.1/pause", PauseReply(paused=False, reason="it touches down")), "it touches down"),
        (Response("mission-1-1.1.1/pause", None, "timeout"), "go_to did not reply (timeout)"),
        (Flown.result("mission-1-1.1.1", "succeeded"), "the step has ended"),
    ],
)
def test_a_pause_is_accepted_when_the_goal_pauses_and_refused_with_its_reason(response: Response, refusal: str) -> None:
    flown = pausing()
    (reply,) = flown.replies(FLYING, None, response)
    assert (reply.accepted, reply.reason, reply.mission_id) == (not refusal, refusal, "mission-1-1")
    assert flown.state == ("running" if refusal else "paused")


def test_a_pause_whose_reply_comes_after_an_intervention_is_refused_and_the_mission_stays_interrupted() -> None:
    flown = pausing()
    response = Response("mission-1-1.1.1/pause", PauseReply(paused=True))
    (reply,) = flown.replies(HOVER_REQUESTED, None, response)
    assert (reply.accepted, reply.reason) == (
        False,
        "the mission is interrupted: a hover, an abort or a kill was requested: hover requested",
    )
    assert flown.state == "interrupted"


def test_two_pauses_of_the_same_goal_are_both_accepted() -> None:
    flown = pausing()
    flown.step(FLYING, MissionCommand(command="pause"))
    replies = flown.replies(FLYING, None, Response("mission-1-1.1.1/pause", PauseReply(paused=True)))
    assert [reply.accepted for reply in replies] == [True, True]


def test_a_paused_goal_goes_on_by_command() -> None:
    flown = pausing()
    flown.step(FLYING, None, Response("mission-1-1.1.1/pause", PauseReply(paused=True)))
    refusal = flown.command(FLYING, "pause")
    assert (refusal.accepted, refusal.reason) == (False, "the mission is paused already")
    assert not flown.command(FLYING, "swapped").accepted
    resumed = [payload for _, payload in flown.calls(FLYING, request=MissionCommand(command="resume"))]
    assert any(isinstance(payload, Resume) for payload in resumed)
    assert flown.state == "running"
    refusal = flown.command(FLYING, "resume")
    assert (refusal.accepted, refusal.reason) == (False, "the mission is running")


def resumes(calls: list[tuple[str, Any]]) -> list[str]:
    return [tag for tag, payload in calls if isinstance(payload, Resume)]


def test_a_resume_that_was_lost_on_its_way_is_sent_again_until_the_server_replies() -> None:
    flown = pausing()
    flown.step(FLYING, None, Response("mission-1-1.1.1/pause", PauseReply(paused=True)))
    (tag,) = resumes(flown.calls(FLYING, request=MissionCommand(command="resume")))
    for _ in range(3):
        assert resumes(flown.calls(FLYING, Response(tag, None, "timeout"))) == [tag]
        assert resumes(flown.calls(FLYING)) == []
    assert resumes(flown.calls(FLYING, Response(tag, ResumeReply(resumed=True)))) == []


def test_a_resume_that_was_lost_is_not_sent_again_after_the_next_pause() -> None:
    flown = pausing()
    flown.step(FLYING, None, Response("mission-1-1.1.1/pause", PauseReply(paused=True)))
    (tag,) = resumes(flown.calls(FLYING, request=MissionCommand(command="resume")))
    flown.step(FLYING, MissionCommand(command="pause"))
    assert resumes(flown.calls(FLYING, Response(tag, None, "timeout"))) == []


@pytest.mark.parametrize(
    ("policy", "outcome", "step", "attempt"),
    [({}, "succeeded", 2, 1), ({"retries": 1}, "aborted", 1, 2), ({"then": "skip"}, "aborted", 2, 1)],
)
def test_a_mission_that_was_paused_begins_nothing_when_its_goal_ends_in_the_pause(
    policy: dict[str, Any], outcome: str, step: int, attempt: int
) -> None:
    flown = started(with_policy(**policy), STEP)
    flown.calls(FLYING, request=MissionCommand(command="pause"))
    flown.step(FLYING, None, Response("mission-1-1.1.1/pause", PauseReply(paused=True)))
    assert flown.end_goal(FLYING, outcome, "wind") == []
    assert flown.calls(FLYING) == []
    assert (flown.state, flown.progress.reason) == ("paused", "paused by a command")
    assert (flown.progress.step, flown.progress.attempt) == (step, attempt)
    assert flown.command(FLYING, "resume").accepted
    assert [name for name, _ in flown.goals(FLYING)] == ["go_to"]


@pytest.mark.parametrize(("command", "state", "step"), [("skip", "running", 2), ("stop", "stopped", 1)])
def test_the_step_that_flies_is_left_out_or_the_mission_stopped_once_its_goal_has_ended(
    command: Any, state: str, step: int
) -> None:
    flown = started(STEP, STEP)
    assert canceled(flown.calls(FLYING, request=MissionCommand(command=command))) == ["mission-1-1.1.1"]
    assert flown.state == "running"
    flown.end_goal(FLYING, "canceled", "canceled by a client")
    assert (flown.state, flown.progress.step) == (state, step)


@pytest.mark.parametrize(("command", "state", "step"), [("skip", "running", 2), ("stop", "stopped", 1)])
def test_a_wait_ends_at_once_by_command(command: Any, state: str, step: int) -> None:
    flown = started(WAIT, WAIT)
    assert flown.command(FLYING, command).accepted
    flown.step(FLYING)
    assert (flown.state, flown.progress.step) == (state, step)


def test_a_stop_is_not_overtaken_by_a_skip_or_an_intervention() -> None:
    flown = started(STEP, STEP)
    flown.command(FLYING, "stop")
    refusal = flown.command(FLYING, "skip")
    assert (refusal.accepted, refusal.reason[:46]) == (False, "the goal of the present step is still ending: ")
    flown.step(HOVER_REQUESTED)
    flown.end_goal(HOVER_REQUESTED, "canceled")
    assert flown.state == "stopped"


@pytest.mark.parametrize("seen_at_once", [False, True])
def test_a_hover_after_a_skip_interrupts_the_mission_behind_the_step_that_is_left_out(seen_at_once: bool) -> None:
    flown = started(STEP, STEP)
    assert flown.command(FLYING, "skip").accepted
    if not seen_at_once:
        flown.step(FLYING)
    flown.step(HOVER_REQUESTED)
    assert flown.end_goal(HOVER_REQUESTED, "canceled") == []
    assert (flown.state, flown.progress.step, flown.progress.left_out) == ("interrupted", 2, 1)
    assert flown.progress.reason == "a hover, an abort or a kill was requested: hover requested"
    assert flown.command(HOVER_REQUESTED, "resume").accepted
    assert [tag for tag, _ in flown.calls(HOVER_REQUESTED)] == ["mission-1-1.2.1/goal"]


@pytest.mark.parametrize("command", ["resume", "skip"])
def test_a_hover_right_after_a_mission_goes_on_interrupts_it_again(command: str) -> None:
    flown = started(STEP, STEP)
    flown.step(HOVER_REQUESTED)
    flown.end_goal(HOVER_REQUESTED, "canceled")
    assert flown.command(HOVER_REQUESTED, command).accepted
    assert flown.calls(replace(HOVER_REQUESTED, interventions=2)) == []
    assert flown.state == "interrupted"


def test_a_hover_right_after_a_mission_was_accepted_interrupts_it_before_it_flies() -> None:
    flown = Flown()
    assert flown.ask(FLYING, Mission(name="survey", steps=(STEP,))).accepted
    assert flown.calls(HOVER_REQUESTED) == []
    assert flown.state == "interrupted"


def test_a_skip_of_the_last_step_ends_the_mission_though_somebody_intervenes() -> None:
    flown = started(STEP)
    flown.command(FLYING, "skip")
    flown.step(HOVER_REQUESTED)
    flown.end_goal(HOVER_REQUESTED, "canceled")
    assert flown.state == "succeeded"


def test_an_interrupted_mission_goes_on_only_after_its_goal_has_ended() -> None:
    flown = started(STEP, STEP)
    flown.step(HOVER_REQUESTED)
    refusal = flown.command(HOVER_REQUESTED, "resume")
    assert (refusal.accepted, refusal.reason[:46]) == (False, "the goal of the present step is still ending: ")
    flown.end_goal(HOVER_REQUESTED, "canceled")
    assert flown.command(HOVER_REQUESTED, "resume").accepted


@pytest.mark.parametrize(("command", "tag"), [("resume", "mission-1-1.1.2/goal"), ("skip", "mission-1-1.2.1/goal")])
def test_a_failed_mission_is_tried_again_from_the_step_that_failed_or_behind_it(command: str, tag: str) -> None:
    flown = started(STEP, STEP)
    flown.end_goal(FLYING, "aborted", "wind")
    for refused in ("pause", "swapped", "stop"):
        assert not flown.command(HOVER_REQUESTED, refused).accepted
    assert flown.command(HOVER_REQUESTED, command).accepted
    assert [tag for tag, _ in flown.calls(HOVER_REQUESTED)] == [tag]
    assert flown.progress.left_out == (command == "skip")


def test_a_failed_mission_is_tried_again_with_a_vehicle_that_was_restarted_since() -> None:
    flown = started(STEP)
    flown.epoch_id = 1
    flown.step(FLYING)
    flown.end_goal(FLYING, "aborted", "wind")
    flown.restart_vehicle()
    flown.step(FLYING)
    assert (flown.state, flown.progress.reason) == ("failed", "wind")
    assert flown.command(FLYING, "resume").accepted
    assert [name for name, _ in flown.goals(FLYING)] == ["go_to"]
    flown.step(FLYING)
    assert flown.state == "running"
    flown.restart_vehicle()
    flown.step(FLYING)
    assert (flown.state, flown.progress.reason) == ("interrupted", "the vehicle was restarted")


def test_no_goal_of_a_mission_that_is_tried_again_has_the_id_of_an_earlier_one_whose_result_its_server_still_has() -> (
    None
):
    flown = started(with_policy(retries=1, then="return"), with_policy(then="return"))
    goal_ids: list[str] = []

    def end(*outcome: str) -> None:
        goal_ids.append(flown.progress.goal_id)
        flown.end_goal(FLYING, *outcome)

    for _ in range(2):
        end("aborted", "wind")
        end("aborted", "wind")
        assert flown.progress.label == "return home"
        end()
        assert flown.command(FLYING, "resume").accepted
        flown.step(FLYING)
        assert (flown.progress.step, flown.progress.label) == (1, "go")
    end()
    end("aborted", "wind")
    assert (flown.progress.step, flown.progress.label) == (2, "return home")
    end()
    assert len(goal_ids) == len(set(goal_ids)) == 9


def test_a_failed_mission_whose_vehicle_has_landed_takes_off_to_the_altitude_of_the_step_first() -> None:
    flown = started(with_policy(then="land"), status=at_altitude(6.0))
    flown.end_goal(at_altitude(6.0), "aborted", "wind")
    flown.end_goal(LANDED)
    assert flown.command(LANDED, "resume").accepted
    ((name, goal),) = flown.goals(LANDED)
    assert (name, goal.altitude_m) == ("takeoff", 6.0)


def test_commands_without_a_mission_and_a_second_mission_are_refused() -> None:
    flown = Flown()
    for command in ("pause", "resume", "skip", "stop", "swapped"):
        reply = flown.command(FLYING, command)
        assert (reply.accepted, reply.mission_id) == (False, "")
        assert "send one with jezero mission run FILE" in reply.reason
    assert flown.health == "no mission"
    flown = started(STEP)
    reply = flown.ask(FLYING, Mission(name="second", steps=(STEP,)))
    assert (reply.accepted, reply.reason) == (
        False,
        "the mission 'survey' is running: end it first (jezero mission stop)",
    )


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (replace(STEP, action="go_too"), "step 2: "),
        (replace(STEP, goal={}), "step 2, go: go_to: "),
        (replace(STEP, goal={"target_ned_m": [1.0, 0.0, "up"]}), "step 2, go: go_to: "),
    ],
)
def test_a_mission_with_a_step_that_is_no_goal_is_refused_before_it_flies(step: GoalStep, reason: str) -> None:
    flown = Flown()
    reply = flown.ask(FLYING, Mission(name="m", steps=(WAIT, step)))
    assert not reply.accepted
    assert reply.reason.startswith(reason)
    assert flown.calls(FLYING) == []


@pytest.mark.parametrize(
    ("before", "after"),
    [("running", "interrupted"), ("paused", "interrupted"), ("failed", "failed"), ("succeeded", "succeeded")],
)
def test_a_restarted_service_flies_nothing_before_a_command(before: Any, after: str) -> None:
    flown = Flown(MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1", state=before))
    assert flown.calls(FLYING) == []
    assert flown.state == after
    assert flown.progress.reason == ("the mission service was restarted" if after == "interrupted" else "")


@pytest.mark.parametrize(
    ("status", "ended"),
    [
        (None, ["m-1.1.1"]),
        (in_charge("m-1.1.1"), ["m-1.1.1"]),
        (in_charge("m-1.1.1.takeoff", "takeoff"), ["m-1.1.1.takeoff"]),
        (in_charge("c-7"), []),
        (in_charge("m-10.1.1"), []),
        (FLYING, []),
    ],
    ids=["unknown", "the step", "its takeoff", "another client", "another mission", "hover"],
)
def test_a_stop_after_a_restart_of_the_service_ends_the_missions_goal_if_it_still_flies(
    status: Status | None, ended: list[str]
) -> None:
    flown = Flown(MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1"))
    flown.step(status)
    assert canceled(flown.calls(status, request=MissionCommand(command="stop"))) == ended
    assert flown.state == ("interrupted" if ended else "stopped")


def test_a_goal_that_was_paused_before_a_restart_of_the_service_goes_on_by_command() -> None:
    record = MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1", state="paused")
    flown = Flown(record)
    paused = replace(in_charge("m-1.1.1"), paused=True)
    assert flown.command(paused, "resume").accepted
    calls = flown.calls(paused)
    assert [tag for tag, _ in calls if tag.endswith("/goal")] == ["m-1.1.1/goal"]
    assert resumes(calls) == ["m-1.1.1/resume"]
    assert resumes(flown.calls(in_charge("m-1.1.1"))) == []


def test_a_goal_that_flies_on_since_a_restart_of_the_service_and_was_not_paused_gets_no_resume() -> None:
    flown = Flown(MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1"))
    assert flown.command(in_charge("m-1.1.1"), "resume").accepted
    calls = flown.calls(in_charge("m-1.1.1"))
    assert [tag for tag, _ in calls if tag.endswith("/goal")] == ["m-1.1.1/goal"]
    assert resumes(calls) == []


def test_a_takeoff_that_flies_on_since_a_restart_of_the_service_ends_before_the_step_begins() -> None:
    record = MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1", altitude_m=5.0)
    flown, climbing = Flown(record), in_charge("m-1.1.1.takeoff", "takeoff")
    assert flown.command(climbing, "resume").accepted
    assert not any(tag.endswith("/goal") for tag, _ in flown.calls(climbing))
    assert flown.progress.goal_id == "m-1.1.1.takeoff"
    done = a_result("succeeded")
    text = msgspec.json.encode(replace(done, goal_id="m-1.1.1.takeoff")).decode()
    reply = ResultReply(goal_id="m-1.1.1.takeoff", action="takeoff", running=False, result=text)
    calls = flown.calls(FLYING, Response("m-1.1.1.takeoff/result", reply))
    assert [tag for tag, _ in calls if tag.endswith("/goal")] == ["m-1.1.1/goal"]


def test_a_mission_of_a_stack_that_was_restarted_takes_off_to_the_altitude_of_its_step() -> None:
    record = MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1", step_altitude_m=8.0)
    flown = Flown(record)
    assert flown.command(LANDED, "resume").accepted
    ((name, goal),) = flown.goals(LANDED)
    assert (name, goal.altitude_m) == ("takeoff", 8.0)
    flown = Flown(replace(record, altitude_m=3.0))
    assert flown.command(LANDED, "resume").accepted
    ((_, goal),) = flown.goals(LANDED)
    assert goal.altitude_m == 3.0
    flown = Flown(record)
    assert flown.command(FLYING, "resume").accepted
    assert [name for name, _ in flown.goals(FLYING)] == ["go_to"]


def test_after_a_restart_and_a_landing_the_result_of_the_goal_that_flew_before_is_not_taken_for_that_of_the_next() -> (
    None
):
    record = MissionRecord(mission=Mission(name="m", steps=(STEP,)), mission_id="m-1", step_altitude_m=8.0)
    flown = Flown(record)
    assert flown.command(LANDED, "resume").accepted
    assert [tag for tag, _ in flown.calls(LANDED)] == ["m-1.1.2.takeoff/goal"]
    assert [tag for tag, _ in flown.end_goal(FLYING)] == ["m-1.1.2/goal"]
    flown = Flown(record)
    assert flown.command(FLYING, "resume").accepted
    assert [tag for tag, _ in flown.calls(FLYING)] == ["m-1.1.1/goal"], "it may still fly"
    flown, stands = Flown(record), replace(LANDED, armed=True)
    assert flown.command(stands, "resume").accepted
    assert [tag for tag, _ in flown.calls(stands)] == ["m-1.1.1/goal"], "it may take off just now"


def test_a_reason_is_no_longer_than_a_message_holds() -> None:
    reason = "x" * 2000
    flown = started(with_policy(then="land"), STEP)
    flown.end_goal(FLYING, "aborted", reason)
    assert flown.progress.reason.startswith("step 1, go: xxx")
    assert decode(MissionProgress, encode(flown.progress)) == flown.progress
    flown = pausing()
    paused = Response("mission-1-1.1.1/pause", PauseReply(paused=True))
    (reply,) = flown.replies(replace(HOVER_REQUESTED, text=reason), None, paused)
    assert reply.reason.startswith("the mission is interrupted: ")
    assert decode(MissionReply, encode(reply)) == reply


def test_a_mission_is_kept_at_its_changes_alone() -> None:
    flown = Flown()
    flown.step(FLYING)
    assert flown.records == []
    assert flown.ask(FLYING, Mission(name="m", steps=(STEP,))).accepted
    flown.step(FLYING)
    count = len(flown.records)
    for _ in range(10):
        flown.step(FLYING)
    assert len(flown.records) == count
    flown.end_goal(FLYING)
    assert (len(flown.records), flown.records[-1].state) == (count + 1, "succeeded")


def test_progress_is_published_twice_a_second_and_at_each_change() -> None:
    flown = Flown()
    for _ in range(40):
        flown.step(FLYING, seconds=0.1)
    assert flown.published == 8
    flown.step(FLYING, Mission(name="m", steps=(STEP,)), seconds=0.1)
    assert flown.published == 9


def test_progress_is_published_as_often_after_the_vehicles_time_has_begun_anew() -> None:
    flown = Flown()
    flown.step(FLYING, seconds=1000.0)
    flown.restart_vehicle()
    before = flown.published
    for _ in range(40):
        flown.step(LANDED, seconds=0.1)
    assert flown.published - before == 8
