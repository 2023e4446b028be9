"""The action `go_to`: fly to a target in a straight line, after a takeoff if the goal wants one."""

from functools import partial

from msgspec.structs import replace

from jezero.base.frames import Vec3, add, altitude_m, distance
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import RELATIVE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Refusal, Remaining, VehicleState
from jezero.services.actions.motion.limits import high_or_far_refusal, point_refusal, speed_refusal
from jezero.services.actions.motion.rover_frame import (
    loss_reason,
    rover_position,
    state_in_rover_frame,
    step_in_rover_frame,
)
from jezero.services.actions.motion.straight_path import StraightPath
from jezero.services.actions.takeoff import Climb


class GoTo:
    """Flies to `target_ned_m`. Source: thesis algorithm 3.

    Args:
        do_takeoff: climb first.
    """

    def __init__(
        self,
        goal: GoToGoal,
        do_takeoff: bool,
        config: ActionsConfig,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._goal = goal
        self._config = config
        self._in_rover_frame = goal.frame == "rover"
        self._climb: Climb | None = None
        self._path: StraightPath | None = None
        """Path to the target, in the goal's frame; None until the climb is over and that frame is known."""
        if do_takeoff:
            self._climb = Climb(t_ns, config.go_to.takeoff_altitude_m, state, config.move)
        elif not self._in_rover_frame:
            self._path = self._path_from(t_ns, state.pos_uav_ned_m, state.yaw_rad)

    @property
    def climbs(self) -> bool:
        """Whether the takeoff is not over yet."""
        return self._climb is not None and not self._climb.path.reached

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if self._climb is not None and self.climbs:
            return self._go_up(t_ns, self._climb, state)
        if self._in_rover_frame:
            return step_in_rover_frame(self._go_along, t_ns, state)
        return self._go_along(t_ns, state)

    def _go_up(self, t_ns: int, climb: Climb, state: VehicleState) -> Move | Done:
        problem = climb.step(t_ns, state)
        if problem:
            return Done("aborted", f"takeoff: {problem}")
        to_target_m = distance(self._goal.target_ned_m, state.pos_uav_ned_m)
        left_m = climb.path.left_m if self._in_rover_frame else to_target_m
        return climb.path.move(Phase.TAKEOFF, MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=left_m))

    def _go_along(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Fly towards the target; state and result are in the goal's frame."""
        path = self._path = self._path or self._first_path(t_ns, state)
        path.step(t_ns, state)
        if problem := path.stuck(t_ns):
            return Done("aborted", problem)
        if path.reached:
            return Done("succeeded", hover_pos_ned_m=path.end_ned_m)
        feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, frame=self._goal.frame, distance_m=path.left_m)
        return path.move(Phase.GO_TO, feedback)

    def remaining(self, state: VehicleState) -> Remaining | None:
        """Rest of the climb and of the path; None while the rover's frame isn't known."""
        path = self._path
        if path is None and self._in_rover_frame:
            if state.relative is None or not state.relative.valid:
                return None
            state = state_in_rover_frame(state, state.relative)
        climb = self._climb
        if climb is None or climb.path.reached:
            return (path or self._path_from(0, state.pos_uav_ned_m, state.yaw_rad)).remaining()
        x, y, z = state.pos_uav_ned_m
        begin_ned_m = (x, y, z - climb.path.left_m)
        return climb.path.remaining() + self._path_from(0, begin_ned_m, climb.path.yaw_rad).remaining()

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The way to the end of the climb, if there is one, and to the target."""
        target_ned_m = self._goal.target_ned_m
        if self._in_rover_frame:
            if state.relative is None or not state.relative.valid:
                return ()
            target_ned_m = add(target_ned_m, rover_position(state, state.relative))
        climb = () if self._climb is None else (self._climb.path.end_ned_m,)
        return (state.pos_uav_ned_m, *climb, target_ned_m)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)

    def _first_path(self, t_ns: int, state: VehicleState) -> StraightPath:
        """Path from the end of the climb, or from the vehicle's position where there was no climb."""
        if self._climb is None:
            return self._path_from(t_ns, state.pos_uav_ned_m, state.yaw_rad)
        climbed = self._climb.path
        start_ned_m = state.pos_uav_ned_m if self._in_rover_frame else climbed.end_ned_m
        return self._path_from(t_ns, start_ned_m, climbed.yaw_rad)

    def _path_from(self, t_ns: int, start_ned_m: Vec3, yaw_rad: float) -> StraightPath:
        goal = self._goal
        return StraightPath(
            t_ns,
            start_ned_m,
            goal.target_ned_m,
            speed_mps=self._config.go_to.speed_mps if goal.speed_mps is None else goal.speed_mps,
            config=self._config.move,
            yaw_start_rad=yaw_rad,
            yaw_end_rad=goal.yaw_rad,
        )


class GoToPlanner:
    """Plans straight flights to a target within the limits."""

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config

    def plan(self, goal: GoToGoal, status: Status) -> Plan | Refusal:
        """Plan a flight, after a takeoff when the goal wants one and the vehicle is on the ground."""
        limits = self._config.vehicle.limits
        if reason := point_refusal(goal.target_ned_m, limits) or speed_refusal(goal.speed_mps, limits):
            return Refusal(reason)
        do_takeoff = goal.do_takeoff and status.code == StatusCode.IDLE
        in_rover_frame = goal.frame == "rover"
        return Plan(
            partial(GoTo, goal, do_takeoff, self._config),
            warning="already flying: the takeoff is left out" if goal.do_takeoff and not do_takeoff else "",
            do_takeoff=do_takeoff,
            override=goal.override,
            landing_from_m=altitude_m(goal.target_ned_m[2]) if do_takeoff else 0.0,
            inputs=(RELATIVE,) if in_rover_frame else (),
            check_inputs=partial(self._inputs_refusal, goal) if in_rover_frame else None,
        )

    def replan(self, goal: GoToGoal, status: Status, running: GoTo) -> Plan | Refusal:
        """Plan the straight flight from where the vehicle hovers to the changed target."""
        if running.climbs:
            return Refusal("the vehicle still takes off: modify the goal when it flies to its target")
        return self.plan(replace(goal, do_takeoff=False), status)

    def _inputs_refusal(self, goal: GoToGoal, state: VehicleState) -> str:
        """Reason why a target in the rover's frame can't be flown to, or ""."""
        relative = state.relative
        if relative is None or not relative.valid:
            return loss_reason(relative)
        return high_or_far_refusal(add(goal.target_ned_m, rover_position(state, relative)), self._config.vehicle.limits)
