"""Take off: climb straight up from where the vehicle stands."""

from typing import Any

from jezero.frames import Vec3
from jezero.schemas.actions import MoveFeedback, MoveResult, TakeoffGoal
from jezero.schemas.commands import Phase
from jezero.schemas.state import Status
from jezero.schemas.topics import Topic
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.behaviour import Done, Move, Selection, VehicleState, Verdict
from jezero.services.actions.lifecycle.capture import Capture
from jezero.services.actions.motion.straight_path import Leg


class Climb:
    """The way up from the ground; waits at its foot until the vehicle is armed.

    Args:
        altitude_m: above the present point, positive up.
    """

    def __init__(self, t_ns: int, altitude_m: float, state: VehicleState, config: ActionsConfig) -> None:
        x, y, z = state.pos_uav_ned_m
        self.leg = Leg(
            t_ns,
            (x, y, z),
            (x, y, z - altitude_m),
            speed_mps=config.move.speed_up_mps,
            lead_max_m=config.takeoff.lead_m,
            config=config.move,
            yaw_start_rad=state.yaw_rad,
        )
        self._arm_by_ns = t_ns + int(config.takeoff.arming_timeout_s * NS_PER_S)

    def step(self, t_ns: int, state: VehicleState) -> str:
        """Go on climbing; returns why it can't, or ""."""
        if not state.armed:
            self.leg.wait(t_ns, state)
            return "the vehicle was not armed in time" if t_ns > self._arm_by_ns else ""
        self.leg.step(t_ns, state)
        return self.leg.stuck(t_ns)


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
        leg = self._climb.leg
        if problem:
            return Done("aborted", f"takeoff: {problem}")
        if leg.reached:
            return Done("succeeded", hover_pos_ned_m=leg.end_ned_m)
        return follow(leg, Phase.TAKEOFF, leg.left_m, state)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)


def follow(leg: Leg, phase: Phase, distance_m: float, state: VehicleState) -> Move:
    """The setpoint of a leg's reference, with the distance to the goal's point."""
    return Move(
        phase,
        MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=distance_m),
        leg.pos_ned_m,
        leg.vel_ned_mps,
        leg.acc_ned_mps2,
        leg.yaw_rad,
    )
