"""The action `takeoff`: climb straight up from the vehicle's place on the ground."""

from functools import partial

from jezero.base.frames import Vec3, distance, norm
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
DRIFT_MAX_M = 0.3
"""A vehicle that stands and is farther than this from its way up has not moved, but its position estimate has."""
STANDS_MPS = 0.2
"""A vehicle that stands is slower by its estimate; one that gusts carry over the ground is faster."""
DRIFT_TIMEOUT_S = 10.0
"""Longest time for which the climb begins anew because of that."""


class Climb:
    """A climb straight up from the ground, which waits at its start until the vehicle is armed.

    A position estimate that has just converged moves by a metre or two while the vehicle still stands. A reference that
    waited for the vehicle to come back to the way up would wait for ever. So the climb begins anew at the estimate, as
    long as the reference is low.

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
        self.z_ground_ned_m = state.pos_uav_ned_m[2] if z_ground_ned_m is None else z_ground_ned_m
        self._altitude_m = altitude_m
        self._config = config
        self._from_ground = z_ground_ned_m is None
        self._drifted_m = 0.0
        self._armed_ns: int | None = None
        self._arm_by_ns = t_ns + int(ARMING_TIMEOUT_S * NS_PER_S)
        self._begin(t_ns, state.pos_uav_ned_m, state.yaw_rad)

    def _begin(self, t_ns: int, start_ned_m: Vec3, yaw_rad: float) -> None:
        self._start_ned_m = start_ned_m
        self.path = StraightPath(
            t_ns,
            start_ned_m,
            (start_ned_m[0], start_ned_m[1], self.z_ground_ned_m - self._altitude_m),
            speed_mps=self._config.speed_up_mps,
            lead_max_m=LEAD_M,
            config=self._config,
            yaw_start_rad=yaw_rad,
        )

    def remaining(self) -> Remaining:
        """Rest of the climb, with the time for arming before it begins."""
        waits = self.path.pos_ned_m == self._start_ned_m
        return self.path.remaining() + Remaining(ARMING_S if waits else 0.0, 0.0)

    def step(self, t_ns: int, state: VehicleState) -> str:
        """Move the reference on; returns the reason why the climb must be aborted, or ""."""
        if not state.armed:
            self.path.wait(t_ns, state)
            return "the vehicle was not armed in time" if t_ns > self._arm_by_ns else ""
        if self._armed_ns is None:
            self._armed_ns = t_ns
        stands = state.landed and norm(state.vel_uav_ned_mps) < STANDS_MPS
        drift_m = self._drift_m(state.pos_uav_ned_m) if self._from_ground and stands else 0.0
        if drift_m > DRIFT_MAX_M:
            self._drifted_m += drift_m
            if t_ns - self._armed_ns > DRIFT_TIMEOUT_S * NS_PER_S:
                return f"the position estimate doesn't settle: it moved by {self._drifted_m:.1f} m at the ground"
            self.z_ground_ned_m = state.pos_uav_ned_m[2]
            self._begin(t_ns, state.pos_uav_ned_m, self.path.yaw_rad)
        self.path.step(t_ns, state)
        return self.path.stuck(t_ns)

    def _drift_m(self, pos_ned_m: Vec3) -> float:
        """Distance of the estimate from the way between the start and the reference; 0 once the reference is high."""
        (x, y, z_low), (_, _, z_high) = self._start_ned_m, self.path.pos_ned_m
        if z_low - z_high > LEAD_M:
            return 0.0
        return distance(pos_ned_m, (x, y, min(max(pos_ned_m[2], z_high), z_low)))


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
