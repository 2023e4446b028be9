"""Motion of the rover: what its wheels make of the commands, and the platform that follows the ground."""

from collections.abc import Iterable
from math import atan, cos, radians, sin

from jezero.base.frames import (
    Quat,
    Vec3,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    scale,
    wrap_pi,
)
from jezero.schemas.commands import RoverCommand
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.body import RoverState
from jezero.services.simulator.config import RoverConfig
from jezero.services.simulator.terrain import Terrain

AGE_MAX_NS = 300_000_000
LEAD_MAX_NS = 50_000_000
"""Clocks of two processes agree to this, so a command may arrive this much before its time stamp."""
WHEELBASE_HALF_M = 0.4
"""Distance from the rover's middle at which its front, rear and side wheels touch the ground."""


class Drive:
    """Speed and yaw rate of the rover: bounded acceleration towards its newest command, and a stop without commands.

    Attributes:
        speed_mps: present speed of the wheels.
        yaw_rate_rps: present yaw rate.
    """

    def __init__(self, config: RoverConfig) -> None:
        self.speed_mps = 0.0
        self.yaw_rate_rps = 0.0
        self._config = config
        self._command: RoverCommand | None = None

    @property
    def moves(self) -> bool:
        return self.speed_mps != 0.0 or self.yaw_rate_rps != 0.0

    def update(self, t_ns: int, commands: Iterable[RoverCommand]) -> None:
        """Commands that arrived; those that are older than 0.3 s, or than the present one, change nothing."""
        for command in commands:
            newer = self._command is None or command.t_ns >= self._command.t_ns
            if newer and -LEAD_MAX_NS <= t_ns - command.t_ns <= AGE_MAX_NS:
                self._command = command

    def step(self, t_ns: int, dt_s: float) -> None:
        """Change speed and yaw rate towards the command, as far as the acceleration allows in `dt_s`."""
        config, command = self._config, self._command
        if command is not None and t_ns - command.t_ns > config.command_timeout_s * NS_PER_S:
            self._command = command = None
        speed_mps = 0.0 if command is None else command.speed_rover_body_mps
        yaw_rate_rps = 0.0 if command is None else command.yaw_rate_rover_rps
        self.speed_mps = _nearer(self.speed_mps, speed_mps, config.acc_max_mps2 * dt_s)
        self.yaw_rate_rps = _nearer(self.yaw_rate_rps, yaw_rate_rps, config.acc_yaw_max_rps2 * dt_s)


class RoverModel:
    """Turns speed and yaw rate into the platform's pose; stands still unless driven.

    Args:
        height_platform_m: height of the platform's surface over the ground.
    """

    def __init__(self, config: RoverConfig, terrain: Terrain, height_platform_m: float) -> None:
        self._terrain = terrain
        self._height_platform_m = height_platform_m
        self._tilts_with_ground = config.tilts_with_ground
        tilt_rad, towards_rad = radians(config.tilt_deg), radians(config.tilt_towards_deg)
        self._q_level_from_platform = quat_from_rotation_vector(
            (tilt_rad * sin(towards_rad), -tilt_rad * cos(towards_rad), 0.0)
        )
        self.state = self.place(config.start_north_m, config.start_east_m, config.start_yaw_rad)

    def place(self, north_m: float, east_m: float, yaw_rad: float) -> RoverState:
        """Put the rover somewhere, at rest."""
        at_rest = (0.0, 0.0, 0.0)
        attitude = self._attitude(north_m, east_m, yaw_rad)
        self.state = RoverState(self._pos_ned_m(north_m, east_m), at_rest, attitude, at_rest, yaw_rad, 0.0, 0.0)
        return self.state

    def drive(self, speed_mps: float, yaw_rate_rps: float, dt_s: float) -> RoverState:
        """Advance by one step along an arc; velocities in the result are means over this step."""
        before = self.state
        (north_m, east_m, down_m), yaw_rad = before.pos_ned_m, before.yaw_rad
        middle_rad = yaw_rad + 0.5 * yaw_rate_rps * dt_s
        vel_north_mps, vel_east_mps = speed_mps * cos(middle_rad), speed_mps * sin(middle_rad)
        pos_ned_m = self._pos_ned_m(north_m + vel_north_mps * dt_s, east_m + vel_east_mps * dt_s)
        yaw_rad = wrap_pi(yaw_rad + yaw_rate_rps * dt_s)
        q_ned_from_rover_body = self._attitude(pos_ned_m[0], pos_ned_m[1], yaw_rad)
        _, x, y, z = quat_multiply(q_ned_from_rover_body, quat_conjugate(before.q_ned_from_rover_body))
        self.state = RoverState(
            pos_ned_m,
            (vel_north_mps, vel_east_mps, (pos_ned_m[2] - down_m) / dt_s),
            q_ned_from_rover_body,
            scale((x, y, z), 2.0 / dt_s),
            yaw_rad,
            speed_mps,
            yaw_rate_rps,
        )
        return self.state

    def _pos_ned_m(self, north_m: float, east_m: float) -> Vec3:
        return (north_m, east_m, -self._terrain.height_m(north_m, east_m) - self._height_platform_m)

    def _attitude(self, north_m: float, east_m: float, yaw_rad: float) -> Quat:
        """Attitude of the platform at a place: that of the rover, and the platform's tilt on it."""
        pitch_rad = roll_rad = 0.0
        if self._tilts_with_ground:
            c, s = WHEELBASE_HALF_M * cos(yaw_rad), WHEELBASE_HALF_M * sin(yaw_rad)
            pitch_rad = self._slope_rad(north_m, east_m, c, s)
            roll_rad = -self._slope_rad(north_m, east_m, -s, c)
        return quat_multiply(quat_from_euler(roll_rad, pitch_rad, yaw_rad), self._q_level_from_platform)

    def _slope_rad(self, north_m: float, east_m: float, step_north_m: float, step_east_m: float) -> float:
        """Angle by which the ground rises from one side of the rover to the other."""
        height_m = self._terrain.height_m
        rise_m = height_m(north_m + step_north_m, east_m + step_east_m) - height_m(
            north_m - step_north_m, east_m - step_east_m
        )
        return atan(0.5 * rise_m / WHEELBASE_HALF_M)


def _nearer(value: float, target: float, step: float) -> float:
    return target if abs(target - value) <= step else value + (step if target > value else -step)
