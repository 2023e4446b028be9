"""New recordings from old ones: a part of one, or what is left of a damaged one."""

from collections.abc import Collection
from itertools import chain
from pathlib import Path

from jezero.recording.mcap_file import McapFile, RecordingError
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
        RecordingError: the source can't be read, or is the target.
        OSError: the target can't be written.
    """
    if target.exists() and target.samefile(source):
        raise RecordingError(f"{target} is the recording itself: give another file")
    file = McapFile(source)
    messages = file.messages()
    first = next(messages, None)
    start_ns = 0 if first is None else first.logged_ns
    written = 0
    with RecordingWriter(target, file.about, schemas=file.schemas) as writer:
        for message in chain(() if first is None else (first,), messages):
            at_s = (message.logged_ns - start_ns) / NS_PER_S
            if end_s is not None and at_s > end_s:
                break
            if at_s >= start_s and (not topics or message.topic in topics):
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
    count = cut(path, new, 0.0, None, ())
    path.rename(path.with_name(f"{path.name}.damaged"))
    new.rename(path)
    return count, checked.problem
