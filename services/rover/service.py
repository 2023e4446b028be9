"""The rover's computer in a simulation: it passes the rover's topics between its router and the simulator."""

from collections.abc import Iterator
from dataclasses import replace

from jezero.base.rover_link import MessageLines, line_of
from jezero.runtime.service import Health, Inbox, Output, Publish, Send, Spec
from jezero.schemas import topics
from jezero.schemas.sensors import RoverOdometry

SIMULATOR = "simulator"

SPEC = Spec(
    name="rover",
    inputs=(topics.ROVER_COMMAND,),
    outputs=(topics.ROVER_ODOMETRY,),
    links=(SIMULATOR,),
    triggers=(topics.ROVER_COMMAND.name, SIMULATOR),
)


class RoverComputer:
    """Plays the driver of a rover: publishes the odometry of the simulated rover, and drives it by the bus's commands.

    On a real rover the driver of that rover publishes `rover/odometry` and reads `rover/command` in its place.

    Args:
        address: host and port of the simulator, for people; "" where a real rover has a driver: then it does nothing.
    """

    def __init__(self, address: str) -> None:
        links = (SIMULATOR,) if address else ()
        self.spec = replace(SPEC, links=links, made_with={"address": address})
        self._address = address
        self._lines = MessageLines(RoverOdometry)
        self._connections = 0
        self._reported: Health | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Publish what the simulator has sent, and send it what the bus commands."""
        if not self._address:
            if self._reported is None:
                self._reported = Health("ok", "not needed: rover_driver.toml names a real rover")
                yield self._reported
            return
        connections = inbox.connections(SIMULATOR)
        if connections != self._connections:  # what the lost connection has begun is not continued
            self._connections = connections
            self._lines = MessageLines(RoverOdometry)
        for odometry in self._lines.receive(inbox.received(SIMULATOR)):
            yield Publish(topics.ROVER_ODOMETRY, odometry)
        up = inbox.is_up(SIMULATOR)
        if up:
            for command in inbox.new(topics.ROVER_COMMAND):
                yield Send(SIMULATOR, line_of(command))
        health = self._health(up)
        if health != self._reported:
            self._reported = health
            yield health

    def _health(self, up: bool) -> Health:
        if up:
            return Health("ok", f"connected to the simulator at {self._address}{self._lines.dropped_text}")
        return Health(
            "degraded",
            f"no connection to the simulator at {self._address}: start it, or set JEZERO_SIMULATOR to its host",
        )
