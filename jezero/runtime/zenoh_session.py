"""One service's session on the Zenoh router: its declarations, and the messages, requests and replies it exchanges."""

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Literal

import zenoh

from jezero.codec import has_attachment
from jezero.runtime.config import Instance
from jezero.runtime.service import Spec
from jezero.schemas import topics
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.topics import health_of, journal_of, key, liveliness_key
from jezero.zenoh_client import FIRST, LAST, client_config, data_of, declare_publisher, put

CLOSE_TIMEOUT_S = 0.7
JOURNAL_WAITING_MAX_BYTES = 16_000_000
"""Parts of the journal that wait for a recorder; the oldest are dropped. A start of the stack takes far less."""
Kind = Literal["sample", "newest", "query", "response", "departed", "opened", "outcome", "sent"]
Enqueue = Callable[[Kind, str, Any], None]


def _direct(callback: Callable[[Any], None], drop: Callable[[], None] | None = None) -> Any:
    """Zenoh's handler that calls back in the receiving thread: all arrives in order, and needs no more threads.

    Args:
        callback: called with each sample, query or reply.
        drop: called when there will be no more of them.
    """
    return zenoh.handlers.Callback(callback, drop, indirect=False)


def close_or_exit(session: zenoh.Session) -> None:
    """Close a session, or end the process after `CLOSE_TIMEOUT_S`, e.g. when what is at the other end hangs."""
    closer = threading.Thread(target=session.close, daemon=True)
    closer.start()
    closer.join(CLOSE_TIMEOUT_S)
    if closer.is_alive():
        sys.stderr.flush()
        os._exit(0)


