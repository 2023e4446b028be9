"""One Zenoh session: queries, their replies, and subscriptions.

Zenoh calls back in its own threads. The callbacks here only append to a queue, and run directly in those threads: a
Python thread for them would keep a program alive that forgot to close its vehicle.
"""

import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from secrets import token_hex
from typing import Any, NoReturn

import zenoh

from jezero.base.codec import BadPayloadError, encode, reader
from jezero.base.plain_text import plain
from jezero.base.router_address import shown_router
from jezero.base.zenoh_client import FIRST, client_config, data_of
from jezero.client.errors import JezeroError, Refused, TimedOut, Unreachable
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.struct import Message, Payload
from jezero.schemas.topics import key, liveliness_key
from jezero.schemas.units import NS_PER_S

CONNECT_ATTEMPT_S = 0.5
TIMEOUT_MARGIN_S = 0.2
"""Zenoh ends a query without replies slightly after its timeout."""
SEE_TIMEOUT_S = 0.5
"""Duration after which the tokens that this computer's router knows have arrived."""
HIDDEN_TIMEOUT_S, LOOK_PERIOD_S = 4.0, 0.1
"""Duration after which the token of a router on another computer has arrived, also over a slow radio. A router that has
just started may reply before it knows of the token, so it is asked again until then."""
ARRIVALS_MAX = 1000
VEHICLE_TIME_AGE_MAX_S = 1.0
"""Vehicle time older than this is not used as the time at which a goal was issued."""


