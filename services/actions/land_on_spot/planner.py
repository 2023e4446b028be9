"""Plans landings: on the rover by the estimator, or on a spot by the vehicle's own position. Source: spec §8."""

from functools import partial

from jezero.schemas.actions import LandOnSpotGoal
from jezero.schemas.state import Status
from jezero.schemas.topics import ALTIMETER, RELATIVE, ROVER_ESTIMATE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig
from jezero.services.actions.land_on_spot.plain_landing import PlainLanding
from jezero.services.actions.land_on_spot.rover_landing import RoverLanding
from jezero.services.actions.motion.behaviour import Plan, Refusal, Selection
from jezero.services.actions.motion.limits import distance_refusal


class LandOnSpotPlanner:
    """Plans the kind of landing that the goal's sensors allow."""

    def __init__(self, settings: LandOnSpotConfig, config: ActionsConfig) -> None:
        self._settings = settings
        self._config = config

    def plan(self, goal: LandOnSpotGoal, status: Status) -> Plan | Refusal:
        """Plan a landing on the rover with UWB or the tag, else on the landing spot."""
        spot_ned_m = goal.landing_spot_ned_m
        if goal.use_uwb:
            unused = "the landing spot isn't used: UWB finds the rover" if spot_ned_m is not None else ""
            return self._on_rover(goal, Selection(True, goal.use_tag), unused)
        if goal.frame == "rover":
            return Refusal("without use_uwb the rover's position is not known: give the landing spot in frame 'world'")
        if spot_ned_m is None:
            needed = "roughly where the rover is" if goal.use_tag else "where to land"
            return Refusal(f"landing_spot_ned_m is missing: without use_uwb the vehicle needs to know {needed}")
        if reason := distance_refusal(spot_ned_m, self._config.vehicle.limits):
            return Refusal(reason)
        if goal.use_tag:
            return self._on_rover(goal, Selection(False, True, spot_ned_m))
        start = partial(PlainLanding, spot_ned_m, self._settings.plain, self._config)
        return Plan(start, inputs=(ALTIMETER,))

    def _on_rover(self, goal: LandOnSpotGoal, selection: Selection, warning: str = "") -> Plan:
        return Plan(
            partial(RoverLanding, selection, self._settings.rover, self._config.vehicle),
            warning=warning,
            inputs=(ALTIMETER, RELATIVE, ROVER_ESTIMATE),
            selection=selection,
        )
