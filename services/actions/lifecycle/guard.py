"""The guard around an action's own code: what it raises, or returns in vain, ends its goal, and not the server.

Everything that the code returns is checked before it is used, by the declaration of the action's server and by the
ranges of the messages that it becomes.
"""

import sys
import traceback
from collections.abc import Callable
from functools import partial
from math import inf
from typing import Any

from msgspec.structs import replace

from jezero.base.codec import BadPayloadError, NotFiniteError, decode, encode
from jezero.base.frames import Vec3
from jezero.runtime.service import Spec
from jezero.schemas.actions import Accepted, FeedbackMessage, Rejected, Result
from jezero.schemas.commands import Acquire, CameraPitch, Release, Setpoint
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.schemas.struct import Payload
from jezero.schemas.topics import CAMERA_PITCH
from jezero.services.actions.motion.behaviour import (
    Behaviour,
    Done,
    Move,
    Plan,
    Planner,
    Preparation,
    Prepared,
    Refusal,
    Remaining,
    Start,
    VehicleState,
    hold_of,
    path_of,
    pause_refusal_of,
    remaining_of,
)

COORDINATE_MAX_M = 1e6
"""Coordinates of a planned way are within this distance: the range of every position on the bus."""
REMAINING_MAX = 1e12
"""Seconds or metres of the rest of a flight: the range of the messages."""
ERROR_LENGTH_MAX = 400
"""Characters of an exception that the goal's sender gets."""


class WrongValueError(ValueError):
    """The action's code returned what can't be used; the text names the field and what was expected."""


class GuardedPlanner:
    """A planner whose mistakes, and those of its plans and behaviours, become refusals and aborted goals.

    The traceback of each exception goes to standard error, which is the log of the action's server.

    Args:
        action: that is planned.
        spec: declaration of the action's server.
    """

    def __init__(self, action: Action[Any], planner: Planner, spec: Spec) -> None:
        self._name = action.name
        self._planner = planner
        self._checks = _Checks(action, spec)

    def plan(self, goal: Any, status: Status) -> Plan | Refusal:
        """Plan a goal; an exception is a refusal."""
        return self._guarded("plan", partial(self._planner.plan, goal, status))

    def replan(self, goal: Any, status: Status, running: Behaviour) -> Plan | Refusal:
        """Plan a changed goal, whose behaviour takes over from the running one; an exception is a refusal."""
        replan = getattr(self._planner, "replan", None)
        if replan is None:
            return self.plan(goal, status)
        inner = running._behaviour if isinstance(running, _GuardedBehaviour) else running
        return self._guarded("replan", partial(replan, goal, status, inner))

    def _guarded(self, where: str, make: Callable[[], Plan | Refusal]) -> Plan | Refusal:
        try:
            plan = make()
            self._checks.plan(where, plan)
        except Exception as error:  # noqa: BLE001
            return Refusal(_report(self._name, where, error))
        if isinstance(plan, Refusal):
            return plan
        start = plan.start
        guarded = self._preparation(start) if isinstance(start, Preparation) else self._start(start)
        check = None if plan.check_inputs is None else self._check(plan.check_inputs)
        return replace(plan, start=guarded, check_inputs=check)

    def _start(self, start: Start) -> Start:
        return lambda t_ns, state: _GuardedBehaviour(self._name, self._checks, start, t_ns, state)

    def _check(self, check: Callable[[VehicleState], str]) -> Callable[[VehicleState], str]:
        def guarded(state: VehicleState) -> str:
            try:
                reason = check(state)
                self._checks.reason("check_inputs", reason)
                return reason
            except Exception as error:  # noqa: BLE001
                return _report(self._name, "check_inputs", error)

        return guarded

    def _preparation(self, preparation: Preparation) -> Preparation:
        """A guarded preparation; what its work raises in its own process arrives as the error of the task."""

        def work(state: VehicleState) -> Callable[[], Any]:
            try:
                return preparation.work(state)
            except Exception as error:  # noqa: BLE001
                return partial(Refusal, _report(self._name, "prepare", error))

        def start(value: Any) -> Prepared | Refusal:
            try:
                prepared = value if isinstance(value, Refusal) else preparation.start(value)
                self._checks.prepared(prepared)
            except Exception as error:  # noqa: BLE001
                return Refusal(_report(self._name, "prepare", error))
            return prepared if isinstance(prepared, Refusal) else replace(prepared, start=self._start(prepared.start))

        def feedback(state: VehicleState) -> Any:
            try:
                content = None if preparation.feedback is None else preparation.feedback(state)
                if content is not None:
                    self._checks.feedback(content)
                return content
            except Exception as error:  # noqa: BLE001
                _report(self._name, "feedback", error)
                return None

        return replace(preparation, work=work, start=start, feedback=feedback)


