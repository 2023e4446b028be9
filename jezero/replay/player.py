"""The messages of a recording that were on the bus, and when each of them is published again."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from jezero.recording.channels import topic_of
from jezero.recording.images import HEADERS
from jezero.recording.mcap_file import McapFile, RecordingError
from jezero.schemas.topics import (
    CAMERA,
    CAMERA_PITCH,
    CLOCK,
    ROVER_COMMAND,
    SETPOINT,
    VELOCITY_COMMAND,
    health_of,
    journal_of,
)
from jezero.schemas.units import NS_PER_S

STEP_NS = NS_PER_S // 10
"""Time of the flight that one step plays: the period of the clock and of the status."""
LATENESS_MAX_NS = NS_PER_S // 2
"""A player that is later, e.g. because its process was stopped, doesn't catch up."""
COMMANDS = frozenset(topic.name for topic in (CLOCK, SETPOINT, CAMERA_PITCH, ROVER_COMMAND, VELOCITY_COMMAND))
"""Topics that move something, or vehicle time, where a service reads them."""
_JOURNAL, _ROUTER = journal_of("").name, health_of("router").name


class ReplayMessage(NamedTuple):
    """One message to be published.

    Attributes:
        at_ns: time from the recording's first message.
        topic: name of the topic.
        data: the message, byte by byte as it was published; of an image, its fields without the pixels.
        image: the compressed image in a `foxglove.CompressedImage`; b"" for other messages.
    """

    at_ns: int
    topic: str
    data: bytes
    image: bytes = b""


def is_published(channel: str) -> bool:
    """Whether the messages of a recorded channel are published by a replay.

    Those of the recorder itself were on no topic: journals, the scene for viewers, the images' headers. The bus of the
    replay has a router with a health of its own.
    """
    own = channel.startswith(_JOURNAL) or channel in (HEADERS, _ROUTER)
    return not own and topic_of(channel) is not None


def choose_topics(path: Path, recorded: Iterable[str], wanted: Sequence[str]) -> frozenset[str]:
    """The topics to publish.

    Args:
        path: the recording, for the text of errors.
        recorded: all channels of the recording.
        wanted: topics that were asked for; none means all.

    Raises:
        RecordingError: a topic is not in the recording, or is none that a replay publishes, or there is none at all.
    """
    there = [channel for channel in recorded if is_published(channel)]
    if unknown := [topic for topic in wanted if topic not in there]:
        raise RecordingError(
            f"{path} has no topic {unknown[0]!r} that can be replayed; its topics: {', '.join(there) or 'none'}"
        )
    if not there:
        raise RecordingError(f"{path} has no messages of jezero's topics")
    return frozenset(wanted or there)


def replay_messages(
    path: Path, topics: Collection[str], start_ns: int = 0, end_ns: int | None = None
) -> Iterator[ReplayMessage]:
    """The messages of some topics in the order of the recording.

    Args:
        start_ns: time from the recording's first message at which to start.
        end_ns: time from the recording's first message at which to end; None for all.

    Raises:
        RecordingError: the file can't be read.
    """
    first_ns: int | None = None
    header = b""
    for raw in McapFile(path).messages():
        first_ns = raw.logged_ns if first_ns is None else first_ns
        at_ns = raw.logged_ns - first_ns
        if end_ns is not None and at_ns > end_ns:
            return
        if raw.topic == HEADERS:
            header = raw.data
        elif raw.topic not in topics or at_ns < start_ns:
            continue
        elif raw.topic != CAMERA.name:
            yield ReplayMessage(at_ns, raw.topic, raw.data)
        elif header:
            yield ReplayMessage(at_ns, raw.topic, header, raw.data)


class Player:
    """Decides when each message is due; it is given the time.

    Args:
        read: gives the messages of the flight's part from its start; called once for each pass.
        start_ns: start of the part, from the recording's first message.
        end_ns: end of the part.
        now_ns: present time on any clock that never steps.
        speed: seconds of the flight per second.
        loop: begin again at the end.

    Attributes:
        paused: whether no message becomes due by itself.
        ended: whether there will be no more messages.
    """

    def __init__(
        self,
        read: Callable[[], Iterator[ReplayMessage]],
        start_ns: int,
        end_ns: int,
        now_ns: int,
        *,
        speed: float = 1.0,
        loop: bool = False,
    ) -> None:
        self.paused = False
        self.ended = False
        self._read = read
        self._start_ns = start_ns
        self._pass_ns = max(end_ns - start_ns, STEP_NS)
        self._speed = speed
        self._loop = loop
        self._messages = read()
        self._passes_ns = 0
        """Played time at which the present pass began."""
        self._played_ns, self._since_ns = 0, now_ns
        """Played time, over all passes, at a time of the clock."""
        self._next: ReplayMessage | None = next(self._messages, None)
        self.ended = self._next is None

    def position_ns(self, now_ns: int) -> int:
        """Time in the flight, from the recording's first message."""
        played_ns = self._played(now_ns)
        return self._start_ns + (played_ns % self._pass_ns if self._loop else min(played_ns, self._pass_ns))

    def take(self, now_ns: int) -> ReplayMessage | None:
        """The next message, if it is due now."""
        message = self._next
        if message is None:
            return None
        due_ns, played_ns = self._due_ns(message), self._played(now_ns)
        if due_ns > played_ns:
            return None
        if not self.paused and played_ns - due_ns > LATENESS_MAX_NS * self._speed:
            self._played_ns, self._since_ns = due_ns, now_ns
        self._advance()
        return message

    def wait_s(self, now_ns: int) -> float | None:
        """Time until the next message is due; None when that is unknown, in a pause."""
        if self.paused or self._next is None:
            return None
        return max(self._due_ns(self._next) - self._played(now_ns), 0) / (self._speed * NS_PER_S)

    def pause(self, now_ns: int) -> None:
        """Let no message become due by itself."""
        self._played_ns, self._since_ns = self._played(now_ns), now_ns
        self.paused = True

    def resume(self, now_ns: int) -> None:
        """Go on after a pause."""
        self._since_ns = now_ns if self.paused else self._since_ns
        self.paused = False

    def step(self, now_ns: int) -> None:
        """Pause, and let the messages of the next `STEP_NS` be due; where there are none, those of the next time."""
        self.pause(now_ns)
        if self._next is not None:
            self._played_ns = max(self._played_ns + STEP_NS, self._due_ns(self._next))

    def _played(self, now_ns: int) -> int:
        return self._played_ns if self.paused else self._played_ns + int((now_ns - self._since_ns) * self._speed)

    def _due_ns(self, message: ReplayMessage) -> int:
        return self._passes_ns + message.at_ns - self._start_ns

    def _advance(self) -> None:
        self._next = next(self._messages, None)
        if self._next is None and self._loop:
            self._passes_ns += self._pass_ns
            self._messages = self._read()
            self._next = next(self._messages, None)
        self.ended = self._next is None
