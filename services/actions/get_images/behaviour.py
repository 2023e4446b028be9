"""Photograph a target from all sides. Source: spec §5; thesis §3.5.

Straight to the orbit's nearest point, then one turn with velocity setpoints, facing the centre; the camera's axes keep
the target in the middle of the picture. In the rover's frame all of it moves with the rover.
"""

from math import hypot, pi, sqrt
from typing import Any

from msgspec.structs import replace

from jezero.frames import Vec3, add, norm, scale, subtract, wrap_pi
from jezero.schemas.actions import GetImagesGoal, ImagesFeedback, ImagesResult
from jezero.schemas.commands import Phase
from jezero.schemas.estimate import Relative
from jezero.schemas.state import Status
from jezero.schemas.topics import RELATIVE, Topic
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.get_images.orbit import Orbit, aim, facing, nearest_phase
from jezero.services.actions.lifecycle.behaviour import Done, Move, Selection, VehicleState, Verdict
from jezero.services.actions.lifecycle.capture import Capture
from jezero.services.actions.motion.config import LimitsConfig
from jezero.services.actions.motion.limits import distance_refusal, point_refusal, speed_refusal
from jezero.services.actions.motion.rover_frame import lost_reason, seen_from_rover
from jezero.services.actions.motion.straight_path import TimedStraightPath, straight_speed_mps
from jezero.services.actions.motion.tracking import Tracker, position_now

IMAGES_MAX = 255
EXPOSURES_PER_PICTURE = 2.0
"""The camera exposes at least so often between two planned points."""


