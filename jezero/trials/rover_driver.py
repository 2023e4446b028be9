"""Service that drives the rover in virtual time, as `jezero rover drive` does on the Zenoh bus."""

from collections.abc import Iterable

from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas.commands import RoverCommand
from jezero.schemas.topics import ROVER_COMMAND
from jezero.schemas.units import NS_PER_S


class RoverDriver:
    """Publishes the rover's command ten times a second.

    Attributes:
        speed_mps: forward speed of the next commands; None publishes no command.
        yaw_rate_rps: yaw rate of the next commands, clockwise seen from above.
        reverse_s: time after which the yaw rate changes its sign, again and again; None keeps it.
    """

    spec = Spec(name="rover_driver", outputs=(ROVER_COMMAND,), rate_hz=10.0)

    def __init__(self) -> None:
        self.speed_mps: float | None = None
        self.yaw_rate_rps = 0.0
        self.reverse_s: float | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Publish one command."""
        if self.speed_mps is not None:
            reversed_now = self.reverse_s is not None and int(t_ns / (self.reverse_s * NS_PER_S)) % 2 == 1
            yaw_rate_rps = -self.yaw_rate_rps if reversed_now else self.yaw_rate_rps
            command = RoverCommand(t_ns=t_ns, speed_rover_body_mps=self.speed_mps, yaw_rate_rover_rps=yaw_rate_rps)
            yield Publish(ROVER_COMMAND, command)
