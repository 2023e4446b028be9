"""Drive commands on their way to the rover, which stops when none comes."""

from collections.abc import Sequence

import msgspec

from jezero.schemas.commands import RoverCommand
from jezero.schemas.units import NS_PER_S

AGE_MAX_NS = 300_000_000
LEAD_MAX_NS = 50_000_000
"""Clocks of two processes agree to this, so a command may arrive this much before its time stamp."""
TIMEOUT_NS = NS_PER_S // 2
"""The rover stops after this time without a command. Source: `RoverCommand`."""
STOP_PERIOD_NS = NS_PER_S // 2
"""The stop is sent again and again, as a line may lose it."""


class DriveCommands:
    """The newest command, and the lines that are due."""

    def __init__(self) -> None:
        self._newest_ns = -AGE_MAX_NS
        self._commanded_ns: int | None = None
        """Time of arrival of the last command; None while the rover stands."""
        self._stopped_ns: int | None = None

    def due(self, t_ns: int, wall_ns: int, commands: Sequence[RoverCommand]) -> bytes:
        """Lines to send now.

        Args:
            t_ns: vehicle time, in which the commands are stamped.
            wall_ns: monotonic time, by which the rover stops: vehicle time may stand still.
            commands: those that arrived; old ones, and ones that overtook each other, are dropped.
        """
        data = b""
        for command in commands:
            if command.t_ns >= self._newest_ns and -LEAD_MAX_NS <= t_ns - command.t_ns <= AGE_MAX_NS:
                self._newest_ns, self._commanded_ns, self._stopped_ns = command.t_ns, wall_ns, None
                data = line_of(command.speed_rover_body_mps, command.yaw_rate_rover_rps)
        if self._commanded_ns is not None and wall_ns - self._commanded_ns > TIMEOUT_NS:
            self._commanded_ns = None
        if self._commanded_ns is None:
            self._newest_ns = min(self._newest_ns, t_ns)  # a new epoch may begin earlier
            if self._stopped_ns is None or wall_ns - self._stopped_ns >= STOP_PERIOD_NS:
                self._stopped_ns = wall_ns
                data += line_of(0.0, 0.0)
        return data


def line_of(speed_mps: float, yaw_rate_rps: float) -> bytes:
    """A drive command as a line."""
    return msgspec.json.encode({"speed_mps": speed_mps, "yaw_rate_rps": yaw_rate_rps}) + b"\n"
