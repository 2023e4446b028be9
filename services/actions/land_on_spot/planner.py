"""The action `land_on_spot`: plans a landing on the rover by the estimator, or on a spot by the vehicle's own position.

Source: spec §8.
"""

from functools import partial

from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.state import Status
from jezero.schemas.topics import ALTIMETER, RELATIVE, ROVER_ESTIMATE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.landing_watch import wind_refusal
from jezero.services.actions.land_on_spot.plain_landing import PlainLanding
from jezero.services.actions.land_on_spot.rover_landing import RoverLanding
from jezero.services.actions.motion.behaviour import Plan, Refusal, Selection
from jezero.services.actions.motion.limits import distance_refusal


class LandOnSpotPlanner:
    """Plans the kind of landing that the goal's sensors allow."""

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config

    def plan(self, goal: LandOnSpotGoal, status: Status) -> Plan | Refusal:
        """Plan a landing on the rover with UWB or the tag, else on the landing spot."""
        wind_max_mps = self._config.land_on_spot.wind_max_mps
        if not goal.force and (reason := wind_refusal(status.wind_ned_mps, status.std_gust_mps, wind_max_mps)):
            return Refusal(reason)
        return self._on_spot(goal)

    def replan(self, goal: LandOnSpotGoal, status: Status, running: PlainLanding | RoverLanding) -> Plan | Refusal:
        """Plan the landing on another spot, from where the vehicle hovers on its way to the first one."""
        if not isinstance(running, PlainLanding):
            return Refusal("the sensors find the rover: only a landing without UWB and tags can change its spot")
        if not running.approaches:
            return Refusal("the vehicle descends onto its spot already: cancel the goal, and land again elsewhere")
        return self.plan(goal, status)

    def _on_spot(self, goal: LandOnSpotGoal) -> Plan | Refusal:
        """Plan by the sensors that the goal selects, whatever the wind is."""
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
        start = partial(PlainLanding, spot_ned_m, self._config, goal.force)
        return Plan(start, lands=True, inputs=(ALTIMETER,))

    def _on_rover(self, goal: LandOnSpotGoal, selection: Selection, warning: str = "") -> Plan:
        return Plan(
            partial(RoverLanding, selection, self._config.land_on_spot, self._config.vehicle, goal.force),
            warning=warning,
            lands=True,
            inputs=(ALTIMETER, RELATIVE, ROVER_ESTIMATE),
            selection=selection,
        )
