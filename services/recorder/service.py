"""The recorder: writes every message of the vehicle to disk, and disturbs nobody when the disk doesn't take it."""

import traceback
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Protocol

from jezero.runtime.service import Health, Inbox, Output, SentMessage, Spec
from jezero.schemas import topics
from jezero.schemas.units import NS_PER_S

WAITING_MAX_BYTES = 64_000_000
"""Messages that arrive while the disk takes none are kept up to this size; later ones are lost."""
IMAGES_WAITING_MAX_BYTES = 48_000_000
"""An image is lost when this much waits already: the rest of the room is for all other messages, which are small."""
WRITE_TIMEOUT_NS = NS_PER_S
RETRY_PERIOD_NS = 2 * NS_PER_S

SPEC = Spec(name="recorder", hears_all=True, rate_hz=5.0)


class Progress(Protocol):
    """Outcome of a write, see `jezero.recording.folder.Progress`."""

    @property
    def path(self) -> object: ...
    @property
    def size_bytes(self) -> int: ...
    @property
    def problem(self) -> str: ...
    @property
    def room_bytes(self) -> int | None: ...


Batch = Sequence[tuple[int, str, bytes]]
"""Messages, each (time of arrival in ns, topic, encoded message)."""


def at_once(work: Callable[[], None]) -> None:
    """Carry out work in the caller's thread."""
    work()


class Recorder:
    """Collects messages and gives them to the disk, one batch at a time.

    Args:
        write: writes a batch; may take any time.
        images: whether the camera's images are recorded.
        execute: carries out the writes, one after the other; in a thread beside the service, if its steps must not
            wait for the disk.
    """

    spec = SPEC

    def __init__(
        self,
        write: Callable[[Batch], Progress],
        *,
        images: bool,
        execute: Callable[[Callable[[], None]], None] = at_once,
    ) -> None:
        self._write = write
        self._execute = execute
        self._written: deque[Progress | str] = deque()
        """Outcomes of writes, appended by the thread that writes; a text says why a write failed."""
        self._left_out = frozenset() if images else frozenset({topics.CAMERA.name})
        self._waiting: list[SentMessage] = []
        self._waiting_bytes = 0
        self._write_start_ns: int | None = None
        """Wall time of the start of the present write."""
        self._retry_ns = 0
        self._lost = 0
        self._problem = ""
        self._where = ""
        self._room_bytes: int | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Take in what arrived, and start the next write when the last one has ended."""
        self._take(inbox.sent)
        while self._written:
            self._write_start_ns = None
            self._on_written(self._written.popleft(), inbox.wall_ns)
        if self._waiting and self._write_start_ns is None and inbox.wall_ns >= self._retry_ns:
            self._write_start_ns = inbox.wall_ns
            self._write_waiting()
        yield self._health(inbox.wall_ns)

    def finish(self) -> None:
        """Write what still waits, now that no step follows."""
        if self._waiting:
            self._write_waiting()

    def _write_waiting(self) -> None:
        batch = [(message.arrival_ns, message.topic, message.data) for message in self._waiting]
        self._waiting, self._waiting_bytes = [], 0
        self._execute(partial(self._write_batch, batch))

    def _take(self, messages: Sequence[SentMessage]) -> None:
        for message in messages:
            if message.topic in self._left_out:
                continue
            limit_bytes = IMAGES_WAITING_MAX_BYTES if message.topic == topics.CAMERA.name else WAITING_MAX_BYTES
            if self._waiting_bytes + len(message.data) > limit_bytes:
                self._lost += 1
                continue
            self._waiting.append(message)
            self._waiting_bytes += len(message.data)

    def _write_batch(self, batch: Batch) -> None:
        try:
            self._written.append(self._write(batch))
        except Exception as error:  # noqa: BLE001 - the flight goes on; health tells what happened
            traceback.print_exception(error)
            self._written.append(f"{type(error).__name__}: {error}; the traceback is in the recorder's log")

    def _on_written(self, progress: Progress | str, wall_ns: int) -> None:
        self._problem = progress if isinstance(progress, str) else progress.problem
        if not isinstance(progress, str):
            self._room_bytes = progress.room_bytes
        if self._problem:
            self._retry_ns = wall_ns + RETRY_PERIOD_NS
        elif not isinstance(progress, str):
            self._where = f"recording to {progress.path}, {progress.size_bytes / 1e6:.1f} MB"

    def _health(self, wall_ns: int) -> Health:
        lost = f"; {self._lost} messages lost so far" if self._lost else ""
        if self._problem:
            return Health("degraded", f"not recording: {self._problem}{lost}", self._room_bytes)
        started_ns = self._write_start_ns
        if started_ns is not None and wall_ns - started_ns > WRITE_TIMEOUT_NS:
            waited_s = (wall_ns - started_ns) / NS_PER_S
            return Health("degraded", f"not recording: the disk has not taken anything for {waited_s:.0f} s{lost}")
        return Health("ok", f"{self._where or 'nothing to record yet'}{lost}", self._room_bytes)
