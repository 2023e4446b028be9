"""Reading recordings: typed messages by topic and time, tables, pictures."""

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import msgspec

from jezero.base.codec import BadPayloadError
from jezero.base.plain_text import plain_json
from jezero.recording.channels import topic_of, usable_actions
from jezero.recording.folder import RECORDINGS, newest_recording
from jezero.recording.goals import GoalCollector, RecordedGoal
from jezero.recording.images import HEADERS, decompress
from jezero.recording.mcap_file import McapFile, RawMessage, RecordingError
from jezero.recording.table import Table, make_table
from jezero.recording.writer import RECORDING
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import CAMERA, feedback_of, journal_of
from jezero.schemas.units import NS_PER_S

BAG_METADATA = "metadata.yaml"
"""File in the folder of a rosbag2."""


class Entry(NamedTuple):
    """One recorded message.

    Attributes:
        logged_ns: time of arrival, on the recording's own clock.
        topic: name of the topic.
        message: the message.
    """

    logged_ns: int
    topic: str
    message: Any


@dataclass(frozen=True)
class Summary:
    """What a recording holds.

    Attributes:
        about: what was recorded: vehicle, seed, version of jezero and so on.
        counts: number of messages of each topic, sorted by name.
        schemas: name of the type of each topic's messages.
        start_ns: time of the first message, on the recording's clock; 0 when there is none.
        end_ns: time of the last message.
        problem: why not all of the file could be read, or "".
    """

    about: dict[str, str]
    counts: dict[str, int]
    schemas: dict[str, str]
    start_ns: int
    end_ns: int
    problem: str

    @property
    def duration_s(self) -> float:
        """Time between the first and the last message."""
        return (self.end_ns - self.start_ns) / NS_PER_S