class _GuardedBehaviour:
    """A behaviour that ends as aborted when its own code raises, or returns what can't be used."""

    def __init__(self, name: str, checks: "_Checks", start: Start, t_ns: int, state: VehicleState) -> None:
        self._name = name
        self._checks = checks
        self._behaviour: Behaviour | None = None
        self._failure = ""
        try:
            self._behaviour = start(t_ns, state)
        except Exception as error:  # noqa: BLE001
            self._failure = _report(name, "start", error)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Next setpoint, or the end; an exception is an aborted goal."""
        if self._behaviour is None or self._failure:
            return Done("aborted", self._failure)
        move: Move | Done = self._checked("step", partial(self._behaviour.step, t_ns, state))
        return move

    def hold(self, t_ns: int, dt_s: float, state: VehicleState) -> Move | Done | None:
        """Next setpoint of the behaviour's own hover, if it has one; an exception is an aborted goal."""
        if self._behaviour is None or self._failure:
            return Done("aborted", self._failure)
        call = partial(hold_of, self._behaviour, t_ns, dt_s, state)
        move: Move | Done | None = self._checked("hold", call, optional=True)
        return move

    def pause_refusal(self, state: VehicleState) -> str:
        """Reason why the behaviour can't be paused now, or ""; an exception is one, and ends the goal."""
        if self._behaviour is None or self._failure:
            return self._failure
        try:
            return pause_refusal_of(self._behaviour, state)
        except Exception as error:  # noqa: BLE001
            self._failure = _report(self._name, "pause_refusal", error)
            return self._failure

    def _checked(self, where: str, call: Callable[[], Any], *, optional: bool = False) -> Any:
        """What a method of the behaviour returns; an exception, or what can't be used, is an aborted goal.

        Args:
            optional: the method may return None.
        """
        try:
            move = call()
            if not (optional and move is None):
                self._checks.move(where, move)
        except Exception as error:  # noqa: BLE001
            self._failure = _report(self._name, where, error)
            return Done("aborted", self._failure)
        return move

    def remaining(self, state: VehicleState) -> Remaining | None:
        """Rest of the flight; None when the behaviour doesn't know it. An exception ends the goal in the next step."""
        if self._behaviour is None or self._failure:
            return None
        try:
            rest = remaining_of(self._behaviour, state)
            known = rest is not None and 0.0 <= rest.time_s <= REMAINING_MAX and 0.0 <= rest.distance_m <= REMAINING_MAX
        except Exception as error:  # noqa: BLE001
            self._failure = _report(self._name, "remaining", error)
            return None
        return rest if known else None

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """Corners of the planned way; empty when the behaviour doesn't know it, or raises."""
        if self._behaviour is None or self._failure:
            return ()
        try:
            corners = path_of(self._behaviour, state)
            near = all(
                max(map(abs, (north_m, east_m, down_m))) <= COORDINATE_MAX_M for north_m, east_m, down_m in corners
            )
        except Exception as error:  # noqa: BLE001
            self._failure = _report(self._name, "path", error)
            return ()
        return corners if near else ()

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> Payload | None:
        """The behaviour's result; None when its own code raises, returns what can't be used, or has never started."""
        if self._behaviour is None:
            return None
        try:
            result = self._behaviour.result(completed and not self._failure, pos_uav_ned_m)
            self._checks.result(result)
        except Exception as error:  # noqa: BLE001
            _report(self._name, "result", error)
            return None
        return result


