"""Go to a target: in a straight line, after a takeoff when asked for."""

from typing import Any

from msgspec.structs import replace

from jezero.frames import Vec3, add, distance, subtract
from jezero.schemas.actions import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.commands import Phase
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import RELATIVE, Topic
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.behaviour import Done, Move, Selection, VehicleState, Verdict
from jezero.services.actions.lifecycle.capture import Capture
from jezero.services.actions.motion.limits import distance_refusal, point_refusal, speed_refusal
from jezero.services.actions.motion.rover_frame import in_world, lost_reason, seen_from_rover
from jezero.services.actions.motion.straight_path import StraightPath
from jezero.services.actions.takeoff.climb import Climb


class GoTo:
    """Flies to `target_ned_m`. Source: thesis algorithm 3."""

    selection: Selection | None = None
    rate_hz: float | None = None
    capture: Capture | None = None

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config
        self._goal: GoToGoal | None = None
        self._climb: Climb | None = None
        self._path: StraightPath | None = None
        self._take_off = False
        self._follows_rover = False

    @property
    def inputs(self) -> tuple[Topic[Any], ...]:
        return (RELATIVE,) if self._follows_rover else ()

    def check(self, goal: GoToGoal, status: Status) -> Verdict:
        limits = self._config.limits
        refusal = point_refusal(goal.target_ned_m, limits) or speed_refusal(goal.speed_mps, limits)
        self._follows_rover = goal.frame == "rover"
        self._take_off = goal.do_takeoff and status.code == StatusCode.IDLE
        warning = "already flying: the takeoff is left out" if goal.do_takeoff and not self._take_off else ""
        look = (lambda state: self._rover_refusal(goal, state)) if self._follows_rover else None
        return Verdict(refusal, warning, self._take_off, look)

    def _rover_refusal(self, goal: GoToGoal, state: VehicleState) -> str:
        """Why a target in the rover's frame can't be flown to, or ""."""
        relative = state.relative
        if relative is None or not relative.valid:
            return lost_reason(relative)
        pos_rover_ned_m = subtract(state.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
        return distance_refusal(add(goal.target_ned_m, pos_rover_ned_m), self._config.limits)

    def start(self, t_ns: int, goal: GoToGoal, state: VehicleState) -> None:
        self._goal = goal
        if self._take_off:
            self._climb = Climb(t_ns, self._config.go_to.takeoff_altitude_m, state, self._config)
        elif not self._follows_rover:
            self._path = self._path_from(t_ns, goal, state.pos_uav_ned_m, state.yaw_rad)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        goal = self._goal
        assert goal is not None, "step before start"
        if self._climb is not None and not self._climb.path.reached:
            return self._go_up(t_ns, goal, self._climb, state)
        if not self._follows_rover:
            return self._go_along(t_ns, goal, state)
        relative = state.relative
        if relative is None or not relative.valid:
            return Done("aborted", lost_reason(relative))
        move = self._go_along(t_ns, goal, seen_from_rover(state, relative))
        if isinstance(move, Move):
            return in_world(move, state, relative)
        if move.hover_pos_ned_m is None:
            return move
        pos_rover_ned_m = subtract(state.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
        return replace(move, hover_pos_ned_m=add(move.hover_pos_ned_m, pos_rover_ned_m))

    def _go_up(self, t_ns: int, goal: GoToGoal, climb: Climb, state: VehicleState) -> Move | Done:
        problem = climb.step(t_ns, state)
        if problem:
            return Done("aborted", f"takeoff: {problem}")
        left_m = climb.path.left_m if self._follows_rover else distance(goal.target_ned_m, state.pos_uav_ned_m)
        return climb.path.move(Phase.TAKEOFF, _feedback(state, left_m))

    def _go_along(self, t_ns: int, goal: GoToGoal, state: VehicleState) -> Move | Done:
        """Towards the target, all in the goal's frame."""
        if self._path is None:
            start_ned_m, yaw_rad = state.pos_uav_ned_m, state.yaw_rad
            if self._climb is not None:
                climbed = self._climb.path
                start_ned_m = start_ned_m if self._follows_rover else climbed.end_ned_m
                yaw_rad = climbed.yaw_rad
            self._path = self._path_from(t_ns, goal, start_ned_m, yaw_rad)
        self._path.step(t_ns, state)
        if problem := self._path.stuck(t_ns):
            return Done("aborted", problem)
        if self._path.reached:
            return Done("succeeded", hover_pos_ned_m=self._path.end_ned_m)
        return self._path.move(Phase.GO_TO, _feedback(state, self._path.left_m))

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)

    def _path_from(self, t_ns: int, goal: GoToGoal, start_ned_m: Vec3, yaw_rad: float) -> StraightPath:
        speed_mps = self._config.go_to.speed_mps if goal.speed_mps is None else goal.speed_mps
        return StraightPath(
            t_ns,
            start_ned_m,
            goal.target_ned_m,
            speed_mps=speed_mps,
            config=self._config.move,
            yaw_start_rad=yaw_rad,
            yaw_end_rad=goal.yaw_rad,
        )


def _feedback(state: VehicleState, distance_m: float) -> MoveFeedback:
    return MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=distance_m)
