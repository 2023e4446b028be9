"""One Zenoh session: questions, their replies, and subscriptions.

Zenoh calls back in threads of its own. The callbacks here only append and wake, and run directly in those threads:
a thread of Python's would keep a program alive that forgot to close its vehicle.
"""

import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from secrets import token_hex
from typing import Any, NoReturn

import zenoh

from jezero.client.errors import JezeroError, TimedOut, Unreachable
from jezero.codec import BadPayloadError, encode, reader
from jezero.schemas.struct import Message, Payload
from jezero.schemas.topics import Endpoint, Topic, key, liveliness_key
from jezero.zenoh_client import client_config, data_of

ATTEMPT_S = 0.5
LATE_S = 0.2
"""Zenoh ends a question that nobody answers, a little late."""
KEPT = 1000
TIME_KEPT_S = 1.0
"""Vehicle time that was told so long ago is still good enough to say when a goal was issued."""


class Arrivals:
    """What Zenoh's threads bring and the caller's thread takes, in order. The oldest are dropped beyond `KEPT`.

    Attributes:
        ended: nothing more will come.
        error: the last error reply, e.g. "Timeout".
    """

    def __init__(self) -> None:
        self.ended = False
        self.error = ""
        self._items: SimpleQueue[bytes | None] = SimpleQueue()
        """None is the end."""
        self._taken_all = False

    def take(self, deadline_s: float | None) -> bytes | None:
        """The next item, or None at the end. For one thread.

        Args:
            deadline_s: of `time.monotonic()`; None waits for ever.

        Raises:
            TimedOut: the deadline passed first.
        """
        if self._taken_all:
            return None
        left_s = None if deadline_s is None else max(deadline_s - time.monotonic(), 0.0)
        try:
            item = self._items.get(timeout=left_s)
        except Empty:
            raise TimedOut("no answer in time") from None
        self._taken_all = item is None
        return item

    def on_reply(self, reply: zenoh.Reply) -> None:
        sample = reply.ok
        if sample is not None:
            self._bring(data_of(sample))
        elif reply.err is not None:
            self.error = reply.err.payload.to_bytes().decode("utf-8", "replace")

    def on_sample(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._bring(data_of(sample))

    def on_end(self) -> None:
        self.ended = True
        self._bring(None)

    def _bring(self, item: bytes | None) -> None:
        items = self._items
        items.put(item)
        if items.qsize() > KEPT:
            with suppress(Empty):  # it was just taken
                items.get_nowait()


class Connection:
    """A client's session on the router of one vehicle.

    Args:
        timeout_s: to find the router.

    Raises:
        Unreachable: there is no router.
    """

    def __init__(self, vehicle: str, router: str, timeout_s: float) -> None:
        self.vehicle = vehicle
        self.router = router
        self.client_id = f"py-{token_hex(6)}"
        self._session = _open(router, timeout_s)
        self._leave = weakref.finalize(self, _close, self._session)
        """Done also when a program exits that forgot to close: a moment later Zenoh's threads may wait for a Python
        that is gone, and the program for them."""
        self._told: tuple[int, float] | None = None
        self._token = self._session.liveliness().declare_token(liveliness_key(vehicle, "client", self.client_id))

    @property
    def connected(self) -> bool:
        """Whether the router is there now."""
        return not self._session.is_closed() and bool(self._session.info.routers_zid())

    def tell_time(self, t_ns: int) -> None:
        """A message that has just come in carried this vehicle time."""
        self._told = (t_ns, time.monotonic())

    def vehicle_time_ns(self) -> int | None:
        """Vehicle time as it was told within the last second, or None."""
        if self._told is None or time.monotonic() - self._told[1] > TIME_KEPT_S:
            return None
        return self._told[0]

    def close(self) -> None:
        """Leave; open questions end. May be called twice."""
        self._leave()

    def stream(self, name: str, payload: bytes, timeout_s: float) -> Arrivals:
        """Put a question to the server of a key and let the replies come in.

        Raises:
            Unreachable: the session is closed.
        """
        arrivals = Arrivals()
        try:
            self._session.get(
                key(self.vehicle, name),
                zenoh.handlers.Callback(arrivals.on_reply, arrivals.on_end, indirect=False),
                target=zenoh.QueryTarget.BEST_MATCHING,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s,
                payload=payload or None,
                encoding=zenoh.Encoding.APPLICATION_JSON,
                attachment=self.client_id.encode(),
            )
        except zenoh.ZError as error:
            raise Unreachable(f"can't ask {name} of {self.vehicle}: {error}") from None
        return arrivals

    def ask(self, endpoint: Endpoint[Any, Any], payload: Payload, timeout_s: float) -> Any:
        """One question, one answer.

        Raises:
            Unreachable: nobody serves this.
            TimedOut: somebody does, but doesn't answer.
        """
        data = self.first(self.stream(endpoint.name, encode(payload), timeout_s), endpoint.name, timeout_s)
        return decode(endpoint.reply_type, data)

    def first(self, arrivals: Arrivals, name: str, timeout_s: float) -> bytes:
        """The first reply on `name`; raises as `ask`."""
        data = self.first_or_none(arrivals, name, timeout_s)
        if data is None:
            self._raise_unreachable(name)
        return data

    def first_or_none(self, arrivals: Arrivals, name: str, timeout_s: float) -> bytes | None:
        """The first reply, or None when nobody had one.

        Raises:
            TimedOut: nothing came and it didn't end.
        """
        late = False
        try:
            data = arrivals.take(time.monotonic() + timeout_s + LATE_S)
        except TimedOut:
            late, data = True, None
        if late or (data is None and arrivals.error):
            raise TimedOut(f"{name} of {self.vehicle} did not answer within {timeout_s:g} s")
        return data

    def subscribe(self, topic: Topic[Any]) -> tuple[Arrivals, Callable[[], None]]:
        """Messages of a topic from now on, and how to stop them."""
        arrivals = Arrivals()
        subscriber = self._session.declare_subscriber(
            key(self.vehicle, topic.name), zenoh.handlers.Callback(arrivals.on_sample, arrivals.on_end, indirect=False)
        )
        return arrivals, subscriber.undeclare

    def publish(self, topic: Topic[Any], message: Message) -> None:
        """One message for whoever listens.

        Raises:
            Unreachable: the session is closed.
        """
        name = key(self.vehicle, topic.name)
        try:
            self._session.put(name, encode(message), encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            raise Unreachable(f"can't publish {topic.name} of {self.vehicle}: {error}") from None

    def _raise_unreachable(self, name: str) -> NoReturn:
        if not self.connected:
            raise Unreachable(f"the connection to the router {self.router} is lost")
        raise Unreachable(f"nobody answers {name} of {self.vehicle}: is the stack up? (`jezero up`, `jezero ps`)")


def decode(kind: Any, data: bytes) -> Any:
    """A reply or message of any length: the result of a long goal lists all its pictures.

    Raises:
        JezeroError: this version of the client doesn't know such a message.
    """
    return decoder(kind)(data)


def decoder(kind: Any) -> Callable[[bytes], Any]:
    """`decode` for one type. Made before a request is sent, it doesn't delay the first reply."""
    read = reader(kind, None).read

    def decode_this(data: bytes) -> Any:
        try:
            return read(data)
        except BadPayloadError as error:
            why = f"the reply isn't understood ({error}): do client and stack have the same version?"
            raise JezeroError(why) from None

    return decode_this


def _close(session: zenoh.Session) -> None:
    if not session.is_closed():
        session.close()  # type: ignore[no-untyped-call]


def _open(router: str, timeout_s: float) -> zenoh.Session:
    """Connect to the router; tried in short attempts, as nothing interrupts one."""
    deadline_s = time.monotonic() + timeout_s
    while True:
        attempt_s = min(ATTEMPT_S, max(deadline_s - time.monotonic(), 0.05))
        try:
            return zenoh.open(client_config(router, attempt_s))
        except zenoh.ZError as error:
            if time.monotonic() >= deadline_s - 0.01:
                hint = "is the stack up? (`jezero up`) Are the address and the credentials right?"
                raise Unreachable(f"no router at {router} within {timeout_s:g} s: {hint}") from error
