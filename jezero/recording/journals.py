"""The journals of services in recordings: the runs of a service that can be replayed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from jezero.recording.mcap_file import McapFile, RecordingError
from jezero.schemas.journal import AnyEntry, JournalPart
from jezero.schemas.topics import journal_of
from jezero.schemas.units import NS_PER_S

_PREFIX = journal_of("").name
_DECODER = msgspec.json.Decoder(JournalPart)


@dataclass
class ServiceRun:
    """One run of a service, from its start.

    Attributes:
        service: name of the service.
        boot_id: id of this run.
        made_with: arguments of the service's constructor.
        made_by: class of the service as `module:class`; "" in recordings of older versions.
        entries: its inputs and outputs in their order.
        parts: number of parts of the journal that the entries are from.
        gap_s: time from the recording's first message from which on parts of the journal are missing; the entries end
            before. None if no part is missing.
    """

    service: str
    boot_id: int
    made_with: dict[str, Any]
    made_by: str = ""
    entries: list[AnyEntry] = field(default_factory=list)
    parts: int = 0
    gap_s: float | None = None


def journaled_services(path: Path) -> list[str]:
    """Names of the services whose journals are in a recording, sorted.

    Raises:
        RecordingError: the file can't be read.
    """
    topics = {message.topic for message in McapFile(path).messages()}
    return sorted(topic.removeprefix(_PREFIX) for topic in topics if topic.startswith(_PREFIX))


def settings_of(path: Path) -> dict[str, dict[str, Any]]:
    """Settings in force of each service that started during a recording, by service: values by their full names.

    Raises:
        RecordingError: the file can't be read.
    """
    first: dict[str, JournalPart] = {}
    for message in McapFile(path).messages():
        service = message.topic.removeprefix(_PREFIX)
        if service != message.topic and service not in first:
            first[service] = _decode(path, service, message.data)
    return {
        service: {".".join(names): value for names, value in leaves(part.made_with)}
        for service, part in sorted(first.items())
        if part.number == 0
    }


def leaves(table: Mapping[str, Any], parents: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All values of a table that are no tables, each with the names that lead to it."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from leaves(value, (*parents, name))
        else:
            yield (*parents, name), value


def files_with_start(path: Path, service: str) -> list[Path]:
    """A recording, and the ones before it that have the beginning of the service's run.

    A stack's recording goes on in a new file when the old one is full.

    Raises:
        RecordingError: the file can't be read, or has no journal of the service.
    """
    first = _first_part(path, service)
    if first is None:
        there = ", ".join(journaled_services(path)) or "none"
        raise RecordingError(f"{path} has no journal of {service!r}; services with a journal: {there}")
    files = [path]
    for file in sorted((each for each in path.parent.glob("*.mcap") if each.name < path.name), reverse=True):
        if first.number == 0:
            break
        older = _first_part(file, service)
        if older is None or older.boot_id != first.boot_id:
            break
        first = older
        files.insert(0, file)
    return files


def runs_of(files: Sequence[Path], service: str) -> list[ServiceRun]:
    """All runs of a service in recordings, each from its start.

    Raises:
        RecordingError: a file can't be read, or none has the start of a run.
    """
    runs: list[ServiceRun] = []
    for part, at_s in _parts(files, service):
        _append(runs, part, at_s)
    if not runs:
        raise RecordingError(
            f"{files[0]} begins after the start of {service!r}, whose state at that time is unknown: "
            "give a recording that begins with the stack"
        )
    return runs


def _append(runs: list[ServiceRun], part: JournalPart, at_s: float) -> None:
    """Add a part to the last run, or begin a new run with it."""
    if part.number == 0:
        runs.append(ServiceRun(part.service, part.boot_id, part.made_with, part.made_by))
    if not runs or runs[-1].gap_s is not None:
        return
    run = runs[-1]
    if part.number == run.parts:
        run.entries.extend(part.entries)
        run.parts += 1
    else:
        run.gap_s = at_s


def _first_part(path: Path, service: str) -> JournalPart | None:
    return next((part for part, _ in _parts([path], service)), None)


def _parts(files: Sequence[Path], service: str) -> Iterator[tuple[JournalPart, float]]:
    """Parts of a service's journal, and the time of each from the first message."""
    topic = journal_of(service).name
    start_ns: int | None = None
    for path in files:
        for message in McapFile(path).messages():
            start_ns = message.logged_ns if start_ns is None else start_ns
            if message.topic == topic:
                yield _decode(path, service, message.data), (message.logged_ns - start_ns) / NS_PER_S


def _decode(path: Path, service: str, data: bytes) -> JournalPart:
    try:
        return _DECODER.decode(data)
    except msgspec.DecodeError as error:
        raise RecordingError(
            f"{path}: a part of the journal of {service!r} does not fit this version of jezero ({error}): "
            "replay the recording with the version that `jezero recording info` names"
        ) from None
