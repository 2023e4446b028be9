"""When the vehicle turns home by itself, how it does, and who may end that."""

from collections.abc import Sequence
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.runtime.service import Call, Output, Response
from jezero.schemas.actions import Cancel, PlanReply
from jezero.schemas.commands import Abort, AbortReply
from jezero.schemas.goals import ReturnHomeGoal
from jezero.schemas.mission import Mission, MissionCommand
from jezero.schemas.state import Battery, Status
from jezero.schemas.topics import ACTIONS, health_of
from jezero.services.mission.config import MissionConfig
from jezero.services.mission.rules import last_goal
from jezero.services.mission.service import MissionService
from tests.services.mission.rig import FLYING, LANDED, STEP, Flown

RALLY = ((20.0, -15.0), (5.0, 5.0))


def charged(status: Status, charge: float | None) -> Status:
    return replace(status, battery=Battery(voltage_v=15.0, remaining=charge))


LOW = charged(FLYING, 0.15)
EXTERNAL_LOW = replace(LOW, in_charge="external", text="POSCTL")
IN_CHARGE = replace(LOW, in_charge="goal", goal_id="c-1", action="go_to", code=8, name="GO_TO")


def returns(calls: Sequence[tuple[str, Any]]) -> list[tuple[str, ReturnHomeGoal]]:
    """Returns that are to be flown, and not only planned."""
    return [(tag, goal) for tag, goal in calls if isinstance(goal, ReturnHomeGoal) and not tag.startswith("way home/")]


def plans(outputs: Sequence[Output]) -> dict[str, ReturnHomeGoal]:
    """Plans of the way home that are asked for, by the tags of their calls."""
    return {
        output.tag: output.payload
        for output in outputs
        if isinstance(output, Call) and isinstance(output.payload, ReturnHomeGoal) and "way home/" in output.tag
    }


def aborts(calls: Sequence[tuple[str, Any]]) -> list[Abort]:
    return [request for _, request in calls if isinstance(request, Abort)]


def comes_home(flown: Flown, status: Status, duration_s: float, battery_used: float | None = None) -> bool:
    """Whether the vehicle returns within some seconds, when the way home is planned to take so long."""
    returned = False
    reply = PlanReply(accepted=True, duration_s=duration_s, battery_used=battery_used)
    responses: list[Response] = []
    for _ in range(4):
        outputs = flown.step(status, None, *responses)
        responses = [Response(tag, reply) for tag in plans(outputs)]
        returned |= bool(returns([(output.tag, output.payload) for output in outputs if isinstance(output, Call)]))
    return returned


def returning(status: Status = LOW) -> Flown:
    """A service that has just decided to return from a mission: its battery is enough for the way home alone."""
    flown = Flown()
    assert flown.ask(FLYING, Mission(name="m", steps=(STEP, STEP), rally_points_ned_m=RALLY)).accepted
    (tag,) = plans(flown.step(FLYING))
    canceled = flown.result("mission-1-1.1.1", "canceled")
    flown.step(status, None, Response(tag, PlanReply(accepted=True, duration_s=900.0)), canceled)
    assert flown.state == "interrupted"
    return flown


def test_the_goal_in_charge_is_ended_every_two_seconds_until_the_vehicle_hovers_and_returns() -> None:
    flown = returning(IN_CHARGE)
    requests = [abort for _ in range(8) for abort in aborts(flown.calls(IN_CHARGE))]
    assert len(requests) == 4
    assert requests[0].reason.startswith("the battery has 15%, the way home needs ")
    ((tag, goal),) = returns(flown.calls(LOW))
    assert tag == "return-1-1.1/goal"
    assert goal.rally_points_ned_m == RALLY
    assert goal.charge == pytest.approx(0.15, abs=0.01)
    assert flown.health.startswith("m: interrupted; the battery has 15%")


@pytest.mark.parametrize("reply", [Response("return-1-1/abort", AbortReply(hovering=True)), None])
def test_an_abort_that_the_bridge_carries_out_late_is_no_person_who_ends_the_return(reply: Response | None) -> None:
    """The goal in charge ends by itself while the request to abort it is still on its way."""
    flown = returning(IN_CHARGE)
    assert aborts(flown.calls(IN_CHARGE))
    assert returns([(o.tag, o.payload) for o in flown.step(LOW, seconds=0.2) if isinstance(o, Call)]) == []
    aborted = replace(LOW, interventions=1, text="no goal was in charge, the vehicle hovers")
    responses = () if reply is None else (reply,)
    outputs = flown.step(aborted, None, *responses, seconds=0.2)
    outputs += flown.step(aborted, seconds=0.2 if reply is not None else 0.8)
    assert len(returns([(o.tag, o.payload) for o in outputs if isinstance(o, Call)])) == 1
    flown.step(aborted)
    assert "the return has ended" not in flown.progress.reason


