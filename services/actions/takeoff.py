"""The action `takeoff`: climb straight up from the vehicle's place on the ground."""

from functools import partial

from jezero.base.frames import Vec3
from jezero.schemas.commands import Phase
from jezero.schemas.goals import MoveFeedback, MoveResult, TakeoffGoal
from jezero.schemas.state import Status
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Refusal, Remaining, VehicleState
from jezero.services.actions.motion.config import MoveConfig
from jezero.services.actions.motion.straight_path import StraightPath

LEAD_M = 0.6
"""Height to which the reference rises before the vehicle leaves the ground."""
ARMING_S, ARMING_TIMEOUT_S = 1.0, 10.0
"""Usual and greatest time until the motors turn."""


class Climb:
    """A climb straight up from the ground, which waits at its start until the vehicle is armed.

    Args:
        altitude_m: above the ground, positive up.
        z_ground_ned_m: of the take-off point; None: the vehicle stands there.

    Attributes:
        path: of the climb.
        z_ground_ned_m: of the take-off point.
    """

    def __init__(
        self,
        t_ns: int,
        altitude_m: float,
        state: VehicleState,
        config: MoveConfig,
        z_ground_ned_m: float | None = None,
    ) -> None:
        x, y, z = self._start_ned_m = state.pos_uav_ned_m
        self.z_ground_ned_m = z if z_ground_ned_m is None else z_ground_ned_m
        self.path = StraightPath(
            t_ns,
            (x, y, z),
            (x, y, self.z_ground_ned_m - altitude_m),
            speed_mps=config.speed_up_mps,
            lead_max_m=LEAD_M,
            config=config,
            yaw_start_rad=state.yaw_rad,
        )
        self._arm_by_ns = t_ns + int(ARMING_TIMEOUT_S * NS_PER_S)

    def remaining(self) -> Remaining:
        """Rest of the climb, with the time for arming before it begins."""
        waits = self.path.pos_ned_m == self._start_ned_m
        return self.path.remaining() + Remaining(ARMING_S if waits else 0.0, 0.0)

    def step(self, t_ns: int, state: VehicleState) -> str:
        """Move the reference on; returns the reason why the climb must be aborted, or ""."""
        if not state.armed:
            self.path.wait(t_ns, state)
            return "the vehicle was not armed in time" if t_ns > self._arm_by_ns else ""
        self.path.step(t_ns, state)
        return self.path.stuck(t_ns)


class Takeoff:
    """Climbs to `altitude_m` above the take-off point.

    Args:
        z_ground_ned_m: of the take-off point of a vehicle that has left it; None: the vehicle stands there.
    """

    def __init__(
        self, goal: TakeoffGoal, config: MoveConfig, z_ground_ned_m: float | None, t_ns: int, state: VehicleState
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


class TakeoffPlanner:
    """Plans climbs to an altitude within the limits."""

    def __init__(self, config: ActionsConfig) -> None:
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
        start = partial(Takeoff, goal, self._config.move, z_ground_ned_m)
        return Plan(start, do_takeoff=True, override=goal.override, landing_from_m=goal.altitude_m)
