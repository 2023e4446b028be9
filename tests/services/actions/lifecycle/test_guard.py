"""The guard around an action's own code: an exception ends its goal with a sentence, and nothing else."""

from collections.abc import Callable
from typing import Any

import pytest

from jezero.base.frames import Vec3
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.state import Status, StatusCode
from jezero.services.actions.lifecycle.guard import GuardedPlanner
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Preparation, Prepared, Refusal, VehicleState
from tests.services.actions.test_behaviours import a_status

STATE = VehicleState(
    pos_uav_ned_m=(0.0, 0.0, -2.0),
    vel_uav_ned_mps=(0.0, 0.0, 0.0),
    q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
    armed=True,
    landed=False,
)
GOAL = GoToGoal(target_ned_m=(0.0, 0.0, -3.0))
MOVE = Move(Phase.ACTION, MoveFeedback(pos_uav_ned_m=(0.0, 0.0, -2.0), distance_m=1.0), pos_ned_m=(0.0, 0.0, -3.0))


class Broken:
    """A planner, its plans and behaviours; the part named by `where` raises."""

    def __init__(self, where: str) -> None:
        self._where = where

    def _maybe_raise(self, part: str) -> None:
        if part == self._where:
            raise ValueError("out of propellant")

    def plan(self, goal: Any, status: Status) -> Plan | Refusal:
        self._maybe_raise("plan")
        if self._where == "prepare":
            return Plan(Preparation(work=self._work, start=self._prepared))
        if self._where == "prepare start":
            return Plan(Preparation(work=lambda state: lambda: None, start=self._prepared))
        return Plan(self.start, check_inputs=self._check)

    def _work(self, state: VehicleState) -> Callable[[], None]:
        self._maybe_raise("prepare")
        return lambda: None

    def _prepared(self, value: None) -> Prepared:
        self._maybe_raise("prepare start")
        return Prepared(self.start)

    def _check(self, state: VehicleState) -> str:
        self._maybe_raise("check_inputs")
        return ""

    def start(self, t_ns: int, state: VehicleState) -> "Broken":
        self._maybe_raise("start")
        return self

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        self._maybe_raise("step")
        return None if self._where == "nothing returned" else MOVE  # type: ignore[return-value]

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        self._maybe_raise("result")
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)


def plan_of(where: str) -> Plan | Refusal:
    return GuardedPlanner("spiral", Broken(where)).plan(GOAL, a_status(StatusCode.HOVER))


def behaviour_of(where: str) -> Any:
    plan = plan_of(where)
    assert isinstance(plan, Plan)
    assert not isinstance(plan.start, Preparation)
    return plan.start(0, STATE)


def test_what_does_not_raise_is_left_as_it_is() -> None:
    behaviour = behaviour_of("nowhere")
    assert behaviour.step(0, STATE) is MOVE
    assert behaviour.result(True, STATE.pos_uav_ned_m) == MoveResult(completed=True, pos_uav_ned_m=(0.0, 0.0, -2.0))


def test_a_planner_that_raises_refuses_the_goal_and_prints_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    refusal = plan_of("plan")
    assert isinstance(refusal, Refusal)
    assert refusal.reason.startswith(
        "spiral failed in plan: ValueError: out of propellant; the traceback is in the log"
    )
    assert "Traceback" in capsys.readouterr().err


def test_inputs_whose_check_raises_refuse_the_goal() -> None:
    plan = plan_of("check_inputs")
    assert isinstance(plan, Plan)
    assert plan.check_inputs is not None
    assert "spiral failed in check_inputs" in plan.check_inputs(STATE)


@pytest.mark.parametrize("where", ["prepare", "prepare start"])
def test_a_preparation_that_raises_refuses_the_goal(where: str) -> None:
    plan = plan_of(where)
    assert isinstance(plan, Plan)
    assert isinstance(plan.start, Preparation)
    prepared = plan.start.start(plan.start.work(STATE)())
    assert isinstance(prepared, Refusal)
    assert "spiral failed in prepare" in prepared.reason


@pytest.mark.parametrize("where", ["start", "step", "nothing returned"])
def test_a_behaviour_that_raises_aborts_its_goal_for_good(where: str) -> None:
    behaviour = behaviour_of(where)
    done = behaviour.step(0, STATE)
    assert isinstance(done, Done)
    assert done.outcome == "aborted"
    assert done.reason.startswith("spiral failed")
    assert behaviour.step(1, STATE) == done


def test_a_result_that_raises_is_none() -> None:
    assert behaviour_of("result").result(True, STATE.pos_uav_ned_m) is None
