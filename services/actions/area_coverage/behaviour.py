"""Map an area: fly along a planned path over it, and take pictures at even distances.

Source: thesis §3.6, algorithms 6 and 7.
"""

from copy import deepcopy
from math import pi
from typing import TYPE_CHECKING

import msgspec

from jezero.base.frames import Vec3, add, altitude_m, subtract, wrap_pi
from jezero.schemas.commands import Phase
from jezero.schemas.goals import AreaCoverageGoal, Corners, CoverageResult, ImagesFeedback
from jezero.schemas.images import Image
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Done, Move, Refusal, Remaining, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.rover_frame import loss_reason, rover_position
from jezero.services.actions.motion.straight_path import StraightPath
from jezero.services.actions.motion.tracking import ZERO, Reference, Tracker

if TYPE_CHECKING:
    from jezero.services.actions.area_coverage.coverage_plan import CoveragePlan

PATH_SAMPLES = 4
"""The way that clients get has every fourth sample of the trajectory: a corner a metre."""


class AreaCoverage:
    """Flies to the begin of the planned path, along it, and hovers at its end.

    In frame `rover` the path is frozen to the world when the goal begins.

    Args:
        first_index: index of the path's first picture; the goal's pictures before it are taken.
        taken_before: number of pictures in `capture` that were taken before this path, for a goal that was modified.
        asked: the goal in its own frame, with the origin of that frame, for a goal that was modified; None: `goal`.
    """

    def __init__(
        self,
        goal: AreaCoverageGoal,
        plan: "CoveragePlan",
        capture: Capture,
        config: ActionsConfig,
        first_index: int,
        taken_before: int,
        asked: "tuple[AreaCoverageGoal, Vec3] | None",
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._goal = goal
        self._plan = plan
        self.capture = capture
        self._first_index = first_index
        self._taken_before = taken_before
        self._config = config
        self._tracker: Tracker | None = None
        """None on the way to the begin of the path."""
        self._requested = 0
        """Number of pictures requested so far."""
        self._shift_ned_m: Vec3 = ZERO
        self._lost = frame_loss(goal, state)
        self._origin_ned_m = frame_origin_ned_m(goal, state)
        """Origin of the goal's frame, in the world."""
        self.asked = asked or (goal, self._origin_ned_m)
        self._ground = deepcopy(plan.ground)
        lines_rad = plan.lines_rad
        ahead = abs(wrap_pi(lines_rad - state.yaw_rad)) <= 0.5 * pi
        self._yaw_rad = wrap_pi(lines_rad if ahead else lines_rad + pi)
        self._way_in = StraightPath(
            t_ns,
            state.pos_uav_ned_m,
            self._reference(0.0).pos_ned_m,
            speed_mps=config.go_to.speed_mps,
            config=config.move,
            yaw_start_rad=state.yaw_rad,
            yaw_end_rad=self._yaw_rad,
        )

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        self._shift_ned_m = state.shift_ned_m
        self.capture.planned = self._first_index + len(self._plan.pictures_m) - self._plan.first_picture
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
        dt_s = tracker.advance(t_ns, self._reference(tracker.time_s), state)
        self._request_pictures(t_ns, tracker)
        north_m, east_m, _ = subtract(state.pos_uav_ned_m, self._origin_ned_m)
        self._ground.mark(north_m, east_m)
        if problem := tracker.stuck(t_ns):
            return Done("aborted", problem)
        reference = self._reference(tracker.time_s)
        if tracker.time_s >= plan.trajectory.duration_s and not self.capture.is_waiting:
            return Done("succeeded", hover_pos_ned_m=reference.pos_ned_m)
        velocity, acceleration = tracker.command(dt_s, reference, state)
        return Move(
            Phase.COVERAGE,
            self._feedback(state),
            vel_ned_mps=velocity,
            acc_ned_mps2=acceleration,
            yaw_rad=self._yaw_rad,
            target_ned_m=reference.pos_ned_m,
        )

    def _request_pictures(self, t_ns: int, tracker: Tracker) -> None:
        """Request the pictures of the points passed since the last step.

        A request takes the first exposure after its time; half a frame earlier than the point, that exposure is on
        average at the point itself.
        """
        plan = self._plan
        half_frame_ns = int(0.5 * NS_PER_S / self._config.vehicle.camera.rate_hz)
        times_s = plan.picture_times_s
        while self._requested < len(times_s) and times_s[self._requested] <= tracker.time_s:
            self.capture.request(self._first_index + self._requested, t_ns - half_frame_ns)
            self._requested += 1

    def _reference(self, time_s: float) -> Reference:
        position, velocity, acceleration = self._plan.trajectory.at(time_s)
        return Reference(
            add((float(position[0]), float(position[1]), self._goal.z_ned_m), self._origin_ned_m),
            (float(velocity[0]), float(velocity[1]), 0.0),
            (float(acceleration[0]), float(acceleration[1]), 0.0),
        )

    def remaining(self, state: VehicleState) -> Remaining:
        trajectory, time_s = self._plan.trajectory, 0.0 if self._tracker is None else self._tracker.time_s
        along = Remaining(max(trajectory.duration_s - time_s, 0.0), trajectory.length_left_m(time_s))
        return along if self._tracker is not None else self._way_in.remaining() + along

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The way to the begin of the lines, and along the lines."""
        times_s = self._plan.trajectory.t_s
        corners_s = [*times_s[::PATH_SAMPLES].tolist(), float(times_s[-1])]
        return (state.pos_uav_ned_m, *(self._reference(time_s).pos_ned_m for time_s in corners_s))

    def _feedback(self, state: VehicleState) -> ImagesFeedback:
        return ImagesFeedback(
            pos_uav_ned_m=subtract(state.pos_uav_ned_m, self._origin_ned_m),
            frame=self._goal.frame,
            taken=self.capture.taken,
            planned=self.capture.planned,
        )

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> CoverageResult:
        images = self.capture.images()
        return CoverageResult(
            completed=completed,
            pos_uav_ned_m=pos_uav_ned_m,
            images=images,
            covered=self._ground.fraction,
            photographed=self._photographed(images),
            resume=self._remainder(),
        )

    def _photographed(self, images: tuple[Image, ...]) -> float:
        """Fraction of the area in the pictures: those of this goal by their poses, earlier ones by the plan."""
        from jezero.services.actions.area_coverage.ground import PhotographedGround, footprint

        plan, camera = self._plan, self._config.vehicle.camera
        ground = PhotographedGround(plan.area, plan.photographs.footprint_m)
        for picture_m in plan.pictures_m[: plan.first_picture]:
            ground.mark(plan.photographs.footprint_m, *picture_m)
        origin_ned_m = add(self._origin_ned_m, self._shift_ned_m)
        for image in images:
            north_m, east_m, _ = subtract(image.pos_camera_ned_m, origin_ned_m)
            height_m = altitude_m(image.pos_camera_ned_m[2])
            ground.mark(footprint(camera, image.q_ned_from_camera, height_m), north_m, east_m)
        return ground.fraction

    @property
    def next_index(self) -> int:
        """Index of the next picture."""
        return self._first_index + self.capture.taken - self._taken_before

    def changed(self, goal: AreaCoverageGoal) -> AreaCoverageGoal | Refusal:
        """The goal of the rest of the flight with changed fields, in the world; or the reason why there is none.

        Another area is covered from its begin. In the same area the missing pictures are taken.
        """
        before, origin_ned_m = self.asked
        if (goal.polygon_ned_m, goal.holes_ned_m) != (before.polygon_ned_m, before.holes_ned_m):
            return _in_world(goal, origin_ned_m, first_picture=0, start_ned_m=None)
        if goal.z_ned_m != before.z_ned_m and goal.resolution_m is None:
            return Refusal(
                "the lines of an area that is given with an overlap depend on the height: change polygon_ned_m, to the "
                "area that remains, together with z_ned_m"
            )
        if (goal.angle_rad, goal.picture_distance_m) != (before.angle_rad, before.picture_distance_m):
            return Refusal(
                "the lines and images of an area keep their direction and distance: change polygon_ned_m, to the area "
                "that remains, together with angle_rad or picture_distance_m"
            )
        if self._next_picture >= len(self._plan.pictures_m):
            return Refusal("all pictures are taken already")
        start_ned_m = _moved((self._plan.start_m,), self._origin_ned_m)[0]
        return _in_world(goal, origin_ned_m, first_picture=self._next_picture, start_ned_m=start_ned_m)

    @property
    def _next_picture(self) -> int:
        """Number of the plan's next picture."""
        return self._plan.first_picture + self.capture.taken - self._taken_before

    def _remainder(self) -> AreaCoverageGoal | None:
        """The goal that takes the missing pictures, in the present world frame, or None when there are none."""
        plan = self._plan
        if self._next_picture >= len(plan.pictures_m):
            return None
        by_ned_m = add(self._origin_ned_m, self._shift_ned_m)
        start_ned_m = _moved((plan.start_m,), by_ned_m)[0]
        return _in_world(self._goal, by_ned_m, first_picture=self._next_picture, start_ned_m=start_ned_m)


def frame_loss(goal: AreaCoverageGoal, state: VehicleState) -> str:
    """Reason why the goal's frame is not known, or ""."""
    return loss_reason(state.relative) if goal.frame == "rover" else ""


def frame_origin_ned_m(goal: AreaCoverageGoal, state: VehicleState) -> Vec3:
    """Origin of the goal's frame in the world; that of the world where the rover's frame is not known."""
    if goal.frame != "rover" or state.relative is None:
        return ZERO
    return rover_position(state, state.relative)


def _moved(corners_m: Corners, by_ned_m: Vec3) -> Corners:
    return tuple((north_m + by_ned_m[0], east_m + by_ned_m[1]) for north_m, east_m in corners_m)


def _in_world(
    goal: AreaCoverageGoal, by_ned_m: Vec3, *, first_picture: int, start_ned_m: tuple[float, float] | None
) -> AreaCoverageGoal:
    """The same goal in the world frame, to be planned anew.

    Args:
        by_ned_m: origin of the goal's frame in the world.
    """
    return msgspec.structs.replace(
        goal,
        goal_id="",
        plan_id="",
        issued_t_ns=None,
        frame="world",
        polygon_ned_m=_moved(goal.polygon_ned_m, by_ned_m),
        holes_ned_m=tuple(_moved(hole, by_ned_m) for hole in goal.holes_ned_m),
        z_ned_m=goal.z_ned_m + by_ned_m[2],
        start_ned_m=start_ned_m,
        first_picture=first_picture,
    )
