"""The guard around an action's own code: an exception, or a value that can't be used, ends its goal with a sentence,
and nothing else."""

from collections.abc import Callable
from functools import partial
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.runtime.service import Spec
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.rows import Action
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import ALTIMETER, ODOMETRY, RELATIVE, UWB
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.guard import GuardedPlanner
from jezero.services.actions.motion.behaviour import (
    Done,
    Move,
    MovingFrame,
    Plan,
    Preparation,
    Prepared,
    Refusal,
    Remaining,
    VehicleState,
)
from jezero.services.actions.motion.capture import Capture
from tests.services.actions.test_behaviours import a_status

STATE = VehicleState(
    pos_uav_ned_m=(0.0, 0.0, -2.0),
    vel_uav_ned_mps=(0.0, 0.0, 0.0),
    q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
    armed=True,
    landed=False,
)
ACTION = Action("spiral", GoToGoal, MoveFeedback, MoveResult, Phase.ACTION)
SPEC = Spec(name="spiral", on_demand=(ODOMETRY, RELATIVE, ALTIMETER))
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
    return GuardedPlanner(ACTION, Broken(where), SPEC).plan(GOAL, a_status(StatusCode.HOVER))


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
    assert behaviour.hold(1, 0.02, STATE) == done
    assert behaviour.pause_refusal(STATE) == done.reason


def test_a_result_that_raises_is_none() -> None:
    assert behaviour_of("result").result(True, STATE.pos_uav_ned_m) is None


class Tells:
    """A behaviour that also has a rest and a way, and may be paused or not. The method named `where` raises."""

    def __init__(self, where: str = "", rest: Any = None, way: Any = ()) -> None:
        self._where, self._rest, self._way = where, rest, way

    def plan(self, goal: Any, status: Status) -> Any:
        return Plan(lambda t_ns, state: self)

    def _tell(self, part: str, value: Any) -> Any:
        if part == self._where:
            raise ValueError("out of propellant")
        return value

    def step(self, t_ns: int, state: VehicleState) -> Move:
        return MOVE

    def remaining(self, state: VehicleState) -> Any:
        return self._tell("remaining", self._rest)

    def path(self, state: VehicleState) -> Any:
        return self._tell("path", self._way)

    def hold(self, t_ns: int, dt_s: float, state: VehicleState) -> Any:
        return self._tell("hold", None)

    def pause_refusal(self, state: VehicleState) -> Any:
        return self._tell("pause_refusal", "it touches down")

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)


def telling(**parts: Any) -> Any:
    plan = GuardedPlanner(ACTION, Tells(**parts), SPEC).plan(GOAL, a_status(StatusCode.HOVER))
    assert isinstance(plan, Plan) and not isinstance(plan.start, Preparation)
    return plan.start(0, STATE)


@pytest.mark.parametrize("where", ["remaining", "path", "hold", "pause_refusal"])
def test_what_raises_beside_the_flight_is_unknown_and_aborts_the_goal_in_the_next_step(where: str) -> None:
    behaviour = telling(where=where, rest=Remaining(1.0, 1.0), way=((0.0, 0.0, -3.0),))
    assert behaviour.step(0, STATE) is MOVE
    arguments = (0, 0.02, STATE) if where == "hold" else (STATE,)
    answer = getattr(behaviour, where)(*arguments)
    reason = f"spiral failed in {where}: ValueError: out of propellant"
    assert answer in (None, ()) or (answer.reason if where == "hold" else answer).startswith(reason)
    done = behaviour.step(1, STATE)
    assert isinstance(done, Done) and done.reason.startswith(reason)
    assert (behaviour.remaining(STATE), behaviour.path(STATE)) == (None, ())
    assert behaviour.pause_refusal(STATE) == done.reason
    assert behaviour.hold(2, 0.02, STATE) == done
    assert behaviour.result(True, (0.0, 0.0, 0.0)).completed is False


def test_a_behaviour_that_never_started_has_no_rest_no_way_and_no_result() -> None:
    behaviour = behaviour_of("start")
    assert behaviour.remaining(STATE) is None
    assert behaviour.path(STATE) == ()
    assert behaviour.result(True, STATE.pos_uav_ned_m) is None


