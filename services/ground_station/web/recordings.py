"""The recordings that the pages show: which there are, and those that are open."""

import asyncio
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from jezero.os_errors import describe_os_error
from jezero.recording.folder import recordings_in
from jezero.recording.mcap_file import RecordingError
from jezero.recording.writer import RECORDING
from jezero.services.ground_station.playback import RecordedFlight

FLIGHTS_KEPT = 2
"""Recordings whose index is kept; another one is read anew."""


@dataclass(frozen=True)
class Listed:
    """A recording in the list.

    Attributes:
        name: of its file.
        size_mb: size in MB.
        changed: date and time of the last change.
    """

    name: str
    size_mb: float
    changed: str


class Reading:
    """A recording that is read, or was read.

    Attributes:
        flight: its content, for `problem` "" and `fraction` 1.
        fraction: fraction of the file that was read.
        problem: why it can't be shown, or "".
    """

    def __init__(self, path: Path, version: tuple[int, int]) -> None:
        self.flight = RecordedFlight(path)
        self.version = version
        self.fraction = 0.0
        self.problem = ""
        self._task = asyncio.create_task(asyncio.to_thread(self._read))

    def _read(self) -> None:
        try:
            self.flight.index(self._on_progress)
        except (RecordingError, OSError) as error:
            self.problem = describe_os_error(error) if isinstance(error, OSError) else str(error)
        else:
            self.problem = "" if self.flight.keyframes else f"{self.flight.path} has no messages"
        self.fraction = 1.0

    def _on_progress(self, fraction: float) -> None:
        self.fraction = min(fraction, 0.99)


class Recordings:
    """The recordings of a run's folder, or a single one.

    Args:
        place: a recording, or the folder of a run; None for none.
    """

    def __init__(self, place: Path | None) -> None:
        self._place = place
        self._readings: dict[Path, Reading] = {}

    def _paths(self) -> list[Path]:
        if self._place is None or not self._place.exists():
            return []
        if not self._place.is_dir():
            return [self._place]
        flight = self._place / RECORDING
        return [*recordings_in(self._place), *([flight] if flight.exists() else [])]

    @property
    def is_one(self) -> bool:
        """Whether a single recording is shown, and no folder."""
        return self._place is not None and not self._place.is_dir()

    def newest_first(self) -> list[Listed]:
        """The recordings by the time of their last change."""
        found = [(path.stat(), path.name) for path in self._paths()]
        return [
            Listed(name, stat.st_size / 1e6, datetime.fromtimestamp(stat.st_mtime).strftime("%Y-%m-%d %H:%M:%S"))
            for stat, name in sorted(found, key=lambda each: each[0].st_mtime, reverse=True)
        ]

    def open(self, name: str) -> Reading | None:
        """Begin to read a recording, or return the reading that has begun; None when there is no such recording."""
        path = next((path for path in self._paths() if path.name == name), None)
        if path is None:
            return None
        stat = path.stat()
        version = (stat.st_size, stat.st_mtime_ns)
        reading = self._readings.get(path)
        if reading is None or (reading.fraction == 1.0 and reading.version != version):
            self._readings.pop(path, None)
            while len(self._readings) >= FLIGHTS_KEPT:
                del self._readings[next(iter(self._readings))]
            reading = self._readings[path] = Reading(path, version)
        return reading
