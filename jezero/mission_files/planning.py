"""The judged plan of a mission: each goal from where the one before ends, and how long the battery lasts.

Nothing is flown.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import msgspec

from jezero.base.frames import Vec3, distance, scale, subtract
from jezero.base.vehicle_config import VehicleConfig, flight_cost
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import Goal, ReturnHomeGoal
from jezero.schemas.mission import GoalStep, Mission, Step, WaitStep
from jezero.schemas.rows import Action
from jezero.schemas.topics import LAND_ON_SPOT, RETURN_HOME, TAKEOFF

Plan = Callable[[Action[Any], Goal], PlanReply]
STILL: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Start:
    """The vehicle before a mission, and what surrounds it.

    Attributes:
        vehicle: with its battery and its drag.
        pos_ned_m: position.
        flies: whether it hovers there; else it stands.
        charge: fraction of the battery's capacity.
        wind_ned_mps: mean wind that the mission is planned for.
        way_margin: the vehicle turns home when its battery holds this many times the charge that the way home needs.
    """

    vehicle: VehicleConfig
    pos_ned_m: Vec3 = STILL
    flies: bool = False
    charge: float = 1.0
    wind_ned_mps: Vec3 = STILL
    way_margin: float = 1.3


@dataclass(frozen=True)
class StepPlan:
    """The plan of one step.

    Attributes:
        reply: the action server's; None for a wait.
        duration_s: duration of the step; None where it is unknown.
        problem: why the goal would be refused or would not end, or can't be planned now; "" for a plan.
        mistake: the problem is the mission's, and not a measurement that is missing now.
        charge_used: fraction of the battery's capacity that the step uses; None where it is unknown.
        charge_left: fraction that is left after it.
    """

    reply: PlanReply | None = None
    duration_s: float | None = None
    problem: str = ""
    mistake: bool = False
    charge_used: float | None = None
    charge_left: float = 1.0


def plan_mission(mission: Mission, actions: Mapping[str, Action[Any]], plan: Plan, start: Start) -> Iterator[StepPlan]:
    """Yield the plan of each step, in their order.

    Each goal begins where the last one with a known end does, and in the state that the last one leaves: in a hover, or
    on the ground.

    Args:
        plan: plans a goal, as `Vehicle.plan` does; a refusal is a reply too.
    """
    walk = _Walk(mission, actions, plan, start)
    for number, step in enumerate(mission.steps, start=1):
        yield walk.take(number, step)


class _Walk:
    """Goes through a mission step by step."""

    def __init__(self, mission: Mission, actions: Mapping[str, Action[Any]], plan: Plan, start: Start) -> None:
        self._mission, self._actions, self._plan, self._start = mission, actions, plan, start
        self._pos_ned_m, self._flies, self._charge = start.pos_ned_m, start.flies, start.charge
        self._changed_by = 0
        """Number of the step that has taken off or landed last; 0 for the start."""
        self._too_low = False
        """Whether a step was found at which the battery ends the mission."""

    def take(self, number: int, step: Step) -> StepPlan:
        """The plan of the next step; the walk goes on from its end."""
        if isinstance(step, WaitStep):
            cost = flight_cost(step.duration_s, STILL, self._start.wind_ned_mps, self._start.vehicle)
            used = self._start.vehicle.battery.used(cost.hover_s) if self._flies else 0.0
            return self._judged(StepPlan(duration_s=step.duration_s, charge_used=used), ends_on_ground=False)
        takes_off = step.action == TAKEOFF.name or bool(step.goal.get("do_takeoff"))
        lands = step.action in (LAND_ON_SPOT.name, RETURN_HOME.name)
        refusal = self._state_refusal(step, takes_off=takes_off)
        action = self._actions[step.action]
        goal: Goal = msgspec.convert({**step.goal, "plan_from_ned_m": self._pos_ned_m}, action.goal_type)
        if isinstance(goal, ReturnHomeGoal) and not goal.rally_points_ned_m:
            goal = msgspec.structs.replace(goal, rally_points_ned_m=self._mission.rally_points_ned_m)
        reply = self._plan(action, goal)
        if reply.path_ned_m:
            self._pos_ned_m = reply.path_ned_m[-1]
        if takes_off or lands:
            self._flies, self._changed_by = not lands, number
        mistake = bool(refusal) or not (reply.accepted or reply.input_missing)
        refusal = refusal or ("" if reply.accepted else reply.reason)
        found = StepPlan(reply, reply.duration_s, refusal, mistake, self._used(reply))
        return self._judged(found, ends_on_ground=lands)

    def _state_refusal(self, step: GoalStep, *, takes_off: bool) -> str:
        """Why a step can't begin in the state that the one before leaves, or ""."""
        since = f"after step {self._changed_by}" if self._changed_by else "before the mission"
        if self._flies and step.action == TAKEOFF.name:
            return f"the vehicle flies already {since}: leave this takeoff out, or climb with a go_to"
        if not self._flies and not takes_off:
            return f"the vehicle stands on the ground {since}: put a takeoff before this step"
        return ""

    def _used(self, reply: PlanReply) -> float | None:
        """Charge that a planned flight uses in the wind."""
        if not reply.accepted or reply.duration_s is None:
            return None
        length_m = sum(distance(begin, end) for begin, end in pairwise(reply.path_ned_m))
        wind_ned_mps, vehicle = self._start.wind_ned_mps, self._start.vehicle
        if length_m < 1.0:
            return vehicle.battery.used(flight_cost(reply.duration_s, STILL, wind_ned_mps, vehicle).hover_s)
        hover_s = 0.0
        for begin, end in pairwise(reply.path_ned_m):
            vel_ned_mps = scale(subtract(end, begin), length_m / reply.duration_s / max(distance(begin, end), 1e-6))
            time_s = reply.duration_s * distance(begin, end) / length_m
            hover_s += flight_cost(time_s, vel_ned_mps, wind_ned_mps, vehicle).hover_s
        return vehicle.battery.used(hover_s)

    def _judged(self, found: StepPlan, *, ends_on_ground: bool) -> StepPlan:
        """The plan with the charge after it, and with the battery's reason to end the mission in this step."""
        self._charge = max(self._charge - (found.charge_used or 0.0), 0.0)
        problem = "" if found.problem or self._too_low else self._battery_problem(ends_on_ground=ends_on_ground)
        self._too_low |= bool(problem)
        return StepPlan(
            found.reply,
            found.duration_s,
            found.problem or problem,
            found.mistake or bool(problem),
            found.charge_used,
            self._charge,
        )

    def _battery_problem(self, *, ends_on_ground: bool) -> str:
        reserve, left = self._start.vehicle.battery.reserve, f"{self._charge:.0%}"
        if ends_on_ground or not self._flies:
            if self._charge >= reserve or not ends_on_ground:
                return ""
            return f"the battery would have {left} after this landing, and {reserve:.0%} is its reserve"
        home = ReturnHomeGoal(plan_from_ned_m=self._pos_ned_m, rally_points_ned_m=self._mission.rally_points_ned_m)
        used = self._used(self._plan(RETURN_HOME, home))
        needed = reserve + self._start.way_margin * (used or 0.0)
        if used is None or self._charge >= needed:
            return ""
        return (
            f"the mission would end in this step: the battery would have {left} after it, the way home needs "
            f"{needed:.0%}, and the vehicle returns before that"
        )
