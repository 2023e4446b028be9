"""Land: on the rover by what the estimator sees of it, or on a spot by the vehicle's own position. Source: spec §8."""

from typing import Any

from jezero.frames import Vec3
from jezero.schemas.actions import LandOnSpotGoal, LandResult
from jezero.schemas.state import Status
from jezero.schemas.topics import Topic
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.plain_landing import PlainLanding
from jezero.services.actions.land_on_spot.rover_landing import RoverLanding
from jezero.services.actions.lifecycle.behaviour import Done, Move, Selection, VehicleState, Verdict
from jezero.services.actions.lifecycle.capture import Capture
from jezero.services.actions.motion.limits import distance_refusal


class LandOnSpot:
    """Picks the landing that the goal's sensors allow."""

    rate_hz: float | None = None
    capture: Capture | None = None

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config
        self._landing: PlainLanding | RoverLanding | None = None

    @property
    def inputs(self) -> tuple[Topic[Any], ...]:
        return self._chosen.inputs

    @property
    def selection(self) -> Selection | None:
        return self._chosen.selection

    def check(self, goal: LandOnSpotGoal, status: Status) -> Verdict:
        if refusal := self._refusal(goal):
            return Verdict(refusal=refusal)
        sees = goal.use_uwb or goal.use_tag
        self._landing = RoverLanding(self._config, goal) if sees else PlainLanding(self._config)
        unused = goal.use_uwb and goal.landing_spot_ned_m is not None
        return Verdict(warning="the landing spot isn't used: UWB finds the rover" if unused else "")

    def start(self, t_ns: int, goal: LandOnSpotGoal, state: VehicleState) -> None:
        self._chosen.start(t_ns, goal, state)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        return self._chosen.step(t_ns, state)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> LandResult:
        return self._chosen.result(completed, pos_uav_ned_m)

    @property
    def _chosen(self) -> PlainLanding | RoverLanding:
        assert self._landing is not None, "used before check"
        return self._landing

    def _refusal(self, goal: LandOnSpotGoal) -> str:
        spot_ned_m = goal.landing_spot_ned_m
        if goal.use_uwb:
            return ""
        if goal.frame == "rover":
            return "without use_uwb nothing knows where the rover is: give the landing spot in frame 'world'"
        if spot_ned_m is None and goal.use_tag:
            return "landing_spot_ned_m is missing: without use_uwb the vehicle must be told roughly where the rover is"
        if spot_ned_m is None:
            return "landing_spot_ned_m is missing: without use_uwb the vehicle must be told where to land"
        return distance_refusal(spot_ned_m, self._config.limits)
