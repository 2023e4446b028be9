"""Plans flights to a target."""

from functools import partial

from msgspec.structs import replace

from jezero.frames import add, altitude_m
from jezero.schemas.goals import GoToGoal
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import RELATIVE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.go_to.behaviour import GoTo
from jezero.services.actions.go_to.config import GoToConfig
from jezero.services.actions.motion.behaviour import Plan, Refusal, VehicleState
from jezero.services.actions.motion.limits import beyond_limits, point_refusal, speed_refusal
from jezero.services.actions.motion.rover_frame import loss_reason, rover_position


class GoToPlanner:
    """Plans straight flights to a target within the limits."""

    def __init__(self, settings: GoToConfig, config: ActionsConfig) -> None:
        self._settings = settings
        self._config = config

    def plan(self, goal: GoToGoal, status: Status) -> Plan | Refusal:
        """Plan a flight, after a takeoff when the goal wants one and the vehicle is on the ground."""
        limits = self._config.vehicle.limits
        if reason := point_refusal(goal.target_ned_m, limits) or speed_refusal(goal.speed_mps, limits):
            return Refusal(reason)
        do_takeoff = goal.do_takeoff and status.code == StatusCode.IDLE
        in_rover_frame = goal.frame == "rover"
        return Plan(
            partial(GoTo, goal, do_takeoff, self._settings, self._config),
            warning="already flying: the takeoff is left out" if goal.do_takeoff and not do_takeoff else "",
            do_takeoff=do_takeoff,
            override=goal.override,
            landing_from_m=altitude_m(goal.target_ned_m[2]) if do_takeoff else 0.0,
            inputs=(RELATIVE,) if in_rover_frame else (),
            check_inputs=partial(self._check_inputs, goal) if in_rover_frame else None,
        )

    def replan(self, goal: GoToGoal, status: Status, running: GoTo) -> Plan | Refusal:
        """Plan the straight flight from where the vehicle hovers to the changed target."""
        if running.climbs:
            return Refusal("the vehicle still takes off: modify the goal when it flies to its target")
        return self.plan(replace(goal, do_takeoff=False), status)

    def _check_inputs(self, goal: GoToGoal, state: VehicleState) -> str:
        """Reason why a target in the rover's frame can't be flown to, or ""."""
        relative = state.relative
        if relative is None or not relative.valid:
            return loss_reason(relative)
        return beyond_limits(add(goal.target_ned_m, rover_position(state, relative)), self._config.vehicle.limits)
