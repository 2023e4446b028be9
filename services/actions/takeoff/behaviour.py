"""Take off: climb straight up from the vehicle's place on the ground."""

from jezero.frames import Vec3
from jezero.schemas.commands import Phase
from jezero.schemas.goals import MoveFeedback, MoveResult, TakeoffGoal
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Done, Move, Remaining, VehicleState
from jezero.services.actions.takeoff.climb import Climb


class Takeoff:
    """Climbs to `altitude_m` above the take-off point.

    Args:
        z_ground_ned_m: of the take-off point of a vehicle that has left it; None: the vehicle stands there.
    """

    def __init__(
        self, goal: TakeoffGoal, config: ActionsConfig, z_ground_ned_m: float | None, t_ns: int, state: VehicleState
    ) -> None:
        self._climb = Climb(t_ns, goal.altitude_m, state, config, z_ground_ned_m)

    @property
    def z_ground_ned_m(self) -> float:
        """z of the take-off point in the world frame."""
        return self._climb.z_ground_ned_m

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        problem = self._climb.step(t_ns, state)
        path = self._climb.path
        if problem:
            return Done("aborted", f"takeoff: {problem}")
        if path.reached:
            return Done("succeeded", hover_pos_ned_m=path.end_ned_m)
        return path.move(Phase.TAKEOFF, MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=path.left_m))

    def remaining(self, state: VehicleState) -> Remaining:
        return self._climb.remaining()

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        return state.pos_uav_ned_m, self._climb.path.end_ned_m

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)
