"""Service that drives the rover in virtual time, as `jezero rover drive` does on the Zenoh bus."""

from collections.abc import Iterable

from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas.commands import RoverCommand
from jezero.schemas.topics import ROVER_COMMAND


class RoverDriver:
    """Publishes the rover's command ten times a second.

    Attributes:
        speed_mps: forward speed of the next commands; None publishes no command.
        yaw_rate_rps: yaw rate of the next commands, clockwise seen from above.
    """

    spec = Spec(name="rover_driver", outputs=(ROVER_COMMAND,), rate_hz=10.0)

    def __init__(self) -> None:
        self.speed_mps: float | None = None
        self.yaw_rate_rps = 0.0

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Publish one command."""
        if self.speed_mps is not None:
            command = RoverCommand(t_ns=t_ns, speed_rover_body_mps=self.speed_mps, yaw_rate_rover_rps=self.yaw_rate_rps)
            yield Publish(ROVER_COMMAND, command)
