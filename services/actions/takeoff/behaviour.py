"""Take off: climb straight up from where the vehicle stands."""

from typing import Any

from jezero.frames import Vec3
from jezero.schemas.actions import MoveFeedback, MoveResult, TakeoffGoal
from jezero.schemas.commands import Phase
from jezero.schemas.state import Status
from jezero.schemas.topics import Topic
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.behaviour import Done, Move, Selection, VehicleState, Verdict
from jezero.services.actions.lifecycle.capture import Capture
from jezero.services.actions.takeoff.climb import Climb


class Takeoff:
    """Climbs to `altitude_m` above the take-off point."""

    inputs: tuple[Topic[Any], ...] = ()
    selection: Selection | None = None
    rate_hz: float | None = None
    capture: Capture | None = None

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config
        self._climb: Climb | None = None

    def check(self, goal: TakeoffGoal, status: Status) -> Verdict:
        low, high = self._config.takeoff.altitude_min_m, self._config.limits.altitude_max_m
        if not low <= goal.altitude_m <= high:
            return Verdict(
                refusal=f"altitude {goal.altitude_m:g} m is not within {low:g} to {high:g} m above the ground"
            )
        return Verdict(do_takeoff=True)

    def start(self, t_ns: int, goal: TakeoffGoal, state: VehicleState) -> None:
        self._climb = Climb(t_ns, goal.altitude_m, state, self._config)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        assert self._climb is not None, "step before start"
        problem = self._climb.step(t_ns, state)
        path = self._climb.path
        if problem:
            return Done("aborted", f"takeoff: {problem}")
        if path.reached:
            return Done("succeeded", hover_pos_ned_m=path.end_ned_m)
        return path.move(Phase.TAKEOFF, MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=path.left_m))

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)
