"""Speed and yaw rate of the rover: bounded acceleration towards its newest command, and a stop without commands."""

from collections.abc import Iterable

from jezero.schemas.commands import RoverCommand
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.config import RoverConfig

AGE_MAX_NS = 300_000_000
LEAD_MAX_NS = 50_000_000
"""Clocks of two processes agree to this, so a command may arrive this much before its time stamp."""


class Drive:
    """The newest command, and the speed and yaw rate that the wheels have reached.

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


def _nearer(value: float, target: float, step: float) -> float:
    return target if abs(target - value) <= step else value + (step if target > value else -step)
