"""Photograph a target from all sides, in the world's frame or in the rover's.

The vehicle flies straight to the nearest point of a circle around the target, then one turn with velocity setpoints,
facing the centre; the camera's axes keep the target in the middle of the picture.

Source: spec §5; thesis §3.5, eqs. 3.1 to 3.6.
"""

from itertools import pairwise
from math import atan2, copysign, cos, hypot, pi, sin
from typing import NamedTuple

from jezero.base.frames import Quat, Vec3, add, quat_conjugate, quat_rotate, scale, subtract, wrap_pi
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GetImagesGoal, ImagesFeedback, ImagesResult
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.arrival import ArrivalDetector
from jezero.services.actions.motion.behaviour import Done, Move, Remaining, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.rover_frame import rover_position, step_in_rover_frame
from jezero.services.actions.motion.straight_path import SpeedProfile, TimedStraightPath, straight_speed_mps
from jezero.services.actions.motion.tracking import Reference, Tracker, position_now

SETTLED_RAD, SETTLED_S = 0.035, 0.5
"""The turn begins when the vehicle has faced the centre within this heading error for this duration."""
VELOCITY_LEAD_S = 0.11
"""Time by which the velocity setpoints are ahead, because the vehicle's velocity follows them late by that much;
without it, the vehicle is carried out of the circle."""
PATH_CORNERS = 24
ROLL_CAMERA_MAX_RAD = 0.6
"""Limit of the camera's roll axis."""


class Turn(NamedTuple):
    """Progress of a turn.

    Attributes:
        turned_rad: angle that the vehicle has flown around the centre.
        requested: number of pictures requested so far.
        points_rad: angle of each picture's point since the begin of the turn.
    """

    turned_rad: float
    requested: int
    points_rad: tuple[float, ...]

    @classmethod
    def begin(cls, num_images: int) -> "Turn":
        """The turn before its first picture, with evenly spread points."""
        return cls(0.0, 0, tuple(2.0 * pi * number / num_images for number in range(num_images)))

    def with_images(self, num_images: int) -> "Turn":
        """The same turn with another number of pictures in all: those that are missing are spread over its rest."""
        if num_images == len(self.points_rad):
            return self
        done = self.points_rad[: self.requested]
        begin_rad, missing = done[-1], num_images - self.requested
        spacing_rad = (2.0 * pi - begin_rad) / (missing + 1)
        return self._replace(points_rad=(*done, *(begin_rad + spacing_rad * (i + 1) for i in range(missing))))

    @property
    def spacing_min_rad(self) -> float:
        """Smallest angle between two points that are still to come."""
        left = (*self.points_rad[max(self.requested - 1, 0) :], 2.0 * pi)
        return min(other - one for one, other in pairwise(left))


