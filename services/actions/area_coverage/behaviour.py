"""Map an area: along a planned path over it, with a picture whenever so much of the path has been flown.

Source: thesis §3.6, algorithms 6 and 7.
"""

from collections.abc import Callable
from math import pi
from typing import TYPE_CHECKING, Any

import msgspec

from jezero.frames import Vec3, add, subtract, wrap_pi
from jezero.schemas.actions import AreaCoverageGoal, Corners, CoverageResult, ImagesFeedback
from jezero.schemas.commands import Phase
from jezero.schemas.state import Status
from jezero.schemas.topics import RELATIVE, Topic
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.behaviour import Done, Move, Preparation, Selection, VehicleState, Verdict
from jezero.services.actions.lifecycle.capture import Capture
from jezero.services.actions.motion.limits import point_refusal, speed_refusal
from jezero.services.actions.motion.rover_frame import lost_reason
from jezero.services.actions.motion.straight_path import StraightPath
from jezero.services.actions.motion.tracking import ZERO, Reference, Tracker

if TYPE_CHECKING:
    from jezero.services.actions.area_coverage.planned import CoveragePlan


class AreaCoverage:
    """Flies to the begin of the path, along it, and hovers at its end.

    The path is planned before the goal is accepted. In frame `rover` it is frozen to the world when the goal begins.
    """

    selection: Selection | None = None

    def __init__(self, config: ActionsConfig) -> None:
        self.rate_hz: float | None = config.tracking.rate_hz
        self.capture = Capture(config.capture, planned=0)
        self._config = config
        self._goal: AreaCoverageGoal | None = None
        self._plan: CoveragePlan | None = None
        self._origin_ned_m: Vec3 = ZERO
        """Of the goal's frame, in the world."""
        self._lost = ""
        self._way_in: StraightPath | None = None
        self._tracker: Tracker | None = None
        self._asked = 0
        self._shift_ned_m: Vec3 = ZERO
        self._yaw_rad = 0.0

    @property
    def inputs(self) -> tuple[Topic[Any], ...]:
        return (RELATIVE,) if self._is_rovers else ()

    # -- before it flies --

    def check(self, goal: AreaCoverageGoal, status: Status) -> Verdict:
        self._goal = goal
        limits = self._config.limits
        high = point_refusal((0.0, 0.0, goal.z_ned_m), limits) if goal.frame == "world" else ""
        return Verdict(
            refusal=high or speed_refusal(goal.speed_mps, limits),
            look=lambda state: self.capture.refusal() or self._frame_refusal(state),
            prepare=Preparation(self._planning, self._take_plan),
        )

    def _frame_refusal(self, state: VehicleState) -> str:
        return lost_reason(state.relative) if self._is_rovers else ""

    @property
    def _is_rovers(self) -> bool:
        return self._goal is not None and self._goal.frame == "rover"

    def _planning(self, state: VehicleState) -> Callable[[], Any]:
        """A function that makes the plan, or the reason why there is none; it takes up to a second."""
        goal, config = self._goal, self._config
        assert goal is not None, "planned before check"
        origin_ned_m = self._origin_from(state)
        north_m, east_m, _ = subtract(state.pos_uav_ned_m, origin_ned_m)

        def plan() -> "CoveragePlan | str":
            from jezero.services.actions.area_coverage.area import AreaError
            from jezero.services.actions.area_coverage.planned import plan_coverage

            try:
                return plan_coverage(goal, config, (north_m, east_m), origin_ned_m)
            except AreaError as error:
                return str(error)

        return plan

    def _take_plan(self, outcome: "CoveragePlan | str") -> str:
        if isinstance(outcome, str):
            return outcome
        self._plan = outcome
        self.capture.planned = len(outcome.pictures_m)
        return ""

    def _origin_from(self, state: VehicleState) -> Vec3:
        if not self._is_rovers or state.relative is None:
            return ZERO
        return subtract(state.pos_uav_ned_m, state.relative.pos_uav_rel_rover_ned_m)

    # -- the flight --

    def start(self, t_ns: int, goal: AreaCoverageGoal, state: VehicleState) -> None:
        assert self._plan is not None, "started before it was planned"
        self._lost = self._frame_refusal(state)
        self._origin_ned_m = self._origin_from(state)
        lines_rad = self._plan.lines_rad
        ahead = abs(wrap_pi(lines_rad - state.yaw_rad)) <= 0.5 * pi
        self._yaw_rad = wrap_pi(lines_rad if ahead else lines_rad + pi)
        self._way_in = StraightPath(
            t_ns,
            state.pos_uav_ned_m,
            self._reference(0.0).pos_ned_m,
            speed_mps=self._config.go_to.speed_mps,
            config=self._config.move,
            yaw_start_rad=state.yaw_rad,
            yaw_end_rad=self._yaw_rad,
        )

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        assert self._way_in is not None, "step before start"
        self._shift_ned_m = state.shift_ned_m
        if self._lost:
            return Done("aborted", self._lost)
        if self._tracker is None:
            return self._go_to_begin(t_ns, self._way_in, state)
        return self._follow_path(t_ns, self._tracker, state)

    def _go_to_begin(self, t_ns: int, path: StraightPath, state: VehicleState) -> Move | Done:
        path.step(t_ns, state)
        if problem := path.stuck(t_ns):
            return Done("aborted", f"on the way to the area: {problem}")
        if path.reached:
            self._tracker = Tracker(t_ns, self._config.tracking)
        return path.move(Phase.COVERAGE, self._feedback(state))

    def _follow_path(self, t_ns: int, tracker: Tracker, state: VehicleState) -> Move | Done:
        plan = self._plan
        assert plan is not None
        dt_s = tracker.advance(t_ns, self._reference(tracker.time_s), state)
        self._ask_for_pictures(t_ns, tracker, plan)
        north_m, east_m, _ = subtract(state.pos_uav_ned_m, self._origin_ned_m)
        plan.ground.mark(north_m, east_m)
        if problem := tracker.stuck(t_ns):
            return Done("aborted", problem)
        reference = self._reference(tracker.time_s)
        if tracker.time_s >= plan.trajectory.duration_s and not self.capture.waits:
            return Done("succeeded", hover_pos_ned_m=reference.pos_ned_m)
        velocity, acceleration = tracker.command(dt_s, reference, state)
        return Move(
            Phase.COVERAGE,
            self._feedback(state),
            vel_ned_mps=velocity,
            acc_ned_mps2=acceleration,
            yaw_rad=self._yaw_rad,
        )

    def _ask_for_pictures(self, t_ns: int, tracker: Tracker, plan: "CoveragePlan") -> None:
        """Of the points passed since; the picture exposed nearest to each is its, on average."""
        half_frame_ns = int(0.5 * NS_PER_S / self._config.area_coverage.camera_rate_hz)
        times_s = plan.picture_times_s
        while self._asked < len(times_s) and times_s[self._asked] <= tracker.time_s:
            self.capture.ask(plan.first_picture + self._asked, t_ns - half_frame_ns)
            self._asked += 1

    def _reference(self, time_s: float) -> Reference:
        assert self._plan is not None
        assert self._goal is not None
        position, velocity, acceleration = self._plan.trajectory.at(time_s)
        return Reference(
            add((float(position[0]), float(position[1]), self._goal.z_ned_m), self._origin_ned_m),
            (float(velocity[0]), float(velocity[1]), 0.0),
            (float(acceleration[0]), float(acceleration[1]), 0.0),
        )

    def _feedback(self, state: VehicleState) -> ImagesFeedback:
        assert self._goal is not None
        return ImagesFeedback(
            pos_uav_ned_m=subtract(state.pos_uav_ned_m, self._origin_ned_m),
            frame=self._goal.frame,
            taken=self.capture.taken,
            planned=self.capture.planned,
        )

    # -- how it ended --

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> CoverageResult:
        covered = 0.0 if self._plan is None else self._plan.ground.share
        return CoverageResult(
            completed=completed,
            pos_uav_ned_m=pos_uav_ned_m,
            images=self.capture.images(),
            covered=covered,
            resume=self._remainder(),
        )

    def _remainder(self) -> AreaCoverageGoal | None:
        """The goal that takes the missing pictures, or None when there are none."""
        goal, plan = self._goal, self._plan
        if goal is None or plan is None:
            return None
        first = plan.first_picture + self.capture.taken
        if first >= len(plan.pictures_m):
            return None
        by_ned_m = add(self._origin_ned_m, self._shift_ned_m)
        start_m = goal.start_ned_m or plan.start_m
        return msgspec.structs.replace(
            goal,
            goal_id="",
            issued_t_ns=None,
            frame="world",
            polygon_ned_m=_moved(goal.polygon_ned_m, by_ned_m),
            holes_ned_m=tuple(_moved(hole, by_ned_m) for hole in goal.holes_ned_m),
            z_ned_m=goal.z_ned_m + by_ned_m[2],
            start_ned_m=_moved((start_m,), by_ned_m)[0],
            first_picture=first,
        )


def _moved(corners_m: Corners, by_ned_m: Vec3) -> Corners:
    return tuple((north_m + by_ned_m[0], east_m + by_ned_m[1]) for north_m, east_m in corners_m)