class ReplyArrivals:
    """Queue of messages from Zenoh's threads to the caller's.

    Args:
        limit: number of messages beyond which the oldest are dropped.

    Attributes:
        ended: whether no more messages will come.
        error: the last error reply, e.g. "Timeout".
        on_put: called after each message and after the end, in Zenoh's thread.
    """

    def __init__(self, limit: int = ARRIVALS_MAX) -> None:
        self.ended = False
        self.error = ""
        self.on_put: Callable[[], None] = lambda: None
        self._limit = limit
        self._items: SimpleQueue[bytes | None] = SimpleQueue()
        """The messages in order; None marks the end."""
        self._taken_all = False

    def take(self, deadline_s: float | None) -> bytes | None:
        """Wait for the next message; None at the end. For use by one thread.

        Args:
            deadline_s: deadline on the clock `time.monotonic()`; None waits forever.

        Raises:
            TimedOut: no message came before the deadline.
        """
        if self._taken_all:
            return None
        left_s = None if deadline_s is None else max(deadline_s - time.monotonic(), 0.0)
        try:
            item = self._items.get(timeout=left_s)
        except Empty:
            raise TimedOut("no reply in time") from None
        self._taken_all = item is None
        return item

    def on_reply(self, reply: zenoh.Reply) -> None:
        sample = reply.ok
        if sample is not None:
            self._put(data_of(sample))
        elif reply.err is not None:
            self.error = plain(reply.err.payload.to_bytes().decode("utf-8", "replace"))

    def on_sample(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._put(data_of(sample))

    def on_end(self) -> None:
        self.ended = True
        self._put(None)

    def _put(self, item: bytes | None) -> None:
        items = self._items
        items.put(item)
        if items.qsize() > self._limit:
            with suppress(Empty):  # the caller's thread has just taken it
                items.get_nowait()
        self.on_put()


class Connection:
    """A client's session with the router of one vehicle.

    Args:
        vehicle: name of the vehicle.
        router: Zenoh endpoint of the router.
        timeout_s: longest wait for the router.

    Attributes:
        router: its address, for people.
        closed: whether `close` was called: an end of messages is then no fault of router or stack.

    Raises:
        Unreachable: no router replies in time.
    """

    def __init__(self, vehicle: str, router: str, timeout_s: float) -> None:
        self.vehicle = vehicle
        self.router = shown_router(router)
        self._endpoint = router
        self._may_publish: set[str] = set()
        self.client_id = f"py-{token_hex(6)}"
        self._session = _open(router, timeout_s)
        self._close = weakref.finalize(self, _close, self._session)
        """Also closes the session at the exit of a program that forgot to: later, Zenoh's threads may wait for the
        finished interpreter, and the program would wait for them."""
        self._kept: list[Callable[[], None]] = []
        """Keeps the subscribers of `subscribe_with` declared."""
        self.closed = False
        self._vehicle_time: tuple[int, float] | None = None
        self._token = self._session.liveliness().declare_token(liveliness_key(vehicle, "client", self.client_id))

    @property
    def connected(self) -> bool:
        """Whether a router is connected now."""
        return not self._session.is_closed() and bool(self._session.info.routers_zid())

    def sees_bridge(self) -> bool:
        """Whether the vehicle's bridge is in reach; it isn't while the link to the vehicle's computer is cut."""
        return _sees(self._session, self.vehicle, "vehicle_bridge", SEE_TIMEOUT_S)

    def hidden_reason(self) -> str:
        """Why the router shows nothing of the vehicle to the member whose keys these are; "" where it shows itself."""
        return hidden_reason(self._session, self._endpoint, self.vehicle) if self.connected else ""

    def set_vehicle_time(self, t_ns: int, *, may_have_waited: bool = False) -> None:
        """Set the vehicle time from a message.

        Args:
            may_have_waited: whether it may have waited in a queue for its reader; then one that is too old is ignored.
        """
        now_s = time.monotonic()
        if may_have_waited and self._vehicle_time is not None:
            before_ns, before_s = self._vehicle_time
            if (t_ns - before_ns) / NS_PER_S < now_s - before_s - VEHICLE_TIME_AGE_MAX_S:
                return
        self._vehicle_time = (t_ns, now_s)

    def vehicle_time_ns(self) -> int | None:
        """Vehicle time of the last message, or None if that is older than a second."""
        if self._vehicle_time is None or time.monotonic() - self._vehicle_time[1] > VEHICLE_TIME_AGE_MAX_S:
            return None
        return self._vehicle_time[0]

    def close(self) -> None:
        """Close the session, which ends open queries and subscriptions. May be called twice, and from any thread."""
        self.closed = True
        self._close()

    def loss_reason(self) -> str:
        """Reason why nothing can come any more, or "" while a router is connected."""
        if self.closed:
            return f"the connection to {self.vehicle} was closed"
        return "" if self.connected else f"the connection to the router {self.router} is lost"

    def stream(
        self, name: str, payload: bytes, timeout_s: float, priority: zenoh.Priority = zenoh.Priority.DATA
    ) -> ReplyArrivals:
        """Send a query; its replies arrive in the returned queue.

        Args:
            priority: of the query and its replies on a link that has no room for all.

        Raises:
            Unreachable: the session is closed.
        """
        arrivals = ReplyArrivals()
        try:
            self._session.get(
                key(self.vehicle, name),
                zenoh.handlers.Callback(arrivals.on_reply, arrivals.on_end, indirect=False),
                target=zenoh.QueryTarget.BEST_MATCHING,
                consolidation=zenoh.ConsolidationMode.NONE,
                priority=priority,
                timeout=timeout_s,
                payload=payload or None,
                encoding=zenoh.Encoding.APPLICATION_JSON,
                attachment=self.client_id.encode(),
            )
        except zenoh.ZError as error:
            raise Unreachable(self.loss_reason() or f"can't request {name} of {self.vehicle}: {error}") from None
        return arrivals

    def request(self, endpoint: Endpoint[Any, Any], payload: Payload, timeout_s: float) -> Any:
        """Send a request and wait for its one reply.

        Raises:
            Refused: the keys don't give the right to.
            Unreachable: no server has this key.
            TimedOut: the server does not reply in time.
        """
        priority = FIRST if endpoint.urgent else zenoh.Priority.DATA
        data = self.first(self.stream(endpoint.name, encode(payload), timeout_s, priority), endpoint.name, timeout_s)
        return decode(endpoint.reply_type, data)

    def first(self, arrivals: ReplyArrivals, name: str, timeout_s: float) -> bytes:
        """The first reply; raises the errors of `request`."""
        data = self.first_or_none(arrivals, name, timeout_s)
        if data is None:
            self._raise_unreachable(name)
        return data

    def first_or_none(self, arrivals: ReplyArrivals, name: str, timeout_s: float) -> bytes | None:
        """The first reply, or None if the query ended without one.

        Raises:
            TimedOut: no reply came, and the query did not end in time.
        """
        late = False
        try:
            data = arrivals.take(time.monotonic() + timeout_s + TIMEOUT_MARGIN_S)
        except TimedOut:
            late, data = True, None
        if late or (data is None and arrivals.error):
            raise TimedOut(f"{name} of {self.vehicle} did not reply within {timeout_s:g} s")
        return data

    def subscribe(self, topic: Topic[Any], limit: int = ARRIVALS_MAX) -> tuple[ReplyArrivals, Callable[[], None]]:
        """Subscribe to a topic.

        Args:
            limit: number of messages that wait for a slow reader.

        Returns:
            The queue of the topic's messages, and a function that ends the subscription.

        Raises:
            Unreachable: the session is closed.
        """
        arrivals = ReplyArrivals(limit)
        return arrivals, self._declare(topic, arrivals.on_sample, arrivals.on_end)

    def subscribe_with(self, topic: Topic[Any], on_data: Callable[[bytes], None], on_end: Callable[[], None]) -> None:
        """Call functions with each message of a topic and at the end of the connection, in Zenoh's thread.

        Raises:
            Unreachable: the session is closed.
        """

        def on_sample(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                on_data(data_of(sample))

        self._kept.append(self._declare(topic, on_sample, on_end))

    def _declare(
        self, topic: Topic[Any], on_sample: Callable[[zenoh.Sample], None], on_end: Callable[[], None]
    ) -> Callable[[], None]:
        """Declare a subscriber; returns the function that undeclares it."""
        try:
            subscriber = self._session.declare_subscriber(
                key(self.vehicle, topic.name), zenoh.handlers.Callback(on_sample, on_end, indirect=False)
            )
        except zenoh.ZError as error:
            raise Unreachable(self.loss_reason() or f"can't subscribe to {topic.name}: {error}") from None

        def undeclare() -> None:
            with suppress(zenoh.ZError):  # the session was closed, and the subscriber with it
                subscriber.undeclare()  # type: ignore[no-untyped-call]

        return undeclare

    def publish(self, topic: Topic[Any], message: Message) -> None:
        """Publish one message.

        Raises:
            Refused: this connection doesn't give the right to; the router would drop the message without a word.
            Unreachable: the session is closed.
        """
        if topic.name not in self._may_publish:
            self._check_right(topic.name)
            self._may_publish.add(topic.name)
        name = key(self.vehicle, topic.name)
        try:
            self._session.put(name, encode(message), encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            raise Unreachable(self.loss_reason() or f"can't publish {topic.name}: {error}") from None

    def _check_right(self, name: str) -> None:
        """Raise `Refused` where this connection doesn't give the right to send something there."""
        from jezero.keys.diagnosis import missing_right

        if reason := missing_right(self._endpoint, name):
            raise Refused(reason)

    def _raise_unreachable(self, name: str) -> NoReturn:
        if reason := self.loss_reason():
            raise Unreachable(reason)
        if name.startswith("@"):  # everybody may ask for what has no effect
            self._check_right(name)
        if reason := self.hidden_reason():
            raise Unreachable(reason)
        text = f"no server replies on {name} of {self.vehicle}"
        if self.sees_bridge():
            raise Unreachable(
                f"{text}: the stack is up, but this service has ended or is frozen: see `jezero ps` and `jezero logs`"
            )
        text += ": is the stack up? (`jezero up`, `jezero ps`). "
        text += f"If {self.vehicle} flies on another computer, the link to that computer may be cut"
        if name.startswith("@"):  # it has an effect
            text += ". The request may have arrived: see `jezero status` when the link is back"
        raise Unreachable(text)


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
            why = f"the reply can't be decoded ({error}): do client and stack have the same version?"
            raise JezeroError(why) from None

    return decode_this


def _close(session: zenoh.Session) -> None:
    if not session.is_closed():
        session.close()  # type: ignore[no-untyped-call]


def _open(router: str, timeout_s: float) -> zenoh.Session:
    """Connect to the router; tried in short attempts, as nothing interrupts one. TLS that fails ends them early."""
    deadline_s = time.monotonic() + timeout_s
    diagnosed = False
    while True:
        attempt_s = min(CONNECT_ATTEMPT_S, max(deadline_s - time.monotonic(), 0.05))
        try:
            return zenoh.open(client_config(router, attempt_s))
        except zenoh.ZError as error:
            if not diagnosed and (problem := _tls_problem(router)):
                raise Unreachable(problem) from error
            diagnosed = True
            if time.monotonic() >= deadline_s - 0.01:
                kind = ", with a tls/… address" if router.startswith("tls/") else ""
                hint = f"is the stack up{kind}? (`jezero up`) Is the address right?"
                raise Unreachable(f"no router at {shown_router(router)} within {timeout_s:g} s: {hint}") from error


def hidden_reason(session: zenoh.Session, endpoint: str, vehicle: str) -> str:
    """Why a router with TLS shows nothing of a vehicle to the member of a bundle; "" where it shows itself.

    Every member may see the token of the router that it connects to. It takes up to `HIDDEN_TIMEOUT_S`, so it is asked
    only when something is wrong.

    Args:
        session: a client's session with the router.
        endpoint: Zenoh's endpoint of the router, with the files of the bundle.
        vehicle: name of the vehicle.
    """
    if not endpoint.startswith("tls/"):
        return ""
    deadline_s = time.monotonic() + HIDDEN_TIMEOUT_S
    while (left_s := deadline_s - time.monotonic()) > 0.0:
        if _sees(session, vehicle, "router", left_s):
            return ""
        time.sleep(min(LOOK_PERIOD_S, left_s))
    from jezero.keys.diagnosis import hidden_reason as reason_of

    return reason_of(endpoint, vehicle)


def _sees(session: zenoh.Session, vehicle: str, service: str, timeout_s: float) -> bool:
    """Whether a service of a vehicle is in reach."""
    try:
        token = liveliness_key(vehicle, "service", service)
        return any(reply.ok for reply in session.liveliness().get(token, timeout=timeout_s))
    except zenoh.ZError:  # the session was closed
        return False


def _tls_problem(router: str) -> str:
    """Why TLS doesn't come about, or "". Its modules are imported only when something is wrong."""
    from jezero.keys.diagnosis import connection_problem

    return connection_problem(router)
