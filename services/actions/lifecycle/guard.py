"""The guard around an action's own code: whatever it raises ends its goal, and neither the server nor other goals."""

import sys
import traceback
from collections.abc import Callable
from functools import partial
from math import inf, isfinite
from typing import Any

from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.schemas.state import Status
from jezero.schemas.struct import Payload
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


class GuardedPlanner:
    """A planner whose exceptions, and those of its plans and behaviours, become refusals and aborted goals.

    The traceback of each goes to standard error, which is the log of the action's server.

    Args:
        name: of the action.
    """

    def __init__(self, name: str, planner: Planner) -> None:
        self._name = name
        self._planner = planner

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
        except Exception as error:  # noqa: BLE001
            return Refusal(_report(self._name, where, error))
        if isinstance(plan, Refusal):
            return plan
        start = plan.start
        guarded = self._preparation(start) if isinstance(start, Preparation) else self._start(start)
        check = None if plan.check_inputs is None else self._check(plan.check_inputs)
        return replace(plan, start=guarded, check_inputs=check)

    def _start(self, start: Start) -> Start:
        return lambda t_ns, state: _GuardedBehaviour(self._name, start, t_ns, state)

    def _check(self, check: Callable[[VehicleState], str]) -> Callable[[VehicleState], str]:
        def guarded(state: VehicleState) -> str:
            try:
                return check(state)
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
            except Exception as error:  # noqa: BLE001
                return Refusal(_report(self._name, "prepare", error))
            return prepared if isinstance(prepared, Refusal) else replace(prepared, start=self._start(prepared.start))

        def feedback(state: VehicleState) -> Any:
            try:
                return None if preparation.feedback is None else preparation.feedback(state)
            except Exception as error:  # noqa: BLE001
                _report(self._name, "feedback", error)
                return None

        return replace(preparation, work=work, start=start, feedback=feedback)


class _GuardedBehaviour:
    """A behaviour that ends as aborted when its own code raises."""

    def __init__(self, name: str, start: Start, t_ns: int, state: VehicleState) -> None:
        self._name = name
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
        """What a method of the behaviour returns; an exception, or another type, is an aborted goal.

        Args:
            optional: the method may return None.
        """
        try:
            move = call()
        except Exception as error:  # noqa: BLE001
            self._failure = _report(self._name, where, error)
            return Done("aborted", self._failure)
        if isinstance(move, Move | Done) or (optional and move is None):
            return move
        self._failure = f"{self._name} failed: {where} returned {type(move).__name__}, not a Move or a Done"
        return Done("aborted", self._failure)

    def remaining(self, state: VehicleState) -> Remaining | None:
        """Rest of the flight; None when the behaviour doesn't know it. An exception ends the goal in the next step."""
        if self._behaviour is None or self._failure:
            return None
        try:
            rest = remaining_of(self._behaviour, state)
        except Exception as error:  # noqa: BLE001
            self._failure = _report(self._name, "remaining", error)
            return None
        return rest if rest is not None and 0.0 <= rest.time_s < inf and 0.0 <= rest.distance_m < inf else None

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """Corners of the planned way; empty when the behaviour doesn't know it, or raises."""
        if self._behaviour is None or self._failure:
            return ()
        try:
            corners = path_of(self._behaviour, state)
            finite = all(isfinite(north_m + east_m + down_m) for north_m, east_m, down_m in corners)
        except Exception as error:  # noqa: BLE001
            self._failure = _report(self._name, "path", error)
            return ()
        return corners if finite else ()

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> Payload | None:
        """The behaviour's result; None when its own code raises, or has never started."""
        if self._behaviour is None:
            return None
        try:
            return self._behaviour.result(completed and not self._failure, pos_uav_ned_m)
        except Exception as error:  # noqa: BLE001
            _report(self._name, "result", error)
            return None


def _report(name: str, where: str, error: Exception) -> str:
    """Print the traceback; returns the sentence for the goal's sender."""
    print(f"{name}: {where} raised an exception", file=sys.stderr)
    traceback.print_exception(error)
    return f"{name} failed in {where}: {type(error).__name__}: {error}; the traceback is in the log of the server"
