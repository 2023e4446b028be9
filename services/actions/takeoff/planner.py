"""Plans takeoffs."""

from functools import partial

from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.state import Status
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Plan, Refusal
from jezero.services.actions.takeoff.behaviour import Takeoff
from jezero.services.actions.takeoff.config import TakeoffConfig


class TakeoffPlanner:
    """Plans climbs to an altitude within the limits."""

    def __init__(self, settings: TakeoffConfig, config: ActionsConfig) -> None:
        self._config = config

    def plan(self, goal: TakeoffGoal, status: Status) -> Plan | Refusal:
        """Plan a climb, if its altitude is within the limits."""
        return self._plan(goal, None)

    def replan(self, goal: TakeoffGoal, status: Status, running: Takeoff) -> Plan | Refusal:
        """Plan the rest of a climb that is under way."""
        return self._plan(goal, running.z_ground_ned_m)

    def _plan(self, goal: TakeoffGoal, z_ground_ned_m: float | None) -> Plan | Refusal:
        limits = self._config.vehicle.limits
        low, high = limits.altitude_min_m, limits.altitude_max_m
        if not low <= goal.altitude_m <= high:
            return Refusal(f"altitude {goal.altitude_m:g} m is not within {low:g} to {high:g} m above the ground")
        start = partial(Takeoff, goal, self._config, z_ground_ned_m)
        return Plan(start, do_takeoff=True, override=goal.override, landing_from_m=goal.altitude_m)
