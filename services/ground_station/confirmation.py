"""The confirmation of a goal: what it would take, in words on the button that flies it."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any

from jezero.schemas.actions import PlanReply
from jezero.services.ground_station.words import duration

TIMEOUT_S = 60.0
"""A plan that is older may not hold any more: the vehicle has moved, and its battery is emptier."""


@dataclass(frozen=True)
class Confirmation:
    """A goal that was planned and waits for the second click.

    Attributes:
        goal: its fields, as they were planned.
        typed: what was typed for it. The goal can't be compared: its z follows the estimate of the start's height.
        plan: its plan.
        t_s: time of the plan, on the clock that the caller uses.
    """

    goal: Mapping[str, Any]
    typed: Mapping[str, Any]
    plan: PlanReply
    t_s: float

    def holds_for(self, typed: Mapping[str, Any], now_s: float) -> bool:
        """Whether the second click may fly the plan of what the form has now."""
        return typed == self.typed and not self.is_old(now_s)

    def is_old(self, now_s: float) -> bool:
        """Whether it is too late for the second click."""
        return now_s - self.t_s > TIMEOUT_S

    def words(self, start_z_ned_m: float) -> str:
        """What the goal would take, e.g. "Confirm: 34 s, 41 m, 5 % of the battery, up to 6 m".

        Args:
            start_z_ned_m: z of the place from which heights are counted.
        """
        plan, parts = self.plan, []
        if plan.duration_s is not None:
            parts.append(duration(plan.duration_s))
        if plan.distance_m is not None:
            parts.append(f"{plan.distance_m:.0f} m")
        if plan.battery_used is not None:
            parts.append(f"{ceil(round(100.0 * plan.battery_used, 3))} % of the battery")
        if plan.path_ned_m:
            parts.append(f"up to {round(highest_m(plan, start_z_ned_m), 1):g} m")
        return f"Confirm: {', '.join(parts)}" if parts else "Confirm"


def highest_m(plan: PlanReply, start_z_ned_m: float) -> float:
    """Height of the highest point of a plan's way above the start."""
    return start_z_ned_m - min(point[2] for point in plan.path_ned_m)