@pytest.mark.parametrize(
    ("rest", "known"),
    [
        (Remaining(0.0, 0.0), True),
        (Remaining(5.0, 9e11), True),
        (Remaining(-1.0, 1.0), False),
        (Remaining(1.0, -1.0), False),
        (Remaining(inf, 1.0), False),
        (Remaining(1.0, nan), False),
        (Remaining(1.1e12, 1.0), False),
        (Remaining(1.0, 1.1e12), False),
        (None, False),
    ],
)
def test_a_rest_out_of_range_is_unknown(rest: Remaining | None, known: bool) -> None:
    assert telling(rest=rest).remaining(STATE) == (rest if known else None)


@pytest.mark.parametrize(
    ("corner", "known"), [((9e5, -9e5, 0.0), True), ((0.0, 0.0, -2e6), False), ((2e6, 0.0, 0.0), False)]
)
def test_a_way_that_leads_out_of_range_is_unknown(corner: Vec3, known: bool) -> None:
    assert bool(telling(way=((0.0, 0.0, -3.0), corner)).path(STATE)) is known


def test_a_behaviour_without_a_hover_of_its_own_leaves_it_to_the_pause() -> None:
    assert telling().hold(0, 0.02, STATE) is None
    assert telling().pause_refusal(STATE) == "it touches down"
    assert telling().step(0, STATE) is MOVE


def test_a_changed_goal_takes_over_from_the_behaviour_itself_and_is_planned_anew_without_replan() -> None:
    class Changes(Tells):
        def replan(self, goal: Any, status: Status, running: Any) -> Any:
            return Refusal(f"was {type(running).__name__}")

    status = a_status(StatusCode.HOVER)
    running = telling()
    changed = GuardedPlanner(ACTION, Changes(), SPEC).replan(GOAL, status, running)
    assert changed == Refusal("was Tells")
    assert isinstance(GuardedPlanner(ACTION, Tells(), SPEC).replan(GOAL, status, running), Plan)


@pytest.mark.parametrize(("content", "kept"), [(MOVE.feedback, True), (None, False), (GOAL, False)])
def test_feedback_of_a_preparation_that_can_not_be_used_is_left_out(content: Any, kept: bool) -> None:
    preparation = Preparation(work=lambda state: lambda: None, start=START_OF, feedback=lambda state: content)
    plan = guarded(Returns(plan=Plan(preparation)))
    assert isinstance(plan, Plan) and isinstance(plan.start, Preparation) and plan.start.feedback is not None
    assert plan.start.feedback(STATE) == (content if kept else None)
    silent = guarded(Returns(plan=Plan(replace(preparation, feedback=None))))
    assert isinstance(silent, Plan) and isinstance(silent.start, Preparation) and silent.start.feedback is not None
    assert silent.start.feedback(STATE) is None


START_OF: Any = partial(Prepared)


class Returns:
    """A planner with one behaviour, which return what they are made with.

    Args:
        plan: what the planner returns; None: a plan of the behaviour.
        move: what each step returns.
        result: what the behaviour returns as its result.
    """

    def __init__(self, *, plan: Any = None, move: Any = MOVE, result: Any = None) -> None:
        self._plan, self._move, self._result = plan, move, result

    def plan(self, goal: Any, status: Status) -> Any:
        return self._plan or Plan(lambda t_ns, state: self)

    def step(self, t_ns: int, state: VehicleState) -> Any:
        return self._move

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> Any:
        return self._result


def guarded(code: Returns) -> Plan | Refusal:
    return GuardedPlanner(ACTION, code, SPEC).plan(GOAL, a_status(StatusCode.HOVER))