class GetImages:
    """Flies around `center_ned_m`. In the rover's frame the whole flight moves with the rover.

    Args:
        speed_mps: along the circle.
        turn: progress of the turn, which is under way for a goal that was modified.
    """

    def __init__(
        self,
        goal: GetImagesGoal,
        speed_mps: float,
        turn: Turn,
        capture: Capture,
        config: ActionsConfig,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._goal = goal
        self._speed_mps = speed_mps
        self._turn = turn
        self.capture = capture
        self._config = config
        self._yaw_start_rad = state.yaw_rad
        self._flight: OrbitFlight | None = None
        """None until the goal's frame is known."""

    @property
    def turn(self) -> Turn:
        """Progress of the turn."""
        return self._turn if self._flight is None else self._flight.turn

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if self._goal.frame == "rover":
            return step_in_rover_frame(self._fly, t_ns, state)
        return self._fly(t_ns, state)

    def remaining(self, state: VehicleState) -> Remaining | None:
        return None if self._flight is None else self._flight.remaining()

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The way to the circle, and around the circle."""
        if self._flight is None:
            return ()
        way_ned_m = self._flight.path()
        if self._goal.frame == "rover":
            if state.relative is None:
                return ()
            origin_ned_m = rover_position(state, state.relative)
            way_ned_m = tuple(add(point_m, origin_ned_m) for point_m in way_ned_m)
        return (state.pos_uav_ned_m, *way_ned_m)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> ImagesResult:
        return ImagesResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m, images=self.capture.images())

    def _fly(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Step the flight; state and result are in the goal's frame."""
        if self._flight is None:
            self.capture.planned = self._goal.num_images
            self._flight = OrbitFlight(
                t_ns,
                state,
                goal=self._goal,
                speed_mps=self._speed_mps,
                yaw_start_rad=self._yaw_start_rad,
                turn=self._turn,
                capture=self.capture,
                config=self._config,
            )
        return self._flight.step(t_ns, state)


class OrbitFlight:
    """One flight to the orbit and around it; positions and velocities are in the goal's frame.

    Args:
        speed_mps: along the circle.
        yaw_start_rad: heading setpoint at the start.

    Attributes:
        turn: progress of the turn.
    """

    def __init__(
        self,
        t_ns: int,
        state: VehicleState,
        *,
        goal: GetImagesGoal,
        speed_mps: float,
        yaw_start_rad: float,
        turn: Turn,
        capture: Capture,
        config: ActionsConfig,
    ) -> None:
        self._goal = goal
        self._capture = capture
        self._move_config = config.move
        self._yaw_rad = yaw_start_rad
        self._arrival = ArrivalDetector(config.move, SETTLED_S)
        self._arrived_ns: int | None = None
        """Start of the turn; None on the way to it."""
        self.turn = turn
        pos_ned_m, move = state.pos_uav_ned_m, config.move
        self._phase_rad = nearest_phase(goal.center_ned_m, pos_ned_m, state.yaw_rad)
        self._orbit = Orbit(
            goal.center_ned_m,
            goal.radius_m,
            self._phase_rad,
            speed_mps,
            config.get_images.acceleration_mps2,
            max(2.0 * pi - turn.turned_rad, 0.0),
        )
        start_ned_m = self._orbit.at(0.0).pos_ned_m
        straight_mps = straight_speed_mps(pos_ned_m, start_ned_m, config.go_to.speed_mps, move)
        self._way_in = TimedStraightPath(pos_ned_m, start_ned_m, straight_mps, move.accel_mps2)
        self._tracker = Tracker(t_ns, config.tracking)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Next setpoint, or the end."""
        dt_s = self._tracker.advance(t_ns, self._path.at(self._tracker.time_s), state)
        if problem := self._tracker.stuck(t_ns):
            return Done("aborted", problem)
        if self._arrived_ns is None:
            self._settle(t_ns, state)
        elif self._go_around(t_ns, state):
            return Done("succeeded", hover_pos_ned_m=self._end_ned_m)
        return self._move(dt_s, state)

    @property
    def _end_ned_m(self) -> Vec3:
        """Where the flight ends: at the end of the turn, or where it would begin for a single picture."""
        orbit = self._orbit
        return orbit.at(orbit.profile.duration_s if self._goal.num_images > 1 else 0.0).pos_ned_m

    def remaining(self) -> Remaining:
        """Rest of the way to the orbit and around it; a goal with one picture ends where the turn would begin."""
        goal, time_s = self._goal, self._tracker.time_s
        turn = self._orbit.profile.remaining(0.0 if self._arrived_ns is None else time_s)
        turn = turn if goal.num_images > 1 else Remaining(0.0, 0.0)
        if self._arrived_ns is not None:
            return turn
        way_in = self._way_in.profile.remaining(time_s)
        yaw_rad, _ = facing(self._way_in.end_ned_m, (0.0, 0.0, 0.0), self._orbit.center_ned_m)
        face_s = abs(wrap_pi(yaw_rad - self._yaw_rad)) / self._move_config.yaw_rate_rps
        return Remaining(max(way_in.time_s, face_s) + SETTLED_S, way_in.distance_m) + turn

    def path(self) -> tuple[Vec3, ...]:
        """Corners of the way from the first point of the circle on; a goal with one picture ends there."""
        orbit, start_ned_m = self._orbit, self._way_in.end_ned_m
        if self._goal.num_images == 1:
            return (start_ned_m,)
        step_s = orbit.profile.duration_s / PATH_CORNERS
        return (start_ned_m, *(orbit.at(step_s * i).pos_ned_m for i in range(1, PATH_CORNERS + 1)))

    def _settle(self, t_ns: int, state: VehicleState) -> None:
        """Begin the turn when the vehicle is at its first point and faces the centre."""
        end_ned_m = self._way_in.end_ned_m
        yaw_rad, _ = facing(end_ned_m, (0.0, 0.0, 0.0), self._orbit.center_ned_m)
        turned = abs(wrap_pi(yaw_rad - state.yaw_rad)) < SETTLED_RAD
        error_ned_m = subtract(end_ned_m, position_now(state))
        wind_mps = state.wind_in_gusts_mps
        if self._arrival.update(t_ns, error_ned_m, state.vel_uav_ned_mps, turned=turned, wind_mps=wind_mps):
            self._arrived_ns = t_ns
            self._tracker.restart(t_ns)

    def _go_around(self, t_ns: int, state: VehicleState) -> bool:
        """Request the pictures whose points the vehicle has passed; returns whether the turn is complete."""
        goal, orbit = self._goal, self._orbit
        north_m, east_m, _ = subtract(position_now(state), orbit.center_ned_m)
        phase_rad = nearest_phase((0.0, 0.0, 0.0), (north_m, east_m, 0.0), state.yaw_rad)
        turned_rad = self.turn.turned_rad + wrap_pi(phase_rad - self._phase_rad)
        requested, points_rad = self.turn.requested, self.turn.points_rad
        self._phase_rad = phase_rad
        over = self._tracker.time_s >= orbit.profile.duration_s
        while requested < goal.num_images:
            if requested > 0 and turned_rad < points_rad[requested] and not over:
                break
            self._capture.request(requested, t_ns)
            requested += 1
        self.turn = self.turn._replace(turned_rad=turned_rad, requested=requested)
        done = requested == goal.num_images and not self._capture.is_waiting
        return done and (over or goal.num_images == 1)

    @property
    def _path(self) -> "TimedStraightPath | Orbit":
        """The way to the orbit, then the orbit."""
        return self._way_in if self._arrived_ns is None else self._orbit

    def _move(self, dt_s: float, state: VehicleState) -> Move:
        goal = self._goal
        reference = self._path.at(self._tracker.time_s)
        lead_ned_mps = scale(reference.acc_ned_mps2, VELOCITY_LEAD_S)
        reference = reference._replace(vel_ned_mps=add(reference.vel_ned_mps, lead_ned_mps))
        vel_ned_mps, acc_ned_mps2 = self._tracker.command(dt_s, reference, state)
        yaw_rad, yaw_rate_rps = self._heading(dt_s, state)
        target_ned_m = (goal.center_ned_m[0], goal.center_ned_m[1], goal.target_z_ned_m)
        way_ned_m = subtract(target_ned_m, self._capture.pos_camera(position_now(state), state.q_ned_from_frd))
        pitch_rad, roll_rad = aim(state.q_ned_from_frd, way_ned_m, ROLL_CAMERA_MAX_RAD)
        return Move(
            Phase.GET_IMAGES,
            ImagesFeedback(pos_uav_ned_m=state.pos_uav_ned_m, frame=goal.frame, taken=0, planned=goal.num_images),
            vel_ned_mps=vel_ned_mps,
            acc_ned_mps2=acc_ned_mps2,
            yaw_rad=yaw_rad,
            yaw_rate_rps=yaw_rate_rps,
            target_ned_m=reference.pos_ned_m,
            pitch_camera_rad=pitch_rad,
            roll_camera_rad=roll_rad,
        )

    def _heading(self, dt_s: float, state: VehicleState) -> tuple[float, float]:
        """Heading and its rate: towards the centre; on the way to the orbit it turns slowly to that heading."""
        center_ned_m = self._goal.center_ned_m
        if self._arrived_ns is not None:
            self._yaw_rad, rate_rps = facing(position_now(state), state.vel_uav_ned_mps, center_ned_m)
            return self._yaw_rad, rate_rps
        wanted_rad, _ = facing(self._way_in.end_ned_m, (0.0, 0.0, 0.0), center_ned_m)
        reach_rad = self._move_config.yaw_rate_rps * dt_s
        turn_rad = wrap_pi(wanted_rad - self._yaw_rad)
        self._yaw_rad = wrap_pi(self._yaw_rad + min(reach_rad, max(-reach_rad, turn_rad)))
        return self._yaw_rad, 0.0


class Orbit:
    """One turn around a centre at constant height, clockwise as seen from above.

    Args:
        center_ned_m: (3,) its z is the orbit's.
        phase_rad: angle at which the turn begins, from north, positive towards east.
        turn_rad: how far it leads around the centre.
    """

    def __init__(
        self,
        center_ned_m: Vec3,
        radius_m: float,
        phase_rad: float,
        speed_mps: float,
        acceleration_mps2: float,
        turn_rad: float = 2.0 * pi,
    ) -> None:
        self.center_ned_m = center_ned_m
        self.radius_m = radius_m
        self.phase_rad = phase_rad
        self.profile = SpeedProfile(turn_rad * radius_m, speed_mps, acceleration_mps2)

    def at(self, time_s: float) -> Reference:
        """Reference at a time since the begin of the turn."""
        way_m, speed_mps, acceleration_mps2 = self.profile.at(time_s)
        angle_rad = self.phase_rad + way_m / self.radius_m
        c, s, inwards_mps2 = cos(angle_rad), sin(angle_rad), speed_mps * speed_mps / self.radius_m
        north_m, east_m, down_m = self.center_ned_m
        return Reference(
            (north_m + self.radius_m * c, east_m + self.radius_m * s, down_m),
            (-speed_mps * s, speed_mps * c, 0.0),
            (-acceleration_mps2 * s - inwards_mps2 * c, acceleration_mps2 * c - inwards_mps2 * s, 0.0),
        )


def nearest_phase(center_ned_m: Vec3, pos_ned_m: Vec3, yaw_rad: float) -> float:
    """Angle of the nearest point of a circle; at its centre, of the point behind the vehicle."""
    north_m, east_m = pos_ned_m[0] - center_ned_m[0], pos_ned_m[1] - center_ned_m[1]
    return atan2(east_m, north_m) if hypot(north_m, east_m) > 0.1 else wrap_pi(yaw_rad + pi)


def facing(pos_ned_m: Vec3, vel_ned_mps: Vec3, center_ned_m: Vec3) -> tuple[float, float]:
    """Heading towards a centre, rad, and its rate, rad/s."""
    north_m, east_m = center_ned_m[0] - pos_ned_m[0], center_ned_m[1] - pos_ned_m[1]
    square_m2 = max(north_m * north_m + east_m * east_m, 0.01)
    return atan2(east_m, north_m), (east_m * vel_ned_mps[0] - north_m * vel_ned_mps[1]) / square_m2


def aim(q_ned_from_frd: Quat, way_ned_m: Vec3, roll_max_rad: float) -> tuple[float, float]:
    """Pitch and roll of the camera that put a target in the middle of the picture, within the axes' limits.

    Args:
        way_ned_m: (3,) from the camera to the target.
        roll_max_rad: limit of the roll axis.
    """
    forward_m, right_m, down_m = quat_rotate(quat_conjugate(q_ned_from_frd), way_ned_m)
    roll_rad = -atan2(right_m, max(down_m, 1e-9))
    if abs(roll_rad) > roll_max_rad:
        roll_rad = copysign(roll_max_rad, roll_rad)
    below_m = down_m * cos(roll_rad) - right_m * sin(roll_rad)
    return min(0.0, max(-0.5 * pi, -atan2(below_m, forward_m))), roll_rad