class Recording:
    """One recording; a context manager. Each call reads the file again, so that a recording of any size can be read.

    Attributes:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    def summary(self) -> Summary:
        """What the recording holds.

        Raises:
            RecordingError: the file can't be read.
        """
        file = McapFile(self.path)
        counts: Counter[str] = Counter()
        start_ns, end_ns = 0, 0
        for message in file.messages():
            if not counts:
                start_ns = message.logged_ns
            counts[message.topic] += 1
            end_ns = max(end_ns, message.logged_ns)
        schemas = {topic: schema.name for topic, schema in file.schemas.items()}
        return Summary(file.about, dict(sorted(counts.items())), schemas, start_ns, end_ns, file.problem)

    def messages(
        self,
        *wanted: str | Topic[Any],
        start_s: float = 0.0,
        end_s: float | None = None,
    ) -> Iterator[Entry]:
        """Messages in the order of their arrival, but for images (see `images`).

        Messages of topics that this version doesn't know are left out.

        Args:
            wanted: topics, or their names; none given means all.
            start_s: time from the recording's first message at which to start.
            end_s: time from the recording's first message at which to end; None for all.

        Raises:
            RecordingError: the file can't be read, or a message is not of the type that its topic has here.
        """
        names = {topic if isinstance(topic, str) else topic.name for topic in wanted}
        return (entry for _, entry in self._timed(names, start_s, end_s))

    def _timed(self, names: Collection[str], start_s: float, end_s: float | None) -> Iterator[tuple[float, Entry]]:
        """Messages as in `messages`, each with its time from the recording's first message."""
        decoders: dict[str, msgspec.json.Decoder[Any] | None] = {CAMERA.name: None}
        for at_s, raw in self._raw(names, start_s, end_s):
            if raw.topic not in decoders:
                topic = topic_of(raw.topic)
                decoders[raw.topic] = None if topic is None else msgspec.json.Decoder(topic.type)
            decoder = decoders[raw.topic]
            if decoder is not None:
                yield at_s, Entry(raw.logged_ns, raw.topic, self._decode(raw.topic, decoder, raw.data))

    def images(self, *, start_s: float = 0.0, end_s: float | None = None) -> Iterator[tuple[CameraFrame, Any]]:
        """Images of the camera: each frame without its pixels, and a (height, width, 3) array of red, green and blue.

        Raises:
            RecordingError: the file can't be read, or an image is damaged.
        """
        decoder = msgspec.json.Decoder(CameraFrame)
        frame: CameraFrame | None = None
        for _, raw in self._raw({HEADERS, CAMERA.name}, start_s, end_s):
            if raw.topic == HEADERS:
                frame = self._decode(raw.topic, decoder, raw.data)
            elif frame is not None:
                try:
                    yield frame, decompress(raw.data)
                except ValueError as error:
                    raise RecordingError(f"{self.path}: an image is damaged ({error})") from None

    def goals(self, *, start_s: float = 0.0, end_s: float | None = None) -> list[RecordedGoal]:
        """The goals that were sent, each with its feedback and its result, in the order of their starts.

        Goals of actions that this version doesn't know are left out.

        Args:
            start_s: time from the recording's first message at which to start; of a goal that was sent before, the rest
                is given.
            end_s: time from the recording's first message at which to end; None for all.

        Raises:
            RecordingError: the file can't be read, or a message is not of the type that it has here.
        """
        actions = usable_actions()
        collector = GoalCollector(actions)
        feedback_names = {feedback_of(action).name for action in actions.values()}
        names = feedback_names | {journal_of(name).name for name in actions}
        for at_s, entry in self._timed(names, start_s, end_s):
            if entry.topic in feedback_names:
                collector.add_feedback(at_s, entry.message)
                continue
            try:
                collector.add_journal(at_s, entry.message)
            except BadPayloadError as error:
                raise self._misfit(entry.topic, error) from None
        return collector.goals()

    def table(self, topic: str | Topic[Any], *, start_s: float = 0.0, end_s: float | None = None) -> Table:
        """The messages of one topic as numpy arrays, one for each field.

        Raises:
            RecordingError: the file can't be read, or has no message of the topic.
        """
        name = topic if isinstance(topic, str) else topic.name
        entries = list(self.messages(name, start_s=start_s, end_s=end_s))
        if not entries:
            there = ", ".join(self.summary().counts) or "none"
            raise RecordingError(f"{self.path} has no message of {name!r} in this time; its topics: {there}")
        return make_table(name, [entry.logged_ns for entry in entries], [entry.message for entry in entries])

    def _raw(self, names: Collection[str], start_s: float, end_s: float | None) -> Iterator[tuple[float, RawMessage]]:
        """Messages of some topics, or of all if no name is given, each with its time from the recording's first one."""
        first_ns: int | None = None
        for raw in McapFile(self.path).messages():
            if first_ns is None:
                first_ns = raw.logged_ns
            at_s = (raw.logged_ns - first_ns) / NS_PER_S
            if end_s is not None and at_s > end_s:
                return
            if at_s >= start_s and (not names or raw.topic in names):
                yield at_s, raw

    def _decode(self, topic: str, decoder: "msgspec.json.Decoder[Any]", data: bytes) -> Any:
        try:
            return decoder.decode(plain_json(data))
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise self._misfit(topic, error) from None

    def _misfit(self, topic: str, error: Exception) -> RecordingError:
        return RecordingError(
            f"{self.path}: a message of {topic} does not fit this version of jezero ({error}): "
            "read the recording with the version that `jezero recording info` names"
        )


def open_recording(path: Path | str) -> Recording:
    """Open a recording, or the one in a run's folder: flight.mcap, else the newest one that its stack has recorded.

    Raises:
        RecordingError: there is no such file, or it can't be read, or is no recording.
    """
    file = _recording_of(Path(path))
    next(McapFile(file).messages(), None)
    return Recording(file)


def _recording_of(path: Path) -> Path:
    if not path.is_dir():
        return path
    if (path / BAG_METADATA).exists():
        raise RecordingError(
            f"{path} is a rosbag2: `jezero recording import {path} flight.mcap` makes a recording of it"
        )
    file = path / RECORDING
    found = file if file.exists() else newest_recording(path)
    if found is None:
        raise RecordingError(f"{path} has no recording: a run's folder has {RECORDING}, or {RECORDINGS}/*.mcap")
    return found
