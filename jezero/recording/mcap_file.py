"""The messages of an MCAP file, up to its end or to the place where the file is cut or damaged."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from jezero.base.files import describe_os_error

ABOUT = "jezero"
"""Name of the metadata record that says what was recorded."""
BAD_BYTES = (McapError, ValueError, struct.error, zstandard.ZstdError, OverflowError, MemoryError)
"""What the library raises for bytes that are no record."""
RECORD_SIZE_MAX_BYTES = 256_000_000


class RecordingError(ValueError):
    """A file is no recording, or can't be read; the text names the file, the reason and what to do."""


class RawMessage(NamedTuple):
    """One message as it is in the file.

    Attributes:
        topic: name of the topic.
        logged_ns: time of arrival, on the recording's clock.
        data: the encoded message.
    """

    topic: str
    logged_ns: int
    data: bytes


class McapFile:
    """One pass over a file, and later ones from the chunks that it found.

    Attributes:
        chunk_offset: place in the file of the chunk that the newest message is from.
        about: what was recorded, see `RecordingWriter`; known from the first message on.
        schemas: schema of each topic's messages, of the topics read so far.
        problem: why not all of the file could be read, or ""; known after the last message.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self.about: dict[str, str] = {}
        self.schemas: dict[str, Schema] = {}
        self.problem = ""
        self.chunk_offset = 0

    def messages(self, chunk_offset: int = 0) -> Iterator[RawMessage]:
        """All messages in the order of the file.

        Args:
            chunk_offset: chunk of an earlier pass from which on the messages are read; 0 for all.

        Raises:
            RecordingError: the file can't be opened, or is no MCAP file.
        """
        try:
            with self._path.open("rb") as file:
                file.seek(chunk_offset)
                reader = StreamReader(
                    file, skip_magic=chunk_offset > 0, emit_chunks=True, record_size_limit=RECORD_SIZE_MAX_BYTES
                )
                yield from self._messages(file, reader)
        except IsADirectoryError:
            raise RecordingError(f"{self._path} is a folder: give a file in it") from None
        except OSError as error:
            raise RecordingError(describe_os_error(error)) from None

    def _messages(self, file: BinaryIO, reader: StreamReader) -> Iterator[RawMessage]:
        records = reader.records
        started = finished = False
        while True:
            offset = file.tell()
            try:
                record = next(records, None)
            except BAD_BYTES as error:
                if not started:
                    raise RecordingError(f"{self._path} is no recording: it doesn't start as an MCAP file") from None
                cut = isinstance(error, EndOfFile | struct.error)
                self.problem = "it was not finished" if cut else f"it is damaged: {error}"
                return
            started = True
            match record:
                case None:
                    break
                case Footer():
                    finished = True
                case Metadata(name=name, metadata=metadata) if name == ABOUT:
                    self.about = metadata
                case Chunk():
                    self.chunk_offset = offset
                    yield from self._messages_of(record)
        if not finished:
            self.problem = "it was not finished"
        elif file.read(1):  # viewers read the end first; after a loss of power a file system may have put zeros there
            self.problem = self.problem or "it has bytes after its end"

    def _messages_of(self, chunk: Chunk) -> Iterator[RawMessage]:
        try:
            records = breakup_chunk(chunk, validate_crc=True)
        except BAD_BYTES:
            self.problem = "a part of it is damaged"
            return
        for record in records:
            match record:
                case Schema():
                    self._schemas[record.id] = record
                case Channel():
                    self._channels[record.id] = record
                    if record.schema_id in self._schemas:
                        self.schemas[record.topic] = self._schemas[record.schema_id]
                case Message() if record.channel_id in self._channels:
                    yield RawMessage(self._channels[record.channel_id].topic, record.log_time, record.data)
                case _:
                    self.problem = "a part of it is damaged"
