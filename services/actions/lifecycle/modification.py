"""The change of a goal's fields while it is flown.

The vehicle brakes. The changed goal is planned from there, with the checks of a new goal, and goes on by the new plan;
when it is refused, the old one goes on. So nothing jumps, whatever changes.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from jezero.frames import Vec3, add
from jezero.runtime.service import Inbox, Output, Reply
from jezero.schemas.actions import ModifyReply
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action
from jezero.schemas.topics import STATUS
from jezero.services.actions.lifecycle.battery_reserve import battery_refusal
from jezero.services.actions.lifecycle.fence_check import fence_refusal
from jezero.services.actions.lifecycle.goal_flight import GoalFlight
from jezero.services.actions.lifecycle.guard import GuardedPlanner
from jezero.services.actions.lifecycle.preparation_run import PreparationRun
from jezero.services.actions.motion.behaviour import (
    Plan,
    Preparation,
    Refusal,
    Start,
    VehicleState,
    path_of,
    remaining_of,
)
from jezero.vehicle_config import BatteryConfig

NO_STATUS = "the vehicle's status is unknown"


class Modification:
    """One change of a goal that is flown, from its request to its reply.

    Args:
        request_id: of the request.
        goal: with the changed fields.

    Attributes:
        goal: with the changed fields.
        over: whether the reply is sent.
        in_force: whether the goal goes on with the changed fields.
        path_ned_m: (n, 3) corners of the new way, when they are in force.
    """

    def __init__(
        self,
        action: Action[Any],
        request_id: int,
        goal_id: str,
        goal: Goal,
        planner: GuardedPlanner,
        battery: BatteryConfig,
    ) -> None:
        self.goal = goal
        self.over = self.in_force = False
        self.path_ned_m: tuple[Vec3, ...] = ()
        self._action = action
        self._request_id = request_id
        self._goal_id = goal_id
        self._planner = planner
        self._battery = battery
        self._plan: Plan | None = None
        self._preparation: PreparationRun | None = None
        self._taken = 0
        """Number of pictures when the plan was made."""

    def step(self, t_ns: int, inbox: Inbox, flight: GoalFlight) -> Iterator[Output]:
        """Go on with the change; the flight has made its own step before."""
        if flight.stage != "flying":
            yield from self._refuse("the goal has ended", flight)
            return
        state = flight.brake(t_ns, inbox)
        if isinstance(state, str):
            if state:
                yield from self._refuse(state, flight)
            return
        if self._preparation is not None and flight.taken != self._taken:
            # A point was passed while the vehicle came to rest: the plan would take its picture again.
            yield from self._preparation.end()
            self._preparation = None
        if self._preparation is None:
            yield from self._begin(t_ns, inbox, flight, state)
        else:
            yield from self._await_preparation(t_ns, inbox, flight, state, self._preparation)

    def _begin(self, t_ns: int, inbox: Inbox, flight: GoalFlight, state: VehicleState) -> Iterator[Output]:
        """Plan from where the vehicle hovers, at once or in the background."""
        self._taken = flight.taken
        status = inbox.latest(STATUS)
        plan = Refusal(NO_STATUS) if status is None else self._planner.replan(self.goal, status, flight.behaviour)
        if isinstance(plan, Plan) and plan.check_inputs is not None and (reason := plan.check_inputs(state)):
            plan = Refusal(reason)
        if isinstance(plan, Refusal):
            yield from self._refuse(plan.reason, flight)
            return
        self._plan = plan
        if isinstance(plan.start, Preparation):
            self._preparation = PreparationRun(t_ns, self._action, self._goal_id, plan.start, state)
            yield from self._preparation.begin()
        else:
            yield from self._take_over(t_ns, inbox, flight, state, plan.start, plan.warning)

    def _await_preparation(
        self, t_ns: int, inbox: Inbox, flight: GoalFlight, state: VehicleState, preparation: PreparationRun
    ) -> Iterator[Output]:
        outcome = preparation.outcome(t_ns, inbox)
        if isinstance(outcome, Refusal):
            yield from self._refuse(outcome.reason, flight)
        elif outcome is not None:
            yield from self._take_over(t_ns, inbox, flight, state, outcome.start, outcome.warning)

    def _take_over(
        self, t_ns: int, inbox: Inbox, flight: GoalFlight, state: VehicleState, start: Start, warning: str
    ) -> Iterator[Output]:
        """Start the new behaviour, if its way stays inside the fence and the battery holds its flight."""
        behaviour = start(flight.goal_time_ns(t_ns), state)
        path_ned_m = tuple(add(point_m, state.shift_ned_m) for point_m in path_of(behaviour, state))
        if self._plan is not None and (reason := fence_refusal(path_ned_m, self._plan, inbox)):
            yield from self._refuse(reason, flight)
            return
        status, rest = inbox.latest(STATUS), remaining_of(behaviour, state)
        if self._plan is not None and not self._plan.lands and status is not None and rest is not None:
            reason = battery_refusal(rest.time_s, self._plan.landing_from_m, status.battery, self._battery)
            if reason:
                yield from self._refuse(reason, flight)
                return
        flight.go_on(behaviour)
        self.path_ned_m = path_ned_m
        self.over = self.in_force = True
        yield Reply(self._request_id, ModifyReply(modified=True, warning=warning))

    def _refuse(self, reason: str, flight: GoalFlight) -> Iterator[Output]:
        """Go on with the old fields."""
        flight.go_on()
        self.over = True
        if self._preparation is not None:
            yield from self._preparation.end()
        yield Reply(self._request_id, ModifyReply(modified=False, reason=reason))


def changed_goal(action: Action[Any], goal: Goal, fields: Mapping[str, Any]) -> Goal | Refusal:
    """The goal with other values in some fields, or the reason why these can't change."""
    can = f"{action.name} can change {', '.join(action.changeable)}" if action.changeable else ""
    can = can or f"no field of {action.name} can change"
    if not fields:
        return Refusal(f"no field is given: while it is flown, {can}")
    for name in fields:
        if name not in goal.__struct_fields__:
            return Refusal(f"{action.name} has no field {name!r}: while it is flown, {can}")
        if name not in action.changeable:
            return Refusal(f"{name} can't change while the goal is flown: {can}")
    try:
        changed: Goal = msgspec.convert({**msgspec.to_builtins(goal), **fields}, action.goal_type)
    except msgspec.ValidationError as error:
        return Refusal(f"{action.name}: {error}")
    return changed