def test_a_return_that_fails_is_tried_three_times_five_seconds_apart_and_then_left_to_people() -> None:
    flown = returning()
    for attempt in (1, 2, 3):
        ((tag, _),) = returns(flown.calls(LOW))
        assert tag == f"return-1-1.{attempt}/goal"
        flown.step(LOW, None, flown.result(f"return-1-1.{attempt}", "aborted", "no place"))
        for _ in range(3 if attempt < 3 else 0):
            assert returns(flown.calls(LOW)) == []
    assert not any(returns(flown.calls(LOW)) for _ in range(10)), "a person has the vehicle until it lands"
    assert flown.progress.reason.endswith("; the return has ended: no place")


def test_a_server_that_is_restarted_when_the_vehicle_must_return_flies_it_home() -> None:
    flown = returning()
    tags: list[str] = []
    for step in range(70):
        silent = [Response(tag, None, "no server") for tag in tags[-1:] if step < 30]
        outputs = flown.step(LOW, None, *silent, seconds=0.1)
        tags += [tag for tag, _ in returns([(o.tag, o.payload) for o in outputs if isinstance(o, Call)])]
    assert tags == ["return-1-1.1/goal", "return-1-1.2/goal"]
    assert "the return has ended" not in flown.progress.reason


@pytest.mark.parametrize("status", [replace(LOW, interventions=1, text="hover requested"), EXTERNAL_LOW])
def test_a_person_who_takes_control_between_two_tries_of_the_return_ends_it(status: Status) -> None:
    flown = returning()
    flown.step(LOW)
    flown.step(LOW, None, flown.result("return-1-1.1", "aborted", "no place"))
    assert not any(returns(flown.calls(status)) for _ in range(10))
    assert flown.progress.reason.endswith(status.text)


def test_a_return_that_lands_says_so_and_the_mission_waits() -> None:
    flown = returning()
    flown.calls(LOW)
    flown.step(LANDED, None, flown.result("return-1-1.1", "succeeded"))
    assert flown.progress.reason.endswith("; it has landed")
    assert flown.command(LANDED, "swapped").accepted


@pytest.mark.parametrize(
    "status",
    [
        replace(LOW, in_charge="external", text="POSCTL"),
        replace(LOW, in_charge="failsafe", text="RTL"),
        replace(LOW, interventions=1, text="hover requested"),
        replace(LOW, bridge_boot_id=2, text="new bridge"),
    ],
)
def test_a_person_or_a_failsafe_ends_the_return_until_the_next_flight(status: Status) -> None:
    flown = returning()
    assert returns(flown.calls(LOW))
    flown.step(status)
    assert "; the return has ended: " in flown.progress.reason
    assert flown.progress.reason.endswith(status.text)
    assert not comes_home(flown, replace(status, in_charge="hover"), 900.0)
    flown.step(LANDED)
    assert comes_home(flown, LOW, 900.0)


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (LANDED, "the vehicle has landed"),
        (replace(LOW, armed=False), "the vehicle has landed"),
        (replace(LOW, in_charge="external", text="POSCTL"), "somebody else has control: POSCTL"),
    ],
)
def test_a_return_that_is_not_possible_any_more_is_not_flown(status: Status, reason: str) -> None:
    flown = returning(IN_CHARGE)
    flown.calls(IN_CHARGE)
    assert returns(flown.calls(status)) == []
    assert flown.progress.reason.endswith(f"; the return has ended: {reason}")


def test_a_mission_whose_vehicle_must_return_gives_its_goal_up_and_waits_with_the_reason() -> None:
    flown = Flown()
    assert flown.ask(FLYING, Mission(name="m", steps=(STEP, STEP))).accepted
    flying = replace(FLYING, in_charge="goal", goal_id="mission-1-1.1.1", action="go_to")
    (tag,) = plans(flown.step(FLYING))
    plan = Response(tag, PlanReply(accepted=True, duration_s=900.0))
    outputs = flown.step(charged(flying, 0.15), None, plan)
    canceled = {o.payload.goal_id for o in outputs if isinstance(o, Call) and isinstance(o.payload, Cancel)}
    assert canceled == {"mission-1-1.1.1"}
    assert flown.state == "interrupted"
    assert flown.progress.reason.startswith("the battery has 15%, the way home needs ")
    flown.end_goal(LOW, "canceled", "canceled by a client")
    assert (flown.state, flown.progress.step) == ("interrupted", 1)
    assert flown.progress.reason.startswith("the battery has 15%, the way home needs ")


