"""Go to a target: in a straight line, after a takeoff when asked for."""

from typing import Any

from jezero.frames import Vec3
from jezero.schemas.actions import GoToGoal, MoveResult
from jezero.schemas.commands import Phase
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import Topic
from jezero.services.actions.behaviour import Done, Move, VehicleState, Verdict
from jezero.services.actions.checks import ROVER_FRAME, point_refusal, speed_refusal
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.leg import Leg
from jezero.services.actions.takeoff import Climb, follow


class GoTo:
    """Flies to `target_ned_m`. Source: thesis algorithm 3."""

    inputs: tuple[Topic[Any], ...] = ()

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config
        self._goal: GoToGoal | None = None
        self._climb: Climb | None = None
        self._leg: Leg | None = None
        self._take_off = False

    def check(self, goal: GoToGoal, status: Status) -> Verdict:
        limits = self._config.limits
        refusal = ROVER_FRAME if goal.frame == "rover" else ""
        refusal = refusal or point_refusal(goal.target_ned_m, limits) or speed_refusal(goal.speed_mps, limits)
        self._take_off = goal.do_takeoff and status.code == StatusCode.IDLE
        warning = "already flying: the takeoff is left out" if goal.do_takeoff and not self._take_off else ""
        return Verdict(refusal, warning, self._take_off)

    def start(self, t_ns: int, goal: GoToGoal, state: VehicleState) -> None:
        self._goal = goal
        if self._take_off:
            self._climb = Climb(t_ns, self._config.go_to.takeoff_altitude_m, state, self._config)
        else:
            self._leg = self._leg_from(t_ns, goal, state.pos_uav_ned_m, state.yaw_rad)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        assert self._goal is not None, "step before start"
        if self._leg is None:
            assert self._climb is not None
            problem = self._climb.step(t_ns, state)
            leg = self._climb.leg
            if problem:
                return Done("aborted", f"takeoff: {problem}")
            if not leg.reached:
                return follow(leg, Phase.TAKEOFF, self._goal.target_ned_m, state)
            self._leg = self._leg_from(t_ns, self._goal, leg.end_ned_m, leg.yaw_rad)
        self._leg.step(t_ns, state)
        if problem := self._leg.stuck(t_ns):
            return Done("aborted", problem)
        if self._leg.reached:
            return Done("succeeded", hover_pos_ned_m=self._leg.end_ned_m)
        return follow(self._leg, Phase.GO_TO, self._leg.end_ned_m, state)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)

    def _leg_from(self, t_ns: int, goal: GoToGoal, start_ned_m: Vec3, yaw_rad: float) -> Leg:
        move = self._config.move
        speed_mps = self._config.go_to.speed_mps if goal.speed_mps is None else goal.speed_mps
        return Leg(
            t_ns,
            start_ned_m,
            goal.target_ned_m,
            speed_mps=speed_mps,
            lead_max_m=move.lead_m + move.lead_s * speed_mps,
            config=move,
            yaw_start_rad=yaw_rad,
            yaw_end_rad=goal.yaw_rad,
        )
