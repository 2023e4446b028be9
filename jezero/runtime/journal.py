"""Writes a service's journal while it runs: see `schemas/journal.py`."""

from collections.abc import Mapping
from typing import Any
from zlib import crc32

import msgspec
from msgspec import Raw

from jezero.base.codec import split_attachment
from jezero.schemas import journal
from jezero.schemas.journal import AnyEntry, JournalPart

PART_PERIOD_NS = 100_000_000
PART_SIZE_MAX_BYTES = 256_000
"""A part is closed when it is older or larger."""
NULL = Raw(b"null")


class Journal:
    """The journal of one run of a service.

    Args:
        service: name of the service.
        boot_id: id of this run.
        made_with: arguments of the service's constructor by name; numbers, texts and structs.
        made_by: class of the service, see `class_of`.
    """

    def __init__(self, service: str, boot_id: int, made_with: Mapping[str, Any], made_by: str) -> None:
        self._service = service
        self._boot_id = boot_id
        self._made_with: dict[str, Any] = msgspec.to_builtins(dict(made_with))
        self._made_by = made_by
        self._number = 0
        self._entries: list[AnyEntry] = []
        self._size_bytes = 0
        self._start_ns: int | None = None
        """Wall time of the first step of the open part."""
        self._t_ns = 0

    def step(self, t_ns: int, wall_ns: int, *, connected: bool, stalled_ns: int = 0) -> None:
        """The service is stepped now."""
        self._t_ns = t_ns
        if self._start_ns is None:
            self._start_ns = wall_ns
        self._entries.append(journal.Step(t_ns, wall_ns, connected, stalled_ns))

    def received(self, topic: str, data: bytes, *, attached: bool) -> None:
        """A valid message has arrived."""
        message, checksum = content_of(data) if attached else (Raw(data), None)
        self.add(journal.Received(topic, message, checksum), len(message))

    def add(self, entry: AnyEntry, size_bytes: int = 0) -> None:
        """Append an entry.

        Args:
            size_bytes: size of the message in it.
        """
        self._entries.append(entry)
        self._size_bytes += size_bytes

    def take_entries(self) -> tuple[AnyEntry, ...]:
        """The entries of the open part, which is empty afterwards."""
        entries = tuple(self._entries)
        self._entries.clear()
        self._size_bytes, self._start_ns = 0, None
        return entries

    def take(self, wall_ns: int, *, force: bool = False) -> bytes | None:
        """The open part, encoded, if it is old or large enough; the next one begins.

        Args:
            wall_ns: monotonic wall time.
            force: whether it is wanted at any age, at the end.
        """
        if not self._entries:
            return None
        old = self._start_ns is not None and wall_ns - self._start_ns >= PART_PERIOD_NS
        if not (force or old or self._size_bytes >= PART_SIZE_MAX_BYTES):
            return None
        part = JournalPart(
            t_ns=self._t_ns,
            service=self._service,
            boot_id=self._boot_id,
            number=self._number,
            made_with=self._made_with if self._number == 0 else {},
            made_by=self._made_by if self._number == 0 else "",
            entries=self.take_entries(),
        )
        self._number += 1
        return msgspec.json.encode(part)


def class_of(service: object) -> str:
    """Class of a service as `module:class`; the module of a program that was started is `__main__`."""
    kind = type(service)
    return f"{kind.__module__}:{kind.__qualname__}"


def content_of(data: bytes) -> tuple[Raw, int | None]:
    """JSON of a message that jezero has encoded, and the checksum of its attachment."""
    json, attachment = split_attachment(data)
    return Raw(json), crc32(attachment) if attachment else None