@pytest.mark.parametrize(
    ("move", "sentence"),
    [
        (replace(MOVE, pitch_camera_rad=-1.0), "declare the Action with points_camera=True"),
        (replace(MOVE, pos_ned_m=(0.0, 0.0, nan)), "Setpoint.pos_ned_m[2] is nan"),
        (None, "step returned NoneType, not a Move or a Done"),
        (replace(MOVE, pos_ned_m=None), "neither pos_ned_m nor vel_ned_mps"),
        (replace(MOVE, pos_ned_m=(0.0, 0.0)), "Move: pos_ned_m: expected a list of length 3"),
        (replace(MOVE, pos_ned_m=np.zeros(3)), "such as tuple(array.tolist())"),
        (replace(MOVE, vel_ned_mps=(2000.0, 0.0, 0.0)), "vel_ned_mps[0]: expected a number from -1000 to 1000"),
        (replace(MOVE, yaw_rad=90.0), "yaw_rad: expected a number from -6.2832 to 6.2832"),
        (replace(MOVE, target_ned_m=(inf, 0.0, 0.0)), "Move.target_ned_m: "),
        (replace(MOVE, frame=MovingFrame((nan, 0.0, 0.0))), "Move.frame: "),
        (replace(MOVE, feedback=GOAL), "feedback (GoToGoal): "),
        (replace(MOVE, feedback=MoveFeedback(pos_uav_ned_m=(0.0, 0.0, 0.0), distance_m=inf)), "distance_m is inf"),
        (Done("failed"), "Done: outcome: there is no value 'failed'"),  # type: ignore[arg-type]
        (Done("aborted", hover_pos_ned_m=(nan, 0.0, 0.0)), "hover_pos_ned_m[0] is nan"),
    ],
)
def test_a_step_that_returns_what_can_not_be_used_aborts_the_goal(move: Any, sentence: str) -> None:
    plan = guarded(Returns(move=move))
    assert isinstance(plan, Plan) and not isinstance(plan.start, Preparation)
    done = plan.start(0, STATE).step(0, STATE)
    assert isinstance(done, Done) and done.outcome == "aborted"
    assert done.reason.startswith("spiral failed in step: ") and sentence in done.reason


CAPTURE = Capture(ActionsConfig().capture, ActionsConfig().vehicle.airframe, 1)
START: Any = Returns()


@pytest.mark.parametrize(
    ("plan", "sentence"),
    [
        ("fly", "plan returned str, not a Plan or a Refusal"),
        (Refusal(None), "reason: expected a text, not nothing"),  # type: ignore[arg-type]
        (Plan(START, inputs=(UWB,)), "names sensor/uwb, which no behaviour of this action gets; there are"),
        (Plan(START, capture=CAPTURE), "declare the Action with takes_pictures=True"),
        (Plan(START, rate_hz=-1.0), "rate_hz is -1"),
        (Plan(START, rate_hz=0.0), "rate_hz is 0: give setpoints per second, or None"),
        (Plan(START, rate_hz=inf), "rate_hz is inf"),
        (Plan(START, rate_hz=nan), "rate_hz is nan"),
        (Plan(START, override=("everything",)), "override[0]: there is no value 'everything'"),  # type: ignore[arg-type]
        (Plan(START, warning=5), "warning: expected a text, not a whole number"),  # type: ignore[arg-type]
    ],
)
def test_a_plan_that_can_not_be_used_refuses_the_goal(plan: Any, sentence: str) -> None:
    refusal = guarded(Returns(plan=plan))
    assert isinstance(refusal, Refusal)
    assert refusal.reason.startswith("spiral failed in plan: ") and sentence in refusal.reason


def test_a_preparation_that_returns_something_else_refuses_the_goal() -> None:
    start: Any = partial(lambda value: value)
    plan = guarded(Returns(plan=Plan(Preparation(work=lambda state: lambda: None, start=start))))
    assert isinstance(plan, Plan) and isinstance(plan.start, Preparation)
    refusal = plan.start.start(None)
    assert isinstance(refusal, Refusal) and "start returned NoneType, not a Prepared" in refusal.reason


@pytest.mark.parametrize("result", [GOAL, MoveResult(completed=True, pos_uav_ned_m=(nan, 0.0, 0.0))])
def test_a_result_of_another_type_or_out_of_range_is_none(result: Any) -> None:
    plan = guarded(Returns(result=result))
    assert isinstance(plan, Plan) and not isinstance(plan.start, Preparation)
    assert plan.start(0, STATE).result(True, STATE.pos_uav_ned_m) is None


def test_a_long_exception_is_cut_so_that_its_sentence_can_be_sent() -> None:
    class Long(Returns):
        def plan(self, goal: Any, status: Status) -> Any:
            raise ValueError("x" * 5000)

    refusal = guarded(Long())
    assert isinstance(refusal, Refusal) and len(refusal.reason) < 1000
