"""The recordings of a stack: files of limited size in one folder."""

import shutil
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from jezero.base.files import describe_os_error
from jezero.recording.channels import topic_of
from jezero.recording.images import ImageFormat
from jezero.recording.viewer_scene import ViewerScene
from jezero.recording.writer import RecordingWriter

RECORDINGS = "recordings"
"""Name of the folder of recordings in a stack's run folder."""


class RecordingProgress(NamedTuple):
    """State of a folder's recording after a write.

    Attributes:
        path: the present file; None when there is none.
        size_bytes: its size.
        problem: why the last messages could not be written, or "".
        room_bytes: free space of the folder's disk; None when it is unknown.
    """

    path: Path | None
    size_bytes: int
    problem: str
    room_bytes: int | None = None


class RecordingFolder:
    """Writes recordings into a folder: a new file when the present one is full, and after an error.

    Its methods may be called by different threads.

    Args:
        folder: the folder; it is made with the first file.
        about: what is recorded, see `RecordingWriter`.
        size_max_bytes: size at which a file is finished and the next one begun.
        image_format: of recorded images; None records none.
        scene: makes the messages for 3D viewers.
    """

    def __init__(
        self,
        folder: Path,
        about: Mapping[str, str],
        size_max_bytes: int,
        image_format: ImageFormat | None = None,
        scene: ViewerScene | None = None,
    ) -> None:
        self._folder = folder
        self._about = about
        self._size_max_bytes = size_max_bytes
        self._image_format = image_format
        self._scene = scene
        self._writer: RecordingWriter | None = None
        self._path: Path | None = None
        self._lock = threading.Lock()

    def write(self, messages: Sequence[tuple[int, str, bytes]]) -> RecordingProgress:
        """Write messages, each (time of arrival in ns, topic, encoded message), so that they are in the file.

        Messages of topics that are not declared are left out.

        After an error the file is given up; what was written before stays readable.
        """
        with self._lock:
            try:
                if self._writer is None:
                    self._writer = self._open()
                for arrival_ns, topic, data in messages:
                    if topic_of(topic) is not None:
                        self._writer.write(arrival_ns, topic, data)
                self._writer.flush()
                if self._path is None or not self._path.exists():
                    self._give_up()
                    return RecordingProgress(None, 0, f"{self._path} has vanished: a new file is begun")
                size_bytes = self._writer.size_bytes
                progress = RecordingProgress(self._path, size_bytes, "", self._room_bytes())
                if size_bytes >= self._size_max_bytes:
                    self._finish()
                return progress
            except OSError as error:
                self._give_up()
                return RecordingProgress(None, 0, describe_os_error(error), self._room_bytes())

    def close(self) -> None:
        """Finish the present file, if there is one and the disk takes it."""
        with self._lock:
            try:
                self._finish()
            except OSError:
                self._give_up()

    def _open(self) -> RecordingWriter:
        self._folder.mkdir(parents=True, exist_ok=True)
        stem = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
        self._path, number = self._folder / f"{stem}.mcap", 1
        while self._path.exists():
            number += 1
            self._path = self._folder / f"{stem}_{number}.mcap"
        return RecordingWriter(self._path, self._about, image_format=self._image_format, scene=self._scene)

    def _finish(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _room_bytes(self) -> int | None:
        """Free space of the folder's disk; None where the folder can't be looked at."""
        with suppress(OSError):
            return shutil.disk_usage(self._folder).free
        return None

    def _give_up(self) -> None:
        if self._writer is not None:
            self._writer.abandon()
            self._writer = None


def recordings_in(folder: Path) -> list[Path]:
    """The recordings of a stack's run folder, the oldest one first."""
    return sorted((folder / RECORDINGS).glob("*.mcap"))


def newest_recording(folder: Path) -> Path | None:
    """The newest recording of a stack's run folder, or None."""
    return max((folder / RECORDINGS).glob("*.mcap"), default=None)


def room_bytes(folder: Path) -> tuple[int, int]:
    """Number and total size in bytes of the recordings of a stack's run folder."""
    sizes = [path.stat().st_size for path in (folder / RECORDINGS).glob("*.mcap")]
    return len(sizes), sum(sizes)
