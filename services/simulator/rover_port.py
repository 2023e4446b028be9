"""The simulator's side of the rover's two topics: on the bus, or on the link to the rover's computer."""

from collections.abc import Sequence

from jezero.base.rover_link import MessageLines, line_of
from jezero.runtime.service import Inbox, Publish, Send
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.schemas.topics import ROVER_COMMAND, ROVER_ODOMETRY

ROVER = "rover"


class RoverPort:
    """Where odometry goes and commands come from: while the rover's computer is connected, its link alone.

    So no reading is published twice, and a command counts only if the rover's computer has received it.

    Attributes:
        text: state of the link for people, to be appended to a sentence; "" before the first connection.
    """

    def __init__(self) -> None:
        self.text = ""
        self._up = False
        self._connections = 0
        self._lines = MessageLines(RoverCommand)

    def commands(self, inbox: Inbox) -> Sequence[RoverCommand]:
        """New commands, oldest first."""
        connections = inbox.connections(ROVER)
        if connections != self._connections:  # what the lost connection has begun is not continued
            self._connections = connections
            self._lines = MessageLines(RoverCommand)
        self._up = inbox.is_up(ROVER)
        commands = self._lines.receive(inbox.received(ROVER)) if self._up else inbox.new(ROVER_COMMAND)
        if self._up:
            self.text = f"; the rover's computer is connected{self._lines.dropped_text}"
        elif connections:
            self.text = "; the rover's computer is gone: its topics are the simulator's until it connects again"
        return commands

    def odometry(self, odometry: RoverOdometry) -> Send | Publish:
        """The output that carries a reading."""
        return Send(ROVER, line_of(odometry)) if self._up else Publish(ROVER_ODOMETRY, odometry)