def test_a_mission_that_has_ended_is_not_revived_by_a_return() -> None:
    flown = Flown()
    assert flown.ask(FLYING, Mission(name="m", steps=(STEP,))).accepted
    flown.step(FLYING)
    flown.end_goal(FLYING)
    assert flown.state == "succeeded"
    assert comes_home(flown, LOW, 900.0)
    assert (flown.state, flown.progress.reason) == ("succeeded", "")
    flown.step(LANDED, None, flown.result("return-1-1.1", "succeeded"))
    assert (flown.state, flown.progress.reason) == ("succeeded", "")


@pytest.mark.parametrize("command", ["pause", "resume", "skip", "swapped"])
def test_while_the_vehicle_returns_nothing_but_an_end_of_the_mission_is_accepted(command: Any) -> None:
    flown = returning()
    reply = flown.ask(LOW, MissionCommand(command=command))
    assert not reply.accepted
    assert "wait until it has landed, or end the return with jezero hover" in reply.reason
    assert flown.records[-1].state == "interrupted"
    reply = flown.ask(LOW, Mission(name="m", steps=(STEP,)))
    assert not reply.accepted
    assert "wait until it has landed" in reply.reason
    assert flown.ask(LOW, MissionCommand(command="stop")).accepted
    flown.step(LOW, None, flown.result("return-1-1.1", "succeeded"))
    assert flown.state == "stopped"


@pytest.mark.parametrize(
    ("charge", "duration_s", "battery_used", "text"),
    [
        # Declared use: 15.5 A of 5 Ah, 0.086 % a second. Needed: 1.3 times the way, and a reserve of 10 %.
        (0.25, 100.0, None, ""),  # 21.2 %
        (0.22, 100.0, None, ""),
        (0.21, 100.0, None, "the battery has 21%, the way home needs 21%: the vehicle returns"),
        (0.18, 100.0, None, "the battery has 18%, the way home needs 21%: the vehicle returns, but less than 10% may"),
        (0.35, 100.0, 0.2, "the battery has 35%, the way home needs 36%: the vehicle returns"),  # against the wind
        (0.37, 100.0, 0.2, ""),
        (None, 1000.0, None, ""),
    ],
)
def test_the_vehicle_turns_home_while_its_battery_holds_the_way_and_the_reserve(
    charge: float | None, duration_s: float, battery_used: float | None, text: str
) -> None:
    flown = Flown()
    status = charged(FLYING, charge)
    assert comes_home(flown, status, duration_s, battery_used) is bool(text)
    assert text in flown.health
    assert flown.health.endswith("may be left") is ("less than" in text)


@pytest.mark.parametrize("action", ["return_home", "land_on_spot"])
def test_a_vehicle_that_lands_or_comes_home_is_left_alone(action: str) -> None:
    flown = Flown()
    assert not comes_home(flown, replace(LOW, action=action), 900.0)
    assert not aborts(flown.calls(replace(IN_CHARGE, action=action)))


@pytest.mark.parametrize(
    "status",
    [
        EXTERNAL_LOW,
        replace(LOW, in_charge="failsafe", text="RTL"),
        replace(IN_CHARGE, landed=True),
        replace(IN_CHARGE, armed=False),
    ],
    ids=["a person flies", "a failsafe flies", "landed", "motors off"],
)
def test_a_vehicle_that_somebody_else_flies_or_that_does_not_fly_is_left_alone_and_comes_home_after_that(
    status: Status,
) -> None:
    flown = Flown()
    assert not comes_home(flown, charged(FLYING, 0.95), 600.0), "the battery holds the way"
    assert not comes_home(flown, status, 600.0)
    assert not any(aborts(flown.calls(status)) for _ in range(3))
    assert comes_home(flown, LOW, 600.0)


def test_a_plan_of_the_way_home_that_is_refused_leaves_the_last_one_in_force() -> None:
    flown = Flown()
    assert not comes_home(flown, charged(FLYING, 0.9), 100.0)
    for _ in range(3):
        (tag,) = plans(flown.step(charged(FLYING, 0.9)))
        flown.step(charged(FLYING, 0.9), None, Response(tag, PlanReply(accepted=False, reason="no place")), seconds=0.2)
    assert flown.health == "no mission; the battery has 90%, the way home needs 21%"


