"""New recordings from old ones: a part of one, or what is left of a damaged one."""

from collections.abc import Collection, Iterator
from itertools import chain
from pathlib import Path

from jezero.recording.mcap_file import McapFile, RawMessage, RecordingError
from jezero.recording.reader import Recording
from jezero.recording.writer import RecordingWriter
from jezero.schemas.units import NS_PER_S


def cut(source: Path, target: Path, start_s: float, end_s: float | None, topics: Collection[str]) -> int:
    """Write a part of a recording as a new one.

    Args:
        source: the recording.
        target: the new file; an old one of this name is replaced.
        start_s: time from the recording's first message at which the part starts.
        end_s: time from the recording's first message at which the part ends; None for all.
        topics: names of the topics to keep; none given means all.

    Returns:
        The number of messages written.

    Raises:
        RecordingError: the source can't be read, is the target, or has no message of a topic or of this time; nothing
            is written.
        OSError: the target can't be written.
    """
    if target.exists() and target.samefile(source):
        raise RecordingError(f"{target} is the recording itself: give another file")
    summary = Recording(source).summary()
    if missing := [topic for topic in topics if topic not in summary.counts]:
        there = ", ".join(summary.counts) or "none"
        raise RecordingError(f"{source} has no message of {missing[0]!r}; its topics: {there}")
    if start_s > summary.duration_s:
        raise RecordingError(
            f"{source} lasts {summary.duration_s:.1f} s: a part from {start_s:g} s on is after its end"
        )
    file = McapFile(source)
    chosen = _part(file, summary.start_ns, start_s, end_s, topics)
    first = next(chosen, None)
    if first is None:
        raise RecordingError(f"{source} has no message of these topics in this time")
    return _write(target, file, chain((first,), chosen))


def _part(
    file: McapFile, start_ns: int, start_s: float, end_s: float | None, topics: Collection[str]
) -> Iterator[RawMessage]:
    for message in file.messages():
        at_s = (message.logged_ns - start_ns) / NS_PER_S
        if end_s is not None and at_s > end_s:
            return
        if at_s >= start_s and (not topics or message.topic in topics):
            yield message


def _write(target: Path, file: McapFile, messages: Iterator[RawMessage]) -> int:
    """Write some messages of a recording, whose first one has been read, as a new one; returns their number."""
    written = 0
    with RecordingWriter(target, file.about, schemas=file.schemas) as writer:
        for message in messages:
            writer.write(message.logged_ns, message.topic, message.data)
            written += 1
    return written


def repair(path: Path) -> tuple[int, str]:
    """Make a finished recording of one that was cut or damaged. The old file stays, as `<name>.damaged`.

    Returns:
        The number of messages in the finished recording, and what was wrong; "" if nothing was, and nothing is done.

    Raises:
        RecordingError: the file can't be read, or is no recording.
        OSError: the new file can't be written.
    """
    checked = McapFile(path)
    count = sum(1 for _ in checked.messages())
    if not checked.problem:
        return count, ""
    new = path.with_name(f"{path.name}.new")
    file = McapFile(path)
    messages = file.messages()
    first = next(messages, None)
    count = _write(new, file, chain(() if first is None else (first,), messages))
    path.rename(path.with_name(f"{path.name}.damaged"))
    new.rename(path)
    return count, checked.problem