class BusSession:
    """The session of one service.

    Args:
        instance: names the vehicle and the router.
        spec: the service's declaration.
        enqueue: called by Zenoh's threads as `enqueue(kind, name, value)` with each arrival.

    Kinds of arrivals:
        sample: a topic's name and the bytes of a message.
        newest: a topic's name and the sample of a message with an attachment.
        query: an endpoint's name and the query.
        response: a call's id and (bytes, None) or (None, error).
        departed: the id of a client, or the name of a service, that vanished.
        sent: the name of any topic and (time of arrival in ns since 1970, the message), for `Spec.hears_all`.
        opened: the session is open.
    """

    def __init__(self, instance: Instance, spec: Spec, enqueue: Enqueue) -> None:
        self._instance = instance
        self._spec = spec
        self._enqueue = enqueue
        self._opened: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._subscribers: dict[str, zenoh.Subscriber[Any]] = {}
        self._declared: list[Any] = []
        self._last_value: dict[str, bytes] = {}
        used = (*spec.inputs, *spec.on_demand, *spec.outputs)
        self._journal: zenoh.Publisher | None = None
        self._journal_waiting: deque[bytes] = deque()
        """Parts of the journal that nobody has subscribed to yet."""
        self._attached = frozenset(topic.name for topic in used if has_attachment(topic.type))
        """Topics whose messages have attachments."""

    @property
    def is_open(self) -> bool:
        """Whether the router has been found."""
        return self._opened is not None

    @property
    def connected(self) -> bool:
        """Whether the router is there now."""
        return bool(self._session.info.routers_zid())

    def open_in_background(self) -> threading.Thread:
        """Start to connect to the router in a thread that can't be interrupted; after it `is_open` is true."""

        def connect() -> None:
            self._opened = zenoh.open(client_config(self._instance.router))
            self._enqueue("opened", "", None)

        thread = threading.Thread(target=connect, daemon=True)
        thread.start()
        return thread

    def close(self) -> None:
        """Close the session; see `close_or_exit`."""
        if self._opened is not None:
            close_or_exit(self._opened)

    @property
    def _session(self) -> zenoh.Session:
        if self._opened is None:
            raise RuntimeError("the session is not open")
        return self._opened

    # -- declarations --

    def declare(self) -> None:
        """Declare everything that the service's `Spec` names, and that the service is there."""
        session = self._session
        alive = liveliness_key(self._instance.vehicle, "service", self._spec.name)
        self._declared.append(session.liveliness().declare_token(alive))
        for topic in (*self._spec.outputs, health_of(self._spec.name)):
            self._publishers[topic.name] = declare_publisher(
                session,
                key(self._instance.vehicle, topic.name),
                attached=topic.name in self._attached,
                congestion=zenoh.CongestionControl.DROP,  # else one reader that stands still stops everybody
                urgent=topic.urgent,
            )
        for topic in self._spec.last_value:
            self._declare_last_value(topic.name)
        for topic in self._spec.inputs:
            self.subscribe(topic.name)
        if self._uses_vehicle_time() and topics.CLOCK not in self._spec.inputs:
            self.subscribe(topics.CLOCK.name)
        for endpoint in self._spec.serves:
            self._declare_endpoint(endpoint)
        if self._spec.hears_all:
            self._declared.append(self._hear_all())
        if self._spec.watches is not None:
            watched = liveliness_key(self._instance.vehicle, self._spec.watches, "*")
            self._declared.append(session.liveliness().declare_subscriber(watched, _direct(self._on_watched)))

    def _hear_all(self) -> Any:
        """Subscribe to everything but the keys with an effect, which no wildcard matches."""
        prefix = key(self._instance.vehicle, "")
        enqueue = self._enqueue

        def on_sample(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                enqueue("sent", str(sample.key_expr)[len(prefix) :], (time.time_ns(), data_of(sample)))

        return self._session.declare_subscriber(f"{prefix}**", _direct(on_sample))

    def _uses_vehicle_time(self) -> bool:
        spec = self._spec
        return spec.lockstep is None and bool(spec.inputs or spec.outputs or spec.serves)

    def subscribe(self, name: str) -> None:
        """Subscribe to a topic."""
        enqueue, attached = self._enqueue, name in self._attached

        def on_sample(sample: zenoh.Sample) -> None:
            enqueue("newest" if attached else "sample", name, sample if attached else sample.payload.to_bytes())

        own = key(self._instance.vehicle, name)
        self._subscribers[name] = self._session.declare_subscriber(own, _direct(on_sample))

    def _declare_endpoint(self, endpoint: Endpoint[Any, Any]) -> None:
        own, name = key(self._instance.vehicle, endpoint.name), endpoint.name
        exactly = zenoh.KeyExpr(own)
        enqueue = self._enqueue

        def is_meant(asked: zenoh.KeyExpr) -> bool:
            if "*" in name:  # a pattern: every single key that it matches, but nobody's wildcards
                return "*" not in str(asked)
            return endpoint.wildcards or asked == exactly

        def on_query(query: zenoh.Query) -> None:
            if not is_meant(query.key_expr):
                query.drop()  # type: ignore[no-untyped-call]
            else:
                enqueue("query", name, query)

        queryable = self._session.declare_queryable(own, _direct(on_query), complete=not endpoint.shared)
        self._declared.append(queryable)

    def _declare_last_value(self, name: str) -> None:
        own = key(self._instance.vehicle, name)

        def on_query(query: zenoh.Query) -> None:
            with query:
                data = self._last_value.get(name)
                if data is not None:
                    query.reply(own, data, encoding=zenoh.Encoding.APPLICATION_JSON)

        self._declared.append(self._session.declare_queryable(own, _direct(on_query), complete=True))

    def _on_watched(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            self._enqueue("departed", str(sample.key_expr).rsplit("/", 1)[-1], None)

    def subscribe_on_demand(self, names: frozenset[str]) -> None:
        """Subscribe to exactly these of the topics on demand."""
        on_demand = {topic.name for topic in self._spec.on_demand}
        for name in sorted(on_demand & set(self._subscribers) - names):
            self._subscribers.pop(name).undeclare()  # type: ignore[no-untyped-call]
        for name in sorted(names - set(self._subscribers)):
            self.subscribe(name)

    # -- out --

    def put(self, topic: Topic[Any], data: bytes) -> None:
        """Publish a message."""
        put(self._publishers[topic.name], data, attached=topic.name in self._attached)

    def put_journal(self, part: bytes) -> None:
        """Publish a part of the service's journal, as soon as a recorder has subscribed to it."""
        self._journal_waiting.append(part)
        while sum(map(len, self._journal_waiting)) > JOURNAL_WAITING_MAX_BYTES:
            self._journal_waiting.popleft()
        if self._journal is None:
            own = key(self._instance.vehicle, journal_of(self._spec.name).name)
            self._journal = self._session.declare_publisher(
                own,
                encoding=zenoh.Encoding.APPLICATION_JSON,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=LAST,
            )
        status: Any = self._journal.matching_status
        if status.matching:
            while self._journal_waiting:
                self._journal.put(self._journal_waiting.popleft())

    def set_last_value(self, topic: Topic[Any], data: bytes) -> None:
        """Reply with this message to a plain get on a topic's key from now on."""
        self._last_value[topic.name] = data

    def call(self, endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None:
        """Send a request; each reply is enqueued as a response, and "no server" when there will be no more."""

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            self._enqueue(
                "response", call_id, (None, "timeout") if sample is None else (sample.payload.to_bytes(), None)
            )

        self._session.get(
            key(self._instance.vehicle, endpoint.name),
            _direct(on_reply, lambda: self._enqueue("response", call_id, (None, "no server"))),
            target=zenoh.QueryTarget.BEST_MATCHING,
            consolidation=zenoh.ConsolidationMode.NONE,
            priority=FIRST if endpoint.urgent else zenoh.Priority.DATA,
            timeout=timeout_s,
            payload=data,
            encoding=zenoh.Encoding.APPLICATION_JSON,
        )
