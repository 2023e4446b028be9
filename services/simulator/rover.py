"""Motion of the rover: what its wheels make of the commands, and the platform that follows the ground or the waves."""

from collections.abc import Iterable
from math import atan, cos, radians, sin

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    scale,
    subtract,
    wrap_pi,
)
from jezero.schemas.commands import RoverCommand
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.body import RoverState
from jezero.services.simulator.config import RoverConfig
from jezero.services.simulator.sea import Sea
from jezero.services.simulator.terrain import Terrain

AGE_MAX_NS = 300_000_000
LEAD_MAX_NS = 50_000_000
"""Clocks of two processes agree to this, so a command may arrive this much before its time stamp."""
WHEEL_FORWARD_M, WHEEL_SIDE_M, WHEEL_WIDTH_M = 0.47, 0.49, 0.12
"""Places of the outer wheels from the rover's middle. Two more are between front and rear, and follow the ground."""
WHEEL_RADIUS_PER_HEIGHT = 0.24
"""Radius of a wheel, per height of the platform over the ground."""


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
    """Turns speed and yaw rate into the platform's pose; stands still unless driven or moved by waves.

    A rover that leans turns about the point of the ground, or of the water, below the middle of its platform.

    Args:
        height_platform_m: height of the platform's surface over the ground.
        sea: the waves on which the rover floats; None for a rover on the ground.
    """

    def __init__(self, config: RoverConfig, terrain: Terrain, height_platform_m: float, sea: Sea | None = None) -> None:
        self._terrain = terrain
        self._sea = sea
        self._t_s = 0.0
        self._height_platform_m = height_platform_m
        self._tilts_with_ground = config.tilts_with_ground
        tilt_rad, towards_rad = radians(config.tilt_deg), radians(config.tilt_towards_deg)
        self._q_level_from_platform = quat_from_rotation_vector(
            (tilt_rad * sin(towards_rad), -tilt_rad * cos(towards_rad), 0.0)
        )
        self.state = self.place(config.start_north_m, config.start_east_m, config.start_yaw_rad)

    def place(self, north_m: float, east_m: float, yaw_rad: float) -> RoverState:
        """Put the rover somewhere, at rest."""
        self._ground_m = (north_m, east_m)
        at_rest = (0.0, 0.0, 0.0)
        pos_ned_m, q_ned_from_rover_body = self._pose(yaw_rad)
        self.state = RoverState(pos_ned_m, at_rest, q_ned_from_rover_body, at_rest, yaw_rad, 0.0, 0.0)
        return self.state

    @property
    def moves_by_itself(self) -> bool:
        """Whether the platform moves while the rover isn't driven."""
        return self._sea is not None

    def drive(self, speed_mps: float, yaw_rate_rps: float, dt_s: float) -> RoverState:
        """Advance by one step along an arc; velocities in the result are means over this step."""
        before = self.state
        yaw_rad = before.yaw_rad
        middle_rad = yaw_rad + 0.5 * yaw_rate_rps * dt_s
        north_m, east_m = self._ground_m
        self._ground_m = (
            north_m + speed_mps * cos(middle_rad) * dt_s,
            east_m + speed_mps * sin(middle_rad) * dt_s,
        )
        self._t_s += dt_s
        yaw_rad = wrap_pi(yaw_rad + yaw_rate_rps * dt_s)
        pos_ned_m, q_ned_from_rover_body = self._pose(yaw_rad)
        _, x, y, z = quat_multiply(q_ned_from_rover_body, quat_conjugate(before.q_ned_from_rover_body))
        self.state = RoverState(
            pos_ned_m,
            scale(subtract(pos_ned_m, before.pos_ned_m), 1.0 / dt_s),
            q_ned_from_rover_body,
            scale((x, y, z), 2.0 / dt_s),
            yaw_rad,
            speed_mps,
            yaw_rate_rps,
        )
        return self.state

    def _pose(self, yaw_rad: float) -> tuple[Vec3, Quat]:
        """Position of the platform's middle and attitude of the platform, with its own tilt on the rover."""
        north_m, east_m = self._ground_m
        roll_rad = pitch_rad = 0.0
        if self._sea is not None:
            height_m, roll_rad, pitch_rad = self._sea.motion(self._t_s, north_m, east_m, yaw_rad)
        elif self._tilts_with_ground:
            height_m, roll_rad, pitch_rad = self._on_wheels(north_m, east_m, yaw_rad)
        else:
            height_m = self._terrain.height_m(north_m, east_m)
        q_ned_from_rover = quat_from_euler(roll_rad, pitch_rad, yaw_rad)
        platform_ned_m = quat_rotate(q_ned_from_rover, (0.0, 0.0, -self._height_platform_m))
        pos_ned_m = add((north_m, east_m, -height_m), platform_ned_m)
        return pos_ned_m, quat_multiply(q_ned_from_rover, self._q_level_from_platform)

    def _on_wheels(self, north_m: float, east_m: float, yaw_rad: float) -> tuple[float, float, float]:
        """Height of the rover's ground point, roll and pitch, of a rover that stands on its four wheels."""
        c, s = cos(yaw_rad), sin(yaw_rad)

        def height_m(forward_m: float, right_m: float) -> float:
            wheel_north_m, wheel_east_m = c * forward_m - s * right_m, s * forward_m + c * right_m
            radius_m = WHEEL_RADIUS_PER_HEIGHT * self._height_platform_m
            return self._terrain.height_of_wheel_m(north_m + wheel_north_m, east_m + wheel_east_m, radius_m)

        front_left_m, front_right_m = height_m(WHEEL_FORWARD_M, -WHEEL_SIDE_M), height_m(WHEEL_FORWARD_M, WHEEL_SIDE_M)
        rear_left_m, rear_right_m = height_m(-WHEEL_FORWARD_M, -WHEEL_SIDE_M), height_m(-WHEEL_FORWARD_M, WHEEL_SIDE_M)
        front_m, rear_m = 0.5 * (front_left_m + front_right_m), 0.5 * (rear_left_m + rear_right_m)
        left_m, right_m = 0.5 * (front_left_m + rear_left_m), 0.5 * (front_right_m + rear_right_m)
        roll_rad = atan(0.5 * (left_m - right_m) / WHEEL_SIDE_M)
        pitch_rad = atan(0.5 * (front_m - rear_m) / WHEEL_FORWARD_M)
        return 0.5 * (front_m + rear_m), roll_rad, pitch_rad


def _nearer(value: float, target: float, step: float) -> float:
    return target if abs(target - value) <= step else value + (step if target > value else -step)
