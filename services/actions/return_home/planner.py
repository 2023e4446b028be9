"""Plans returns."""

from functools import partial

from jezero.schemas.goals import ReturnHomeGoal
from jezero.schemas.state import Status
from jezero.schemas.topics import ALTIMETER, RELATIVE, ROVER_ESTIMATE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Plan, Refusal, Selection, VehicleState
from jezero.services.actions.motion.limits import speed_refusal
from jezero.services.actions.return_home.behaviour import ReturnHome
from jezero.services.actions.return_home.config import ReturnHomeConfig

SELECTION = Selection(use_uwb=True, use_tag=True)


class ReturnHomePlanner:
    """Plans the way home; the place follows from what is known of the rover when the flight begins."""

    def __init__(self, settings: ReturnHomeConfig, config: ActionsConfig) -> None:
        self._settings = settings
        self._config = config

    def plan(self, goal: ReturnHomeGoal, status: Status) -> Plan | Refusal:
        """Plan a return; neither the battery nor the wind refuses it."""
        limits = self._config.vehicle.limits
        if reason := speed_refusal(goal.speed_mps, limits):
            return Refusal(reason)
        if goal.safe_height_m is not None and goal.safe_height_m > limits.altitude_max_m:
            return Refusal(f"safe_height_m {goal.safe_height_m:g} is above the limit of {limits.altitude_max_m:g} m")
        return Plan(
            partial(ReturnHome, goal, status.takeoff_ned_m, SELECTION, self._settings, self._config),
            lands=True,
            inputs=(ALTIMETER, RELATIVE, ROVER_ESTIMATE),
            selection=SELECTION,
            check_inputs=_wait_for_inputs,
        )


def _wait_for_inputs(state: VehicleState) -> str:
    """Refuse nothing: the vehicle returns with whatever inputs have come."""
    return ""
