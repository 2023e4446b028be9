"""Tables of a recording for spreadsheets and other programs."""

import csv
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from jezero.base.files import naming
from jezero.recording.mcap_file import RecordingError
from jezero.recording.reader import Entry, Recording
from jezero.recording.table import make_table


def write_csv(recording: Recording, folder: Path, topics: Collection[str] = ()) -> Iterator[tuple[Path, int]]:
    """Write one CSV file for each topic; `sensor/uwb` becomes `sensor-uwb.csv`. Values that are no numbers are JSON.

    Yields:
        Each file, and the number of its rows.

    Raises:
        RecordingError: the recording can't be read, or has no message of a topic.
        OSError: a file can't be written.
    """
    entries: dict[str, list[Entry]] = {}
    for entry in recording.messages(*topics):
        entries.setdefault(entry.topic, []).append(entry)
    for topic in topics:
        if topic not in entries:
            there = ", ".join(recording.summary().counts) or "none"
            raise RecordingError(f"{recording.path} has no message of {topic!r}; its topics: {there}")
    folder.mkdir(parents=True, exist_ok=True)
    for topic, found in sorted(entries.items()):
        path = folder / f"{topic.replace('/', '-')}.csv"
        table = make_table(topic, [entry.logged_ns for entry in found], [entry.message for entry in found])
        columns = dict(table.flat())
        with naming(path), path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*(map(_cell, column) for column in columns.values()), strict=True))
        yield path, len(found)


def _cell(value: Any) -> Any:
    """Numbers and text as they are, nothing for None, everything else as JSON."""
    if value is None:
        return ""
    if isinstance(value, str | int | float | np.generic):
        return value
    return msgspec.json.encode(value).decode()