def test_a_vehicle_without_a_known_position_is_not_planned_for_and_its_last_plan_counts() -> None:
    flown = Flown()
    lost = replace(LOW, odometry=None)
    assert not plans(flown.step(lost))
    (tag,) = plans(flown.step(charged(FLYING, 0.9)))
    flown.step(lost, None, Response(tag, PlanReply(accepted=True, duration_s=900.0)))
    assert returns(flown.calls(lost))


def test_a_vehicle_whose_battery_reports_nothing_flies_on() -> None:
    flown = Flown()
    assert not comes_home(flown, charged(FLYING, 0.9), 100.0)
    assert not comes_home(flown, charged(FLYING, None), 1000.0)
    assert not comes_home(flown, replace(FLYING, battery=None), 1000.0)


def test_the_way_home_is_planned_once_a_second_from_where_the_vehicle_flies_unless_switched_off() -> None:
    for config, count in ((MissionConfig(), 5), (MissionConfig(return_when_low=False), 0)):
        flown = Flown(config=config)
        goals = [goal for _ in range(50) for goal in plans(flown.step(FLYING, seconds=0.1)).values()]
        assert len(goals) == count
        assert all(goal.plan_from_ned_m == (1.0, 2.0, -2.0) for goal in goals)
        assert not plans(flown.step(LANDED))


def test_the_way_home_is_planned_also_after_the_vehicles_time_has_begun_anew() -> None:
    flown = Flown()
    flown.epoch_id = 1
    assert not comes_home(flown, charged(FLYING, 0.9), 100.0)
    flown.step(charged(FLYING, 0.9), seconds=1000.0)
    flown.restart_vehicle()
    flown.step(LANDED)
    assert comes_home(flown, LOW, 900.0)


def test_the_reply_to_an_older_plan_of_the_way_home_does_not_count() -> None:
    flown = Flown()
    flown.step(LOW)
    flown.step(LOW)
    flown.step(LOW, None, Response("way home/1", PlanReply(accepted=True, duration_s=900.0)))
    assert "way home needs" not in flown.health


def test_a_gauge_that_reports_more_than_can_be_left_is_named() -> None:
    flown = Flown()
    for _ in range(120):
        flown.step(charged(FLYING, 0.8))
    assert not comes_home(flown, charged(FLYING, 0.8), 100.0)
    assert "at most, though it reports 80%" in flown.health


@pytest.mark.parametrize(
    ("loss_s", "heard", "comes_home"), [(20.0, True, True), (20.0, False, False), (0.0, True, False)]
)
def test_a_ground_station_that_was_heard_in_this_flight_and_falls_silent_brings_the_vehicle_home(
    loss_s: float, heard: bool, comes_home: bool
) -> None:
    flown = Flown(config=MissionConfig(ground_loss_s=loss_s))
    flown.ground = heard
    for _ in range(5):
        assert returns(flown.calls(FLYING)) == []
    flown.ground = False
    for _ in range(19):
        assert returns(flown.calls(FLYING)) == []
    assert bool(any(returns(flown.calls(FLYING)) for _ in range(3))) is comes_home
    if comes_home:
        assert flown.health == "no mission; the ground station has been silent for 20 s: the vehicle returns"


@pytest.mark.parametrize("loss_s", [0.0, 20.0])
def test_the_service_listens_to_the_ground_station_when_it_must_miss_it(loss_s: float) -> None:
    service = MissionService(1, ACTIONS, config=MissionConfig(ground_loss_s=loss_s))
    assert (health_of("ground_station") in service.spec.inputs) is bool(loss_s)


def test_a_ground_station_that_was_heard_in_the_flight_before_is_not_missed() -> None:
    flown = Flown(config=MissionConfig(ground_loss_s=20.0))
    flown.ground = True
    flown.step(FLYING)
    flown.ground = False
    flown.step(LANDED)
    assert not any(returns(flown.calls(FLYING)) for _ in range(40))


def test_the_way_home_and_the_return_after_a_failed_step_have_the_missions_rally_points() -> None:
    flown = Flown()
    (before,) = plans(flown.step(FLYING, Mission(name="m", steps=(STEP,), rally_points_ned_m=RALLY))).values()
    (goal,) = plans(flown.step(FLYING)).values()
    assert (before.rally_points_ned_m, goal.rally_points_ned_m) == ((), RALLY)
    assert last_goal("return", FLYING, RALLY).goal == {"rally_points_ned_m": RALLY}
    assert last_goal("return", FLYING, ()).goal == {}
    assert "rally_points_ned_m" not in last_goal("land", FLYING, RALLY).goal
