"""The plan of a mission on a running stack: each goal from where the one before ends, nothing flown."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import Goal
from jezero.schemas.mission import Mission, WaitStep
from jezero.schemas.rows import Action

Position = tuple[float, float, float]
Plan = Callable[[Action[Any], Goal], PlanReply]


@dataclass(frozen=True)
class StepPlan:
    """The plan of one step.

    Attributes:
        reply: the action server's; None for a wait.
        duration_s: duration of the step; None where it is unknown.
        problem: why the goal would be refused, or can't be planned now; "" for a plan.
        mistake: the problem is the mission's, and not a measurement that is missing now.
    """

    reply: PlanReply | None = None
    duration_s: float | None = None
    problem: str = ""
    mistake: bool = False


def plan_mission(
    mission: Mission, actions: Mapping[str, Action[Any]], plan: Plan, start_ned_m: Position
) -> Iterator[StepPlan]:
    """Yield the plan of each step, in their order.

    The first goal begins as the vehicle is now, each later one in a hover where the last one with a known end does.

    Args:
        plan: asks the action server for a plan, as `Vehicle.plan` does.
        start_ned_m: position of the vehicle.
    """
    begin_ned_m: Position | None = None
    for step in mission.steps:
        if isinstance(step, WaitStep):
            yield StepPlan(duration_s=step.duration_s)
            continue
        action = actions[step.action]
        goal: Goal = msgspec.convert({**step.goal, "plan_from_ned_m": begin_ned_m}, action.goal_type)
        reply = plan(action, goal)
        yield StepPlan(reply, reply.duration_s, reply.reason, not reply.accepted and not reply.input_missing)
        begin_ned_m = reply.path_ned_m[-1] if reply.path_ned_m else begin_ned_m or start_ned_m
