"""Looking back: the state of a vehicle at any time of a recording.

Times are seconds from the recording's first message. The state at a time is that of the last keyframe before it, with
the messages after the keyframe: a jump reads a few seconds of the recording, wherever it goes.
"""

import base64
import binascii
from bisect import bisect_right
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from jezero.base.plain_text import plain_json
from jezero.recording.channels import topic_of
from jezero.recording.foxglove import CompressedImage
from jezero.recording.mcap_file import McapFile, RawMessage
from jezero.schemas import topics
from jezero.schemas.health import ServiceHealth
from jezero.schemas.units import NS_PER_S
from jezero.services.ground_station.state import SHOWN, Event, ShownState

KEYFRAME_PERIOD_S = 5.0
PICTURE_AGE_MAX_S = 2.0
"""A jump reads the recording from this long before its time, to find the last picture; an older one is not shown."""
EVENTS_MAX = 1000
"""Later events are not marked, in a recording with more."""


@dataclass(frozen=True)
class Keyframe:
    """The state before the first message of a chunk.

    Attributes:
        t_s: time of that message.
        chunk_offset: place of the chunk in the file.
        state: the state.
    """

    t_s: float
    chunk_offset: int
    state: ShownState


@dataclass
class RecordedFlight:
    """What one pass over a recording finds.

    Attributes:
        path: the file.
        keyframes: states by time, the first one at the start.
        events: the events of the flight.
        duration_s: time of the last message.
        problem: what could not be read, or "".
    """

    path: Path
    keyframes: list[Keyframe] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    duration_s: float = 0.0
    problem: str = ""

    def __post_init__(self) -> None:
        self._file = McapFile(self.path)
        self._start_ns: int | None = None
        self._decoders: dict[str, msgspec.json.Decoder[Any] | None] = {}
        self._misfits = 0

    def index(self, on_progress: Callable[[float], None] = lambda fraction: None) -> None:
        """Read the whole file.

        Args:
            on_progress: called with the fraction of the file that was read.

        Raises:
            RecordingError: the file is no recording, or can't be read.
        """
        state, size_bytes = ShownState(), max(self.path.stat().st_size, 1)
        chunk_offset = -1
        for timed in self.messages(0):
            if self._file.chunk_offset != chunk_offset:
                chunk_offset = self._file.chunk_offset
                if not self.keyframes or timed.t_s >= self.keyframes[-1].t_s + KEYFRAME_PERIOD_S:
                    self.keyframes.append(Keyframe(timed.t_s, chunk_offset, deepcopy(state)))
                    on_progress(min(chunk_offset / size_bytes, 1.0))
            count = state.events.count
            self.update(state, timed)
            new = min(state.events.count - count, EVENTS_MAX - len(self.events))
            self.events.extend(reversed(state.events.newest_first[:new]))
            self.duration_s = timed.t_s
        self.problem = self._file.problem and f"{self._file.problem}: only what could be read is shown"
        if self._misfits:
            self.problem = (
                f"{self._misfits} messages of another version of jezero are not shown. {self.problem}".strip()
            )

    def messages(self, chunk_offset: int) -> "Iterator[TimedMessage]":
        """The messages from a chunk on."""
        for raw in self._file.messages(chunk_offset):
            if self._start_ns is None:
                self._start_ns = raw.logged_ns
            yield TimedMessage((raw.logged_ns - self._start_ns) / NS_PER_S, raw)

    def update(self, state: ShownState, timed: "TimedMessage") -> None:
        """Take a message into a state, if the pages show its topic."""
        topic = topic_of(timed.raw.topic)
        if topic is None:
            return
        if topic.name not in self._decoders:
            shown = topic in SHOWN or topic.struct is ServiceHealth or topic.name.endswith("/feedback")
            self._decoders[topic.name] = msgspec.json.Decoder(topic.type) if shown else None
        decoder = self._decoders[topic.name]
        if decoder is not None:
            try:
                state.update(timed.t_s, topic, decoder.decode(plain_json(timed.raw.data)))
            except msgspec.DecodeError:
                self._misfits += 1

    def keyframe_before(self, t_s: float) -> Keyframe:
        """The last keyframe that is not after a time, or the first one."""
        index = bisect_right(self.keyframes, t_s, key=lambda keyframe: keyframe.t_s)
        return self.keyframes[max(index - 1, 0)]


class TimedMessage(NamedTuple):
    """A message and its time."""

    t_s: float
    raw: RawMessage


class RecordedPicture(NamedTuple):
    """A picture of the camera as it was recorded.

    Attributes:
        t_s: its time.
        message: the encoded `CompressedImage`.
    """

    t_s: float
    message: bytes

    def decoded(self) -> tuple[str, bytes] | None:
        """Format ("jpeg" or "png") and content; None when the message is damaged."""
        try:
            image = msgspec.json.decode(self.message, type=CompressedImage)
            return image.format, base64.b64decode(image.data)
        except (msgspec.DecodeError, binascii.Error):
            return None


class Playback:
    """A place in a recording, which moves. One thread at a time may move it.

    Attributes:
        t_s: time of the place.
        state: the state at this time; another object after each move.
        picture: the newest picture; None when there is none of the last seconds.
    """

    def __init__(self, flight: RecordedFlight) -> None:
        self._flight = flight
        self.t_s = 0.0
        self.state = ShownState()
        self.picture: RecordedPicture | None = None
        self._begin(0.0)
        self.move_to(0.0)

    def _begin(self, t_s: float) -> None:
        """Go to the keyframe from which a time is reached."""
        keyframe = self._flight.keyframe_before(t_s - PICTURE_AGE_MAX_S)
        self._messages = self._flight.messages(keyframe.chunk_offset)
        self._next = next(self._messages, None)
        self._state = deepcopy(keyframe.state)
        self._picture: RecordedPicture | None = None
        self._reached_s = keyframe.t_s

    def move_to(self, t_s: float) -> None:
        """Move to a time; one that is not in the recording is its start or its end.

        Raises:
            RecordingError: the file can't be read any more.
        """
        t_s = min(max(t_s, 0.0), self._flight.duration_s)
        if not self._reached_s <= t_s <= self._reached_s + 2.0 * KEYFRAME_PERIOD_S:
            self._begin(t_s)
        while self._next is not None and self._next.t_s <= t_s:
            if self._next.raw.topic == topics.CAMERA.name:
                self._picture = RecordedPicture(self._next.t_s, self._next.raw.data)
            else:
                self._flight.update(self._state, self._next)
            self._next = next(self._messages, None)
        self._reached_s = self.t_s = t_s
        self.state = deepcopy(self._state)
        late = self._picture is not None and t_s - self._picture.t_s > PICTURE_AGE_MAX_S
        self.picture = None if late else self._picture
