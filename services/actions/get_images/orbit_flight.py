"""The flight around a target, in the goal's frame.

The vehicle flies straight to the orbit's nearest point, then one turn with velocity setpoints, facing the centre; the
camera's axes keep the target in the middle of the picture.
"""

from math import pi

from jezero.frames import Vec3, add, scale, subtract, wrap_pi
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GetImagesGoal, ImagesFeedback
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.get_images.orbit import Orbit, Turn, aim, facing, nearest_phase
from jezero.services.actions.motion.arrival import ArrivalDetector
from jezero.services.actions.motion.behaviour import Done, Move, Remaining, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.straight_path import TimedStraightPath, profile_remaining, straight_speed_mps
from jezero.services.actions.motion.tracking import Tracker, position_now

SETTLED_RAD, SETTLED_S = 0.035, 0.5
"""The turn begins when the vehicle has faced the centre within this heading error for this duration."""
VELOCITY_LEAD_S = 0.11
"""Time by which the velocity setpoints are ahead, because the vehicle's velocity follows them late by that much;
without it, the vehicle is carried out of the circle."""
PATH_CORNERS = 24
ROLL_CAMERA_MAX_RAD = 0.6
"""Limit of the camera's roll axis."""


class OrbitFlight:
    """One flight to the orbit and around it; positions and velocities are in the goal's frame.

    Args:
        speed_mps: along the circle.
        yaw_start_rad: heading setpoint at the start.
        turn: its progress so far.
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
        settings: GetImagesConfig,
        config: ActionsConfig,
    ) -> None:
        self._goal = goal
        self._capture = capture
        self._move_config = config.move
        self._yaw_rad = yaw_start_rad
        self._arrival = ArrivalDetector(config.move, SETTLED_S)
        self._arrived_ns: int | None = None
        """Start of the turn; None on the way to it."""
        self._turn = turn
        pos_ned_m, move = state.pos_uav_ned_m, config.move
        self._phase_rad = nearest_phase(goal.center_ned_m, pos_ned_m, state.yaw_rad)
        self._orbit = Orbit(
            goal.center_ned_m,
            goal.radius_m,
            self._phase_rad,
            speed_mps,
            settings.acceleration_mps2,
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
    def turn(self) -> Turn:
        """Progress of the turn."""
        return self._turn

    @property
    def _end_ned_m(self) -> Vec3:
        """Where the flight ends: at the end of the turn, or where it would begin for a single picture."""
        orbit = self._orbit
        return orbit.at(orbit.profile.duration_s if self._goal.num_images > 1 else 0.0).pos_ned_m

    def remaining(self) -> Remaining:
        """Rest of the way to the orbit and around it; a goal with one picture ends where the turn would begin."""
        goal, time_s = self._goal, self._tracker.time_s
        turn = profile_remaining(self._orbit.profile, 0.0 if self._arrived_ns is None else time_s)
        turn = turn if goal.num_images > 1 else Remaining(0.0, 0.0)
        if self._arrived_ns is not None:
            return turn
        way_in = self._way_in.remaining(time_s)
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
        turned_rad = self._turn.turned_rad + wrap_pi(phase_rad - self._phase_rad)
        requested, points_rad = self._turn.requested, self._turn.points_rad
        self._phase_rad = phase_rad
        over = self._tracker.time_s >= orbit.profile.duration_s
        while requested < goal.num_images:
            if requested > 0 and turned_rad < points_rad[requested] and not over:
                break
            self._capture.request(requested, t_ns)
            requested += 1
        self._turn = self._turn._replace(turned_rad=turned_rad, requested=requested)
        done = requested == goal.num_images and not self._capture.is_waiting
        return done and (over or goal.num_images == 1)

    @property
    def _path(self) -> TimedStraightPath | Orbit:
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
