"""The log of a flight: one line of JSON per message, as it was on the bus."""

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import msgspec

from jezero.codec import split_attachment
from jezero.os_errors import naming
from jezero.schemas.topics import ACTIONS, CAMERA, SCENE, TOPICS, feedback_of

LOG = "flight.jsonl"
"""Name of the log in the folder of a run."""
FEEDBACK = tuple(feedback_of(action) for action in ACTIONS.values())
RECORDED = tuple(topic for topic in (*TOPICS, *FEEDBACK) if topic not in (CAMERA, SCENE))
"""Topics that are recorded: all but images and the topics that belong to them."""
_TYPES: dict[str, Any] = {topic.name: topic.type for topic in (*TOPICS, *FEEDBACK)}


class Entry(NamedTuple):
    """One logged message.

    Attributes:
        logged_ns: time of logging, on the log's own clock.
        topic: name of the topic.
        message: the message.
    """

    logged_ns: int
    topic: str
    message: Any


class _Line(msgspec.Struct, frozen=True):
    logged_ns: int
    topic: str
    message: msgspec.Raw


def line(logged_ns: int, topic: str, data: bytes) -> bytes:
    """One line of a log. `data` is the encoded message; of an image only the header is logged."""
    message, _ = split_attachment(data)
    return b'{"logged_ns":%d,"topic":"%s","message":%s}\n' % (logged_ns, topic.encode(), message)


class LogWriter:
    """Writer of a log file; a context manager."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        self._file = path.open("wb")

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with naming(self._path):
            self._file.close()

    def write(self, logged_ns: int, topic: str, data: bytes) -> None:
        """Add one message."""
        try:  # a context manager takes longer than the write
            self._file.write(line(logged_ns, topic, data))
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._path)) from None


def read_log(path: Path) -> Iterator[Entry]:
    """Read the messages of declared topics in the order of the log; an incomplete last line is left out.

    Raises:
        FileNotFoundError: there is no such log.
        msgspec.DecodeError: a line is not of a flight's log.
    """
    lines = path.read_bytes().split(b"\n")
    decoder = msgspec.json.Decoder(_Line)
    for text in lines[:-1]:
        entry = decoder.decode(text)
        kind = _TYPES.get(entry.topic)
        if kind is not None:
            yield Entry(entry.logged_ns, entry.topic, msgspec.json.decode(entry.message, type=kind))
