"""What the mission service does with an interrupted mission, and what it refuses."""

from typing import Any

import pytest
from msgspec.structs import replace

from jezero.schemas.mission import GoalStep, Mission, MissionCommand
from jezero.schemas.state import Battery, Status
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.rules import swap_refusal
from tests.services.mission.rig import FLYING, LANDED, STEP, Flown, at_altitude

LAND = GoalStep(label="land", action="land_on_spot", goal={})
MISSION = Mission(name="test", steps=(STEP, STEP))


@pytest.mark.parametrize(
    ("altitude_m", "takeoff_m"), [(1.0, 2.0), (2.0, 2.0), (5.0, 5.0), (119.0, 119.0), (130.0, 120.0)]
)
def test_an_interrupted_mission_goes_on_from_its_altitude_within_two_metres_and_the_vehicles_limit(
    altitude_m: float, takeoff_m: float
) -> None:
    flown = Flown()
    assert flown.ask(at_altitude(altitude_m), MISSION).accepted
    flown.step(at_altitude(altitude_m))
    flown.step(replace(at_altitude(altitude_m), interventions=1))
    assert (flown.records[-1].state, flown.records[-1].altitude_m) == ("interrupted", takeoff_m)


@pytest.mark.parametrize(
    ("status", "step", "sent"),
    [
        (LANDED, STEP, "takeoff"),
        (FLYING, STEP, "go_to"),
        (replace(LANDED, armed=True), STEP, "go_to"),
        (replace(FLYING, armed=False), STEP, "go_to"),
    ],
    ids=["landed", "flying", "motors run", "a vehicle without motors in the air"],
)
def test_a_mission_takes_off_before_its_step_only_when_the_vehicle_stands_disarmed(
    status: Status, step: GoalStep, sent: str
) -> None:
    flown = Flown(MissionRecord(mission=MISSION, mission_id="m-1", state="interrupted", altitude_m=5.0))
    assert flown.ask(status, MissionCommand(command="resume")).accepted
    ((name, goal),) = flown.goals(status)
    assert name == sent
    assert name != "takeoff" or goal.altitude_m == 5.0


@pytest.mark.parametrize(("command", "state", "index"), [("skip", "running", 1), ("stop", "stopped", 0)])
def test_an_interrupted_mission_leaves_its_step_out_or_ends_at_once_by_command(
    command: Any, state: str, index: int
) -> None:
    flown = Flown(MissionRecord(mission=MISSION, mission_id="m-1", state="interrupted"))
    assert flown.ask(FLYING, MissionCommand(command=command)).accepted
    assert (flown.records[-1].state, flown.records[-1].index) == (state, index)
    assert flown.records[-1].left_out == (command == "skip")


def test_a_step_that_ends_on_the_ground_is_done_when_the_vehicle_has_landed_meanwhile() -> None:
    mission = Mission(name="test", steps=(LAND, STEP))
    for status, index in ((LANDED, 1), (FLYING, 0)):
        flown = Flown(MissionRecord(mission=mission, mission_id="m-1", state="interrupted", altitude_m=5.0))
        assert flown.ask(status, MissionCommand(command="resume")).accepted
        flown.step(status)
        assert flown.records[-1].index == index


@pytest.mark.parametrize(
    ("landed", "armed", "charge", "refused"),
    [
        (True, False, 0.5, ""),
        (True, False, None, ""),
        (True, False, 0.49, "the battery has 49%"),
        (False, False, 0.9, "the vehicle flies"),
        (True, True, 0.9, "the vehicle flies"),
        (False, True, 0.9, "the vehicle flies"),
    ],
)
def test_another_battery_is_accepted_on_the_ground_alone_with_the_motors_off_and_half_full(
    landed: bool, armed: bool, charge: float | None, refused: str
) -> None:
    record = MissionRecord(mission=MISSION, mission_id="m-1", state="interrupted")
    battery = None if charge is None else Battery(voltage_v=15.0, remaining=charge)
    refusal = swap_refusal(record, replace(LANDED, landed=landed, armed=armed, battery=battery))
    assert refusal.startswith(refused) and bool(refusal) is bool(refused)
    assert "the vehicle flies" in swap_refusal(record, None)
    assert "no battery is waited for" in swap_refusal(record.in_state("paused"), LANDED)


def test_a_mission_with_a_step_that_a_client_would_have_to_steer_is_refused() -> None:
    steered = GoalStep(label="by hand", action="fly_velocity", goal={})
    reply = Flown().ask(FLYING, Mission(name="m", steps=(steered,)))
    assert not reply.accepted
    assert reply.reason.startswith("step 1, by hand: fly_velocity follows the commands of a client, and a mission has")
