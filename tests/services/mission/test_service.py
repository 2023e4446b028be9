"""What the mission service does with an interrupted mission, and what it refuses."""

from collections.abc import Sequence
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.runtime.service import Call, Output, Reply, Request, Response
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import ReturnHomeGoal
from jezero.schemas.mission import GoalStep, Mission, MissionCommand, MissionReply
from jezero.schemas.state import Battery, Status, StatusCode
from jezero.schemas.topics import ACTIONS, COMMAND_MISSION, RUN_MISSION, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.rules import swap_refusal
from jezero.services.mission.service import MissionService
from tests.client.rig import ODOMETRY, a_status

STEP = GoalStep(label="go", action="go_to", goal={"target_ned_m": [1.0, 0.0, -3.0]})
LAND = GoalStep(label="land", action="land_on_spot", goal={})
MISSION = Mission(name="test", steps=(STEP, STEP))
FLYING = replace(a_status(StatusCode.HOVER), battery=Battery(voltage_v=15.0, remaining=0.9))
LANDED = replace(a_status(StatusCode.IDLE), battery=Battery(voltage_v=15.0, remaining=0.9))


def at_altitude(altitude_m: float) -> Status:
    return replace(FLYING, odometry=replace(ODOMETRY, pos_uav_ned_m=(1.0, 2.0, -altitude_m)))


class Box:
    """What arrives at the service in one step."""

    wall_ns, connected, departed, has_requests = 0, True, (), True

    def __init__(self, status: Status, request: Any = None, responses: Sequence[Response] = ()) -> None:
        self.status, self.request, self.responses = status, request, responses

    def latest(self, topic: Any) -> Any:
        return self.status if topic is STATUS else None

    def new(self, topic: Any) -> Sequence[Any]:
        return ()

    def requests(self, endpoint: Any) -> Sequence[Request]:
        wanted = {RUN_MISSION: Mission, COMMAND_MISSION: MissionCommand}.get(endpoint)
        return [Request(1, "client", self.request)] if wanted is not None and isinstance(self.request, wanted) else ()


class Flown:
    """Steps a mission service once a second.

    Args:
        saved: the mission of the run before.

    Attributes:
        records: every record that was kept.
    """

    def __init__(self, saved: MissionRecord | None = None) -> None:
        self.records: list[MissionRecord] = []
        self._service = MissionService(1, ACTIONS, saved, self.records.append)
        self._t_ns = 0

    def step(self, status: Status, request: Any = None, *responses: Response) -> list[Output]:
        self._t_ns += NS_PER_S
        return list(self._service.step(self._t_ns, Box(status, request, responses)))  # type: ignore[arg-type]

    def ask(self, status: Status, request: Any) -> MissionReply:
        (reply,) = [output.payload for output in self.step(status, request) if isinstance(output, Reply)]
        assert isinstance(reply, MissionReply)
        return reply

    def goals(self, status: Status) -> list[tuple[str, Any]]:
        """Names of the actions to which goals are sent in the next step, and the goals."""
        calls = [output for output in self.step(status) if isinstance(output, Call)]
        names = {action.endpoint: name for name, action in ACTIONS.items()}
        return [(names[call.endpoint], call.payload) for call in calls if call.endpoint in names]


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


def returning() -> tuple[Flown, Status]:
    """A mission service whose battery is just enough for the way home, and the status with it."""
    flown = Flown()
    assert flown.ask(FLYING, MISSION).accepted
    plans = [output for output in flown.step(FLYING) if isinstance(output, Call)]
    (tag,) = [call.tag for call in plans if isinstance(call.payload, ReturnHomeGoal)]
    low = replace(FLYING, battery=Battery(voltage_v=15.0, remaining=0.15))
    flown.step(low, None, Response(tag, PlanReply(accepted=True, duration_s=900.0)))
    for _ in range(4):
        flown.step(low)
    return flown, low


@pytest.mark.parametrize("command", ["pause", "resume", "skip", "swapped"])
def test_while_the_vehicle_returns_nothing_but_an_end_of_the_mission_is_accepted(command: Any) -> None:
    flown, low = returning()
    reply = flown.ask(low, MissionCommand(command=command))
    assert not reply.accepted
    assert "wait until it has landed, or end the return with jezero hover" in reply.reason
    assert flown.records[-1].state == "interrupted"
    reply = flown.ask(low, MISSION)
    assert not reply.accepted
    assert "wait until it has landed" in reply.reason
    assert flown.ask(low, MissionCommand(command="stop")).accepted


def test_a_mission_with_a_step_that_a_client_would_have_to_steer_is_refused() -> None:
    steered = GoalStep(label="by hand", action="fly_velocity", goal={})
    reply = Flown().ask(FLYING, Mission(name="m", steps=(steered,)))
    assert not reply.accepted
    assert reply.reason.startswith("step 1, by hand: fly_velocity follows the commands of a client, and a mission has")