class _Checks:
    """Checks of what an action's code returns: each raises `WrongValueError` for what can't be used.

    A value is encoded and decoded as the messages that it becomes, because their readers would drop one that is out of
    range, and the goal would go on without it.

    Args:
        action: whose code it is.
        spec: declaration of its server.
    """

    def __init__(self, action: Action[Any], spec: Spec) -> None:
        self._action = action
        self._inputs = {topic.name for topic in spec.on_demand}
        self._points_camera = CAMERA_PITCH in spec.outputs
        self._feedback_type: Any = FeedbackMessage[action.feedback_type]  # type: ignore[name-defined]
        self._result_type: Any = Result[action.result_type]  # type: ignore[name-defined]

    def plan(self, where: str, plan: Any) -> None:
        """Check a plan or a refusal."""
        if isinstance(plan, Refusal):
            self.reason(where, plan.reason)
            return
        if not isinstance(plan, Plan):
            raise WrongValueError(f"{where} returned {type(plan).__name__}, not a Plan or a Refusal")
        if unknown := [topic.name for topic in plan.inputs if topic.name not in self._inputs]:
            raise WrongValueError(
                f"Plan.inputs names {', '.join(unknown)}, which no behaviour of this action gets; "
                f"there are {', '.join(sorted(self._inputs))}"
            )
        if plan.capture is not None and not self._action.takes_pictures:
            raise WrongValueError("Plan.capture takes pictures: declare the Action with takes_pictures=True")
        if plan.rate_hz is not None and not 0.0 < plan.rate_hz < inf:
            raise WrongValueError(f"Plan.rate_hz is {plan.rate_hz:g}: give setpoints per second, or None")
        request = Acquire(goal_id="-", action="-", do_takeoff=plan.do_takeoff, override=plan.override)
        _check("Plan", Acquire, request)
        _check("Plan", Accepted, Accepted(goal_id="-", warning=plan.warning))

    def prepared(self, prepared: Any) -> None:
        """Check the outcome of a preparation."""
        if isinstance(prepared, Refusal):
            self.reason("prepare", prepared.reason)
        elif isinstance(prepared, Prepared):
            _check("Prepared", Accepted, Accepted(goal_id="-", warning=prepared.warning))
        else:
            raise WrongValueError(f"start returned {type(prepared).__name__}, not a Prepared or a Refusal")

    def reason(self, where: str, reason: Any) -> None:
        """Check the reason of a refusal."""
        _check(where, Rejected, Rejected(reason=reason))

    def move(self, where: str, move: Any) -> None:
        """Check a setpoint with its feedback, or the end of a behaviour."""
        if isinstance(move, Done):
            end = Release(
                control_id="-",
                outcome=move.outcome,
                then=move.then,
                hover_pos_ned_m=move.hover_pos_ned_m,
                reason=move.reason,
            )
            _check("Done", Release, end)
            return
        if not isinstance(move, Move):
            raise WrongValueError(f"{where} returned {type(move).__name__}, not a Move or a Done")
        if move.pos_ned_m is None and move.vel_ned_mps is None:
            raise WrongValueError("the Move has neither pos_ned_m nor vel_ned_mps: give at least one of them")
        _check_setpoint("Move", move, move.yaw_rad, move.yaw_rate_rps)
        if move.target_ned_m is not None:
            _check_setpoint("Move.target_ned_m", Move(move.phase, None, pos_ned_m=move.target_ned_m))
        if move.frame is not None:
            frame = move.frame
            _check_setpoint(
                "Move.frame", Move(move.phase, None, frame.pos_ned_m, frame.vel_ned_mps, frame.acc_ned_mps2)
            )
        if move.pitch_camera_rad is not None:
            self._camera(move.pitch_camera_rad, move.roll_camera_rad)
        self.feedback(move.feedback)

    def _camera(self, pitch_camera_rad: float, roll_camera_rad: float) -> None:
        if not self._points_camera:
            raise WrongValueError("Move.pitch_camera_rad points the camera: declare the Action with points_camera=True")
        axes = CameraPitch(t_ns=0, pitch_camera_rad=pitch_camera_rad, roll_camera_rad=roll_camera_rad)
        _check("Move", CameraPitch, axes)

    def feedback(self, content: Any) -> None:
        """Check feedback of the action's own type."""
        message = FeedbackMessage(t_ns=0, goal_id="-", action="-", code=0, feedback=content)
        _check(f"feedback ({type(content).__name__})", self._feedback_type, message)

    def result(self, content: Any) -> None:
        """Check a result of the action's own type, or None."""
        message = Result(goal_id="-", t_ns=0, outcome="aborted", result=content)
        _check(f"result ({type(content).__name__})", self._result_type, message)


def _check_setpoint(what: str, move: Move, yaw_rad: float | None = None, yaw_rate_rps: float | None = None) -> None:
    setpoint = Setpoint(
        t_ns=0,
        control_id="-",
        sequence=0,
        phase=move.phase,
        pos_ned_m=move.pos_ned_m,
        vel_ned_mps=move.vel_ned_mps,
        acc_ned_mps2=move.acc_ned_mps2,
        yaw_rad=yaw_rad,
        yaw_rate_rps=yaw_rate_rps,
    )
    _check(what, Setpoint, setpoint)


def _check(what: str, kind: Any, message: Payload) -> None:
    """Raise `WrongValueError` for a message that its reader would refuse."""
    try:
        decode(kind, encode(message))
    except (BadPayloadError, NotFiniteError) as error:
        raise WrongValueError(f"{what}: {error}") from None
    except TypeError as error:  # of an array, or a number in one
        raise WrongValueError(f"{what}: {error}: give Python numbers, such as tuple(array.tolist())") from None


def _report(name: str, where: str, error: Exception) -> str:
    """Print what went wrong, for an exception of the action's own code with the traceback.

    Returns:
        The sentence for the goal's sender.
    """
    if isinstance(error, WrongValueError):
        sentence = f"{name} failed in {where}: {error}"
        print(sentence, file=sys.stderr)
        return sentence[:ERROR_LENGTH_MAX]
    print(f"{name}: {where} raised an exception", file=sys.stderr)
    traceback.print_exception(error)
    text = f"{type(error).__name__}: {error}"[:ERROR_LENGTH_MAX]
    return f"{name} failed in {where}: {text}; the traceback is in the log of the server"
