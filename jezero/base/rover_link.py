"""The link between the simulator and the rover's computer: one JSON message a line, over TCP without TLS.

The simulator sends `RoverOdometry`, the rover's computer sends `RoverCommand`, as both are on the bus.
"""

from typing import Generic, TypeVar

from jezero.base.codec import BadPayloadError, decode, encode
from jezero.base.lines import Lines
from jezero.schemas.struct import Message

M = TypeVar("M", bound=Message)


def line_of(message: Message) -> bytes:
    """A message as a line.

    Raises:
        NotFiniteError: a float in it is NaN or infinite.
    """
    return encode(message) + b"\n"


class MessageLines(Generic[M]):
    """Reads the messages of one type that arrive over one connection.

    Attributes:
        dropped: number of lines so far that were too long or no message of this type.
    """

    def __init__(self, kind: type[M]) -> None:
        self._invalid = 0
        self._kind = kind
        self._lines = Lines()

    @property
    def dropped(self) -> int:
        return self._invalid + self._lines.too_long

    def receive(self, data: bytes) -> list[M]:
        """Messages of the lines that are complete with these bytes, oldest first."""
        messages: list[M] = []
        for line in self._lines.receive(data):
            try:
                messages.append(decode(self._kind, line))
            except BadPayloadError:
                self._invalid += 1
        return messages

    @property
    def dropped_text(self) -> str:
        """The dropped lines for people, to be appended to a sentence; "" without any."""
        return f"; {self.dropped} invalid messages dropped" if self.dropped else ""
