"""A change of a goal is planned with the pictures that there are when it comes into force."""

from typing import Any

from jezero.runtime.service import BackgroundTask, CancelTask, Output, Reply, Response
from jezero.schemas.actions import ModifyReply
from jezero.schemas.goals import AreaCoverageGoal
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import AREA_COVERAGE, STATUS
from jezero.services.actions.lifecycle.modification import Modification
from jezero.services.actions.motion.behaviour import Plan, Preparation, Prepared, VehicleState
from jezero.vehicle_config import BatteryConfig

STILL = (0.0, 0.0, 0.0)
STATE = VehicleState((0.0, 0.0, -4.0), STILL, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False)
HOVERING = Status(
    t_ns=0,
    code=3,
    name=StatusCode.HOVER.name,
    armed=True,
    landed=False,
    in_charge="hover",
    bridge_boot_id=1,
    ready=True,
)
GOAL = AreaCoverageGoal(polygon_ned_m=((0.0, 0.0), (4.0, 0.0), (4.0, 4.0)), z_ned_m=-4.0, goal_id="g")


def work() -> int:
    return 7


class Flight:
    """A goal that hovers for its change, and that may still get a picture. It is also the planner and the inbox.

    Attributes:
        taken: number of pictures so far.
        planned_with: number of pictures at each plan.
        in_force: number of pictures with which the plan that came into force was made; None before.
    """

    stage = "flying"
    behaviour: Any = None

    def __init__(self) -> None:
        self.taken = 0
        self.planned_with: list[int] = []
        self.in_force: int | None = None
        self.responses: tuple[Response, ...] = ()

    def brake(self, t_ns: int, inbox: Any) -> VehicleState:
        return STATE

    def goal_time_ns(self, t_ns: int) -> int:
        return t_ns

    def go_on(self, behaviour: Any = None) -> None:
        self.in_force = behaviour

    def replan(self, goal: Any, status: Status, running: Any) -> Plan:
        taken = self.taken
        self.planned_with.append(taken)
        return Plan(
            Preparation(work=lambda state: work, start=lambda made: Prepared(start=lambda t_ns, state: taken))  # type: ignore[arg-type, return-value]
        )

    def latest(self, topic: Any) -> Any:
        return HOVERING if topic is STATUS else None


def tasks(outputs: list[Output]) -> list[str]:
    return [output.tag for output in outputs if isinstance(output, BackgroundTask)]


def test_a_change_is_planned_again_when_a_picture_comes_while_it_is_planned() -> None:
    flight: Any = Flight()
    change = Modification(AREA_COVERAGE, 1, "g", GOAL, flight, BatteryConfig())
    (first,) = tasks(list(change.step(1_000, flight, flight)))
    flight.taken = 1
    outputs = list(change.step(2_000, flight, flight))
    assert CancelTask(first) in outputs
    (second,) = tasks(outputs)
    flight.responses = (Response(first, None, "canceled"), Response(second, 7))
    outputs = list(change.step(3_000, flight, flight))
    assert [output.payload for output in outputs if isinstance(output, Reply)] == [ModifyReply(modified=True)]
    assert (flight.planned_with, flight.in_force) == ([0, 1], 1)
