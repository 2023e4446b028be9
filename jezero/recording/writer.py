"""Writing a recording: an MCAP file of every message as it was on the bus."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.records import Schema
from mcap.writer import CompressionType, IndexType, Writer

from jezero.base.files import naming
from jezero.recording.channels import json_schema, schema_name
from jezero.recording.images import ImageFormat, split_image
from jezero.recording.mcap_file import ABOUT
from jezero.recording.viewer_scene import ViewerScene
from jezero.schemas.topics import CAMERA, CAMERA_PREVIEW
from jezero.schemas.units import NS_PER_S

RECORDING = "flight.mcap"
"""Name of the recording in the folder of a run."""

PROFILE = "jezero"
CHUNK_SIZE_MAX_BYTES = 1_000_000
CHUNK_SPAN_MAX_NS = NS_PER_S
"""A chunk is closed at least once a second: a process that is killed loses the open chunk."""


class RecordingWriter:
    """Writer of one file; a context manager. The same messages at the same times give the same bytes.

    Args:
        path: the file; its folder is made if need be.
        about: what was recorded, such as the vehicle's name and the seed.
        schemas: schemas of topics that are copied from another recording; the other ones are of this version.
        image_format: of recorded images; None records of each image all but its pixels.
        scene: makes the messages for 3D viewers from the others; None for a copy, which has them already.

    Raises:
        OSError: the file can't be written.
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        *,
        schemas: Mapping[str, Schema] | None = None,
        image_format: ImageFormat | None = None,
        scene: ViewerScene | None = None,
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        self._file = path.open("wb")
        self._writer = Writer(
            self._file,
            chunk_size=CHUNK_SIZE_MAX_BYTES,
            compression=CompressionType.ZSTD,
            index_types=IndexType.ALL,
        )
        self._schemas = {} if schemas is None else schemas
        self._image_format = image_format
        self._scene = scene
        self._channels: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._last_ns = 0
        self._chunk_start_ns: int | None = None
        with naming(path):
            self._writer.start(profile=PROFILE, library="jezero")
            self._writer.add_metadata(ABOUT, dict(about))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def size_bytes(self) -> int:
        """Size of the file so far, without the open chunk."""
        return self._file.tell()

    def write(self, logged_ns: int, topic: str, data: bytes) -> None:
        """Add one message.

        Args:
            logged_ns: time of arrival, on the recording's own clock. Viewers need times that never decrease, so an
                earlier time than the last one is written as the last one.
            topic: name of the topic.
            data: the encoded message. Of an image, the pixels become a message of their own; a preview of one is left
                out, as the image shows more.

        Raises:
            OSError: the file can't be written.
        """
        if topic == CAMERA_PREVIEW.name:
            return
        self._last_ns = max(self._last_ns, logged_ns)
        if self._chunk_start_ns is None:
            self._chunk_start_ns = self._last_ns
        elif self._last_ns - self._chunk_start_ns >= CHUNK_SPAN_MAX_NS:
            self.flush()
            self._chunk_start_ns = self._last_ns
        if topic != CAMERA.name:
            self._add_with_scene(topic, data)
            return
        for channel, message in split_image(data, self._image_format, self._time_of):
            self._add_with_scene(channel, message)

    def _time_of(self, t_ns: int) -> int:
        return self._last_ns if self._scene is None else self._scene.time_of(t_ns, self._last_ns)

    def _add_with_scene(self, topic: str, data: bytes) -> None:
        self._add(topic, data)
        if self._scene is not None:
            for channel, message in self._scene.update(self._last_ns, topic, data):
                self._add(channel, message)

    def _add(self, topic: str, data: bytes) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._register(topic)
        self._sequences[channel] = sequence = self._sequences.get(channel, 0) + 1
        try:  # a context manager takes longer than the write
            self._writer.add_message(channel, self._last_ns, data, self._last_ns, sequence)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._path)) from None

    def flush(self) -> None:
        """Close the open chunk, so that all messages so far are in the file.

        Raises:
            OSError: the file can't be written.
        """
        with naming(self._path):
            self._writer.flush()  # type: ignore[no-untyped-call]
        self._chunk_start_ns = None

    def close(self) -> None:
        """Write the indexes and close the file.

        Raises:
            OSError: the file can't be written.
        """
        if self._file.closed:
            return
        with naming(self._path), self._file:
            self._writer.finish()  # type: ignore[no-untyped-call]

    def abandon(self) -> None:
        """Close the file as it is, after an error: it stays readable up to the last flush."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _register(self, topic: str) -> int:
        copied = self._schemas.get(topic)
        name, data = (schema_name(topic), json_schema(topic)) if copied is None else (copied.name, copied.data)
        schema = self._writer.register_schema(name, "jsonschema", data)
        self._channels[topic] = channel = self._writer.register_channel(topic, "json", schema)
        return channel