class GetImages:
    """One goal."""

    selection: Selection | None = None

    def __init__(self, config: ActionsConfig) -> None:
        self.rate_hz: float | None = config.tracking.rate_hz
        self.capture: Capture | None = None
        self._config = config
        self._orbit_config = config.get_images
        self._goal: GetImagesGoal | None = None
        self._way_in: TimedStraightPath | None = None
        self._orbit: Orbit | None = None
        self._tracker: Tracker | None = None
        self._yaw_rad = 0.0
        self._settled_ns: int | None = None
        self._arrived_ns: int | None = None
        self._turned_rad = 0.0
        """By the vehicle, around the centre, since the orbit began."""
        self._phase_rad = 0.0
        self._asked = 0

    @property
    def inputs(self) -> tuple[Topic[Any], ...]:
        return (RELATIVE,) if self._follows_rover else ()

    @property
    def _follows_rover(self) -> bool:
        return self._goal is not None and self._goal.frame == "rover"

    # -- before --

    def check(self, goal: GetImagesGoal, status: Status) -> Verdict:
        self._goal = goal
        config, limits = self._orbit_config, self._config.limits
        self.capture = Capture(self._config.capture, goal.num_images, stream=goal.stream_images)
        refusal = shape_refusal(goal, config, limits)
        if refusal:
            return Verdict(refusal=refusal)
        asked_mps = config.speed_mps if goal.speed_mps is None else goal.speed_mps
        speed_mps = self._speed_mps(goal)
        slower = f"flown at {speed_mps:.2g} m/s instead of {asked_mps:g} m/s: the circle is small, or has many pictures"
        warning = slower if goal.speed_mps is not None and speed_mps < asked_mps else ""
        return Verdict(warning=warning, look=lambda state: self._look_refusal(goal, state))

    def _look_refusal(self, goal: GetImagesGoal, state: VehicleState) -> str:
        """Why the goal can't begin, by what is seen."""
        assert self.capture is not None
        if self._follows_rover:
            relative = state.relative
            if relative is None or not relative.valid:
                return lost_reason(relative)
            pos_rover_ned_m = subtract(state.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
            center_ned_m = add(goal.center_ned_m, pos_rover_ned_m)
            if refusal := far_refusal(center_ned_m, goal.radius_m, self._config.limits):
                return refusal
        return self.capture.refusal()

    def _speed_mps(self, goal: GetImagesGoal) -> float:
        """As asked, unless the turn is too tight for it or the camera too slow."""
        config = self._orbit_config
        asked_mps = config.speed_mps if goal.speed_mps is None else goal.speed_mps
        rate_hz = self._config.area_coverage.camera_rate_hz
        spacing_m = 2.0 * pi * goal.radius_m / goal.num_images
        tight_mps = sqrt(config.inwards_max_mps2 * goal.radius_m)
        return min(asked_mps, tight_mps, spacing_m * rate_hz / EXPOSURES_PER_PICTURE)

    # -- in flight --

    def start(self, t_ns: int, goal: GetImagesGoal, state: VehicleState) -> None:
        self._yaw_rad = state.yaw_rad

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        goal = self._goal
        assert goal is not None, "step before check"
        if not self._follows_rover:
            return self._fly(t_ns, goal, state)
        relative = state.relative
        if relative is None or not relative.valid:
            return Done("aborted", lost_reason(relative))
        move = self._fly(t_ns, goal, seen_from_rover(state, relative))
        if isinstance(move, Move):
            return _with_rover(move, relative)
        if move.hover_pos_ned_m is None:
            return move
        pos_rover_ned_m = subtract(state.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
        return replace(move, hover_pos_ned_m=add(move.hover_pos_ned_m, pos_rover_ned_m))

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> ImagesResult:
        assert self.capture is not None
        return ImagesResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m, images=self.capture.images())

    def _fly(self, t_ns: int, goal: GetImagesGoal, state: VehicleState) -> Move | Done:
        """All in the goal's frame."""
        if self._tracker is None or self._way_in is None or self._orbit is None:
            self._plan(t_ns, goal, state)
        assert self._tracker is not None and self._way_in is not None and self._orbit is not None
        path: TimedStraightPath | Orbit = self._way_in if self._arrived_ns is None else self._orbit
        dt_s = self._tracker.advance(t_ns, path.at(self._tracker.time_s), state)
        if problem := self._tracker.stuck(t_ns):
            return Done("aborted", problem)
        if self._arrived_ns is None:
            self._settle(t_ns, state)
        elif self._go_around(t_ns, goal, self._orbit, state):
            return Done("succeeded", hover_pos_ned_m=self._orbit.at(0.0).pos_ned_m)
        return self._move(t_ns, dt_s, goal, path, state)

    def _plan(self, t_ns: int, goal: GetImagesGoal, state: VehicleState) -> None:
        config = self._orbit_config
        self._phase_rad = nearest_phase(goal.center_ned_m, state.pos_uav_ned_m, state.yaw_rad)
        self._orbit = Orbit(
            goal.center_ned_m, goal.radius_m, self._phase_rad, self._speed_mps(goal), config.acceleration_mps2
        )
        start_ned_m = self._orbit.at(0.0).pos_ned_m
        pos_ned_m, move = state.pos_uav_ned_m, self._config.move
        speed_mps = straight_speed_mps(pos_ned_m, start_ned_m, self._config.go_to.speed_mps, move)
        self._way_in = TimedStraightPath(pos_ned_m, start_ned_m, speed_mps, move.accel_mps2)
        self._tracker = Tracker(t_ns, self._config.tracking)

    def _settle(self, t_ns: int, state: VehicleState) -> None:
        """The turn begins when the vehicle is at its first point and faces the centre."""
        config, move = self._orbit_config, self._config.move
        assert self._way_in is not None and self._tracker is not None and self._orbit is not None
        end_ned_m = self._way_in.end_ned_m
        away_m = norm(subtract(end_ned_m, position_now(state)))
        yaw_rad, _ = facing(end_ned_m, (0.0, 0.0, 0.0), self._orbit.center_ned_m)
        turned = abs(wrap_pi(yaw_rad - state.yaw_rad)) < config.settled_rad
        slow = norm(state.vel_uav_ned_mps) < move.reached_mps
        if not (turned and slow and away_m < move.reached_m):
            self._settled_ns = None
        elif self._settled_ns is None:
            self._settled_ns = t_ns
        if self._settled_ns is not None and t_ns - self._settled_ns >= config.settled_s * NS_PER_S:
            self._arrived_ns = t_ns
            self._tracker.restart(t_ns)

    def _go_around(self, t_ns: int, goal: GetImagesGoal, orbit: Orbit, state: VehicleState) -> bool:
        """Ask for the pictures whose points the vehicle has passed; tells whether all is done."""
        assert self.capture is not None and self._tracker is not None
        north_m, east_m, _ = subtract(position_now(state), orbit.center_ned_m)
        phase_rad = nearest_phase((0.0, 0.0, 0.0), (north_m, east_m, 0.0), state.yaw_rad)
        self._turned_rad += wrap_pi(phase_rad - self._phase_rad)
        self._phase_rad = phase_rad
        spacing_rad = 2.0 * pi / goal.num_images
        over = self._tracker.time_s >= orbit.profile.duration_s
        while self._asked < goal.num_images:
            if self._asked > 0 and self._turned_rad < self._asked * spacing_rad and not over:
                break
            self.capture.ask(self._asked, t_ns)
            self._asked += 1
        done = self._asked == goal.num_images and not self.capture.waits
        return done and (over or goal.num_images == 1)

    def _move(
        self, t_ns: int, dt_s: float, goal: GetImagesGoal, path: TimedStraightPath | Orbit, state: VehicleState
    ) -> Move:
        assert self._tracker is not None
        reference = path.at(self._tracker.time_s)
        lead_ned_mps = scale(reference.acc_ned_mps2, self._orbit_config.velocity_lead_s)
        reference = reference._replace(vel_ned_mps=add(reference.vel_ned_mps, lead_ned_mps))
        vel_ned_mps, acc_ned_mps2 = self._tracker.command(dt_s, reference, state)
        yaw_rad, yaw_rate_rps = self._heading(dt_s, goal, state)
        target_ned_m = (goal.center_ned_m[0], goal.center_ned_m[1], goal.target_z_ned_m)
        assert self.capture is not None
        way_ned_m = subtract(target_ned_m, self.capture.pos_camera(position_now(state), state.q_ned_from_frd))
        pitch_rad, roll_rad = aim(state.q_ned_from_frd, way_ned_m, self._orbit_config.roll_camera_max_rad)
        return Move(
            Phase.GET_IMAGES,
            ImagesFeedback(pos_uav_ned_m=state.pos_uav_ned_m, frame=goal.frame, taken=0, planned=goal.num_images),
            vel_ned_mps=vel_ned_mps,
            acc_ned_mps2=acc_ned_mps2,
            yaw_rad=yaw_rad,
            yaw_rate_rps=yaw_rate_rps,
            pitch_camera_rad=pitch_rad,
            roll_camera_rad=roll_rad,
        )

    def _heading(self, dt_s: float, goal: GetImagesGoal, state: VehicleState) -> tuple[float, float]:
        """Towards the centre; on the way to the orbit it turns slowly to where that will be."""
        if self._arrived_ns is not None:
            self._yaw_rad, rate_rps = facing(position_now(state), state.vel_uav_ned_mps, goal.center_ned_m)
            return self._yaw_rad, rate_rps
        assert self._way_in is not None
        wanted_rad, _ = facing(self._way_in.end_ned_m, (0.0, 0.0, 0.0), goal.center_ned_m)
        reach_rad = self._config.move.yaw_rate_rps * dt_s
        turn_rad = wrap_pi(wanted_rad - self._yaw_rad)
        self._yaw_rad = wrap_pi(self._yaw_rad + min(reach_rad, max(-reach_rad, turn_rad)))
        return self._yaw_rad, 0.0


def shape_refusal(goal: GetImagesGoal, config: GetImagesConfig, limits: LimitsConfig) -> str:
    """Why nobody could fly this, or ""; each tells what to do."""
    if not 1 <= goal.num_images <= IMAGES_MAX:
        return f"{goal.num_images} pictures: ask for 1 to {IMAGES_MAX}"
    if not goal.radius_m >= config.radius_min_m:
        return f"radius {goal.radius_m:g} m is too small: the vehicle flies around at {config.radius_min_m:g} m or more"
    if refusal := point_refusal(goal.center_ned_m, limits):
        return refusal.replace("target z", "the center's z")
    if goal.target_z_ned_m < goal.center_ned_m[2]:
        return (
            f"the target at z = {goal.target_z_ned_m:g} m is above the flight at {goal.center_ned_m[2]:g} m, and the "
            "camera looks down: fly higher, or give target_z_ned_m"
        )
    return far_refusal(goal.center_ned_m, goal.radius_m, limits) or speed_refusal(goal.speed_mps, limits)


def far_refusal(center_ned_m: Vec3, radius_m: float, limits: LimitsConfig) -> str:
    """Why the circle's farthest point is too far away, or ""."""
    share = 1.0 + radius_m / max(hypot(center_ned_m[0], center_ned_m[1]), 1e-9)
    if hypot(center_ned_m[0], center_ned_m[1]) < 1e-6:
        return distance_refusal((radius_m, 0.0, 0.0), limits)
    return distance_refusal((share * center_ned_m[0], share * center_ned_m[1], 0.0), limits)


def _with_rover(move: Move, relative: Relative) -> Move:
    """A move relative to the rover, with the rover's own motion added."""
    assert move.vel_ned_mps is not None and move.acc_ned_mps2 is not None
    north_mps, east_mps, _ = relative.vel_rover_ned_mps
    rate_rps = relative.yaw_rate_rover_rps
    return replace(
        move,
        vel_ned_mps=add(move.vel_ned_mps, relative.vel_rover_ned_mps),
        acc_ned_mps2=add(move.acc_ned_mps2, (-rate_rps * east_mps, rate_rps * north_mps, 0.0)),
    )
