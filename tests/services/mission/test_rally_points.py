"""The rally points of a mission are places for each return that the mission service flies meanwhile."""

from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from jezero.runtime.service import Call, Request, Response
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import ReturnHomeGoal
from jezero.schemas.mission import FailurePolicy, GoalStep, Mission
from jezero.schemas.state import Battery, Status, StatusCode
from jezero.schemas.topics import ACTIONS, RUN_MISSION, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.rules import last_goal
from jezero.services.mission.service import MissionService
from tests.client.rig import a_status

RALLY = ((20.0, -15.0), (5.0, 5.0))
STEP = GoalStep(label="go", action="go_to", goal={"target_ned_m": [1.0, 0.0, -3.0]}, on_failure=FailurePolicy())
FLYING = replace(a_status(StatusCode.HOVER), battery=Battery(voltage_v=15.0, remaining=0.9))


class Bus:
    """What arrives at the service in one step."""

    wall_ns, connected, departed, has_requests = 0, True, (), True

    def __init__(self, status: Status, mission: Mission | None = None, responses: Sequence[Response] = ()) -> None:
        self.status, self.mission, self.responses = status, mission, responses

    def latest(self, topic: Any) -> Any:
        return self.status if topic is STATUS else None

    def new(self, topic: Any) -> Sequence[Any]:
        return ()

    def requests(self, endpoint: Any) -> Sequence[Request]:
        return [Request(1, "client", self.mission)] if endpoint is RUN_MISSION and self.mission is not None else ()


def returns_of(outputs: Sequence[Any]) -> list[tuple[str, ReturnHomeGoal]]:
    """The tags of the calls for returns and for their plans, with their goals."""
    calls = [output for output in outputs if isinstance(output, Call)]
    return [(call.tag, call.payload) for call in calls if isinstance(call.payload, ReturnHomeGoal)]


def test_the_way_home_is_planned_and_flown_with_the_missions_rally_points() -> None:
    service = MissionService(1, ACTIONS)

    def step(second: int, *arrived: Any) -> list[tuple[str, ReturnHomeGoal]]:
        return returns_of(list(service.step(second * NS_PER_S, Bus(*arrived))))  # type: ignore[arg-type]

    ((_, before),) = step(1, FLYING, Mission(name="test", steps=(STEP,), rally_points_ned_m=RALLY))
    assert before.rally_points_ned_m == (), "there is no mission yet"
    ((tag, planned),) = step(10, FLYING)
    assert planned.rally_points_ned_m == RALLY
    low = replace(FLYING, battery=Battery(voltage_v=15.0, remaining=0.15))
    step(11, low, None, [Response(tag, PlanReply(accepted=True, duration_s=900.0))])
    flown = [goal for second in range(12, 16) for _, goal in step(second, low) if goal.plan_from_ned_m is None]
    assert flown and all(goal.rally_points_ned_m == RALLY for goal in flown)


def test_the_return_after_a_failed_step_has_the_missions_rally_points() -> None:
    assert last_goal("return", FLYING, RALLY).goal == {"rally_points_ned_m": RALLY}
    assert last_goal("return", FLYING, ()).goal == {}
    assert "rally_points_ned_m" not in last_goal("land", FLYING, RALLY).goal
