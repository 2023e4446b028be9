"""The bus over Zenoh in real time: one service, one process, one loop.

Zenoh's callbacks (`BusSession`) append to a queue and wake the loop. Only the loop (`ServiceLoop`) polls the sockets,
moves messages into the service's inbox, steps the service, and sends what the step yields.
"""

import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from types import FrameType
from typing import Any, Literal, cast

import zenoh

from jezero.base.codec import BadPayloadError, decode, encode, has_attachment, split_attachment
from jezero.base.plain_text import plain
from jezero.base.zenoh_client import FIRST, LAST, client_config, data_of, declare_publisher, put
from jezero.runtime.clock import VehicleClock
from jezero.runtime.instance import Instance, is_recorded
from jezero.runtime.journal import Journal, class_of
from jezero.runtime.links import SocketLink
from jezero.runtime.linux_processes import process_in_words
from jezero.runtime.node import Node
from jezero.runtime.service import SentMessage, Service, Spec
from jezero.runtime.task_runner import TaskRunner
from jezero.schemas import topics
from jezero.schemas.actions import UnknownAction
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.state import Clock
from jezero.schemas.topics import health_of, journal_of, key, liveliness_key
from jezero.schemas.units import NS_PER_S

MASTER_LATENESS_MAX_NS = 20_000_000
"""Lateness up to which the time master catches up; a later one slows vehicle time down instead."""
LOCKSTEP_TIMEOUT_NS = 16_000_000
"""Time for which the time master waits for the autopilot in one step of 4 ms: vehicle time runs at 0.25x at least."""
UNANSWERED_STEPS_MAX = 60
"""Steps in a row without an answer after which the autopilot is not waited for until it answers again."""
STALL_MIN_NS = 100_000_000
"""Lateness of the loop from which on the process counts as having been stopped."""
CATCH_UP_NS = 30_000_000
"""Pause after a stall, in which Zenoh delivers the messages that have piled up: the service must not take its inputs
for silent, or execute old requests, before it has read the newer messages."""
CLOCK_NAME = topics.CLOCK.name
LINK_POLL_PERIOD_NS = 50_000_000
"""Period at which links with nothing to read are polled too, as polling also connects."""
CLOSE_TIMEOUT_S = 0.7
PAUSED_PERIOD_NS = 20_000_000
"""Period of the time master's steps while vehicle time stands still."""
JOURNAL_WAITING_MAX_BYTES = 16_000_000
"""Parts of the journal that wait for a recorder; the oldest are dropped. A start of the stack takes far less."""
Kind = Literal["sample", "newest", "query", "response", "departed", "opened", "outcome", "sent"]
Enqueue = Callable[[Kind, str, Any], None]


class ServiceLoop:
    """The loop of one process: it moves messages into the inbox, and steps the service.

    It is the `Transport` of the service's node, too: what a step yields goes to the session, the links or the tasks.
    """

    def __init__(self, service: Service, instance: Instance, boot_id: int, links: dict[str, SocketLink]) -> None:
        self._spec = service.spec
        if set(links) != set(self._spec.links):
            raise ValueError(f"service {self._spec.name!r} needs links {self._spec.links}, got {tuple(links)}")
        self._links = links
        self._prefix = topics.key(instance.vehicle, "")
        self._clock = VehicleClock()
        self._master_t_ns = 0
        self._stalled_ns = 0
        self._held_ns = 0
        """Time that the inbox leaves out, because vehicle time stood still or was slow on purpose."""
        self._held_until_ns = 0
        self._pace = service.spec.pace
        """Pace of the time master; that of other services is their clock's."""
        self._stopping = False
        self._events: deque[tuple[Kind, str, Any]] = deque()
        """Arrivals from Zenoh's threads and that of the background tasks, oldest first."""
        self._newest: dict[str, zenoh.Sample] = {}
        """By topic, the last message with an attachment, until the loop reads it."""
        self._wakeup_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._wakeup_armed = True
        """Whether the next event has to wake the loop. False while the loop has still to read an earlier event."""
        self._readable: list[str] = []
        """Links that had something to read after the last wait."""
        self._link_states = dict.fromkeys(links, (0, False))
        """Number of connections of each link and whether it is up, as the node knows them."""
        self._session = BusSession(instance, self._spec, self._enqueue)
        self._tasks = TaskRunner(lambda tag, outcome: self._enqueue("outcome", tag, outcome))
        attached = (endpoint.name for endpoint in self._spec.serves if has_attachment(endpoint.reply_type))
        self._attached = frozenset(key(instance.vehicle, name) for name in attached)
        """Keys whose replies have attachments."""
        self._queries: dict[int, tuple[str, zenoh.Query]] = {}
        """Queries without a final reply yet, with the keys of their replies."""
        self._request_id = 0
        process = process_in_words()
        self._journal: Journal | None = None
        if is_recorded() and self._spec.keeps_journal:
            self._journal = Journal(self._spec.name, boot_id, self._spec.made_with, class_of(service))
        self._node = Node(service, self, strict=False, boot_id=boot_id, process=process, journal=self._journal)
        self._period_ns = int(NS_PER_S / self._spec.rate_hz)
        self._due_ns = 0
        """Time of the next step, unless something triggers one before."""
        self._wanted: frozenset[str] = frozenset()
        """Topics on demand that the service wants."""
        self._subscribed = self._wanted
        """Topics on demand that the session subscribes to now."""
        self._on_demand = frozenset(topic.name for topic in self._spec.on_demand)
        self._health_topic = health_of(self._spec.name)
        self._late_ns = 0
        self._next_router_check_ns = 0
        self._next_link_poll_ns = 0

    # -- life --

    def stop(self, signum: int = 0, frame: FrameType | None = None) -> None:
        """End the loop; a signal handler."""
        self._stopping = True
        self._wake()

    def run(self) -> None:
        """Open the links and the session, then step the service until `stop` is called."""
        for link in self._links.values():
            link.start()
        opening = self._session.open_in_background()
        while opening.is_alive() and not self._stopping:
            select.select([self._wakeup_fd], [], [], 0.2)
        if not self._session.is_open:  # the thread waits for a router inside the library: exit without it
            os._exit(0)
        self._session.declare()
        if self._spec.lockstep is None:
            self._loop()
        else:
            self._loop_as_master(self._spec.lockstep)

    def close(self) -> None:
        """Close the links and the session; a router that hangs doesn't delay it by more than a second."""
        for link in self._links.values():
            link.close()
        self._queries.clear()
        if self._session.is_open:
            self._publish_journal(force=True)
        self._session.close()

    # -- called by Zenoh's threads and that of the background tasks --

    def _enqueue(self, kind: Kind, name: str, value: Any) -> None:
        """Queue an event and wake the loop.

        Of a topic with attachments only the newest message is kept: a slow service would fill the memory.
        """
        if kind == "newest":
            self._newest[name] = value
            value = None
        self._events.append((kind, name, value))
        if self._wakeup_armed and kind != "sent":
            self._wakeup_armed = False
            self._wake()

    def _wake(self) -> None:
        os.eventfd_write(self._wakeup_fd, 1)

    # -- the loop --

    def _now_ns(self) -> int:
        """Monotonic time without the stalls of this process: the whole host may have stood still in them."""
        return time.monotonic_ns() - self._stalled_ns

    def _loop(self) -> None:
        now_ns = self._due_ns = self._now_ns()
        while not self._stopping:
            until_ns = max(now_ns, min(self._due_ns, self._node.health_due_ns(now_ns)))
            since_ns = self._now_ns()
            self._wait(until_ns)
            now_ns = self._now_ns()
            if now_ns - until_ns > STALL_MIN_NS:
                now_ns = self._past_stalls_ns(now_ns, min(since_ns, until_ns), until_ns)
            wanted = self._collect_links(now_ns)
            wanted |= self._collect(now_ns)
            if wanted or now_ns >= self._due_ns:
                if not wanted:
                    self._late_ns = max(self._late_ns, now_ns - self._due_ns)
                self._step(now_ns)
            self._report(now_ns)
            self._update_subscriptions()
        if self._spec.hears_all:  # what has arrived since the last step is not lost
            self._collect(now_ns)
            self._step(now_ns)

    def _step(self, now_ns: int) -> None:
        self._node.step(self._clock.now_ns(now_ns))  # not the time now: a stall since the loop's turn began is in it
        self._due_ns = now_ns + self._period_ns

    def _update_subscriptions(self) -> None:
        """Subscribe to the topics on demand; after the step, as a declaration takes the router a millisecond."""
        if self._subscribed is not self._wanted:
            self._subscribed = self._wanted
            self._session.subscribe_on_demand(self._subscribed)

    def _past_stalls_ns(self, now_ns: int, since_ns: int, until_ns: int) -> int:
        """Leave a stall out of the time, and wait until Zenoh has delivered the messages that piled up in it.

        The whole wait since `since_ns` counts as the stall, as its beginning is unknown; else odometry would look old
        after several stalls in a row. The next message of the clock corrects what was too much.

        Args:
            now_ns: time at the end of the wait.
            since_ns: time at the beginning of the wait.
            until_ns: time at which the wait should have ended.

        Returns:
            The time now.
        """
        while now_ns - until_ns > STALL_MIN_NS:
            self._late_ns = max(self._late_ns, now_ns - until_ns)
            self._stalled_ns += now_ns - since_ns
            until_ns = since_ns + CATCH_UP_NS
            time.sleep(CATCH_UP_NS / NS_PER_S)  # the process may be stopped again in it
            now_ns = self._now_ns()
        return now_ns

    def _loop_as_master(self, link: str) -> None:
        """Advance vehicle time by one period per step, in lockstep with the autopilot on `link`."""
        period_ns = int(NS_PER_S / self._spec.rate_hz)
        due_ns = self._now_ns()
        unanswered = 0
        while not self._stopping:
            self._wait(due_ns)
            now_ns = self._now_ns()
            self._collect_links(now_ns)
            self._collect(now_ns)
            self._update_subscriptions()
            if now_ns < due_ns:
                continue
            if self._pace == 0.0:
                self._node.step(self._master_t_ns)
                due_ns = now_ns + PAUSED_PERIOD_NS
                self._report(now_ns)
                continue
            if self._node.inbox.connections(link) > 0:
                self._late_ns = max(self._late_ns, now_ns - due_ns)
                self._node.step(self._master_t_ns)
                self._master_t_ns += period_ns
                if self._links[link].up:
                    answered = self._await_answer(link, wait=unanswered < UNANSWERED_STEPS_MAX)
                    unanswered = 0 if answered else unanswered + 1
            due_ns = max(due_ns + int(period_ns / (self._pace or 1.0)), now_ns - MASTER_LATENESS_MAX_NS)
            self._report(now_ns)

    def _await_answer(self, link: str, *, wait: bool) -> bool:
        """Whether bytes arrive on a link in time; without `wait`, whether they have arrived already."""
        sockets = self._links[link].sockets()
        deadline_ns = self._now_ns() + (LOCKSTEP_TIMEOUT_NS if wait else 0)
        while not self._stopping:
            remaining_ns = max(0, deadline_ns - self._now_ns())
            ready, _, _ = select.select(sockets, [], [], remaining_ns / NS_PER_S)
            if not ready:
                return False
            before = self._links[link].up
            data = self._links[link].poll(self._now_ns())
            if data:
                self._node.deliver_bytes(link, data)
                return True
            if before != self._links[link].up or not self._links[link].up:
                return False
            sockets = self._links[link].sockets()
        return False

    def _wait(self, until_ns: int) -> None:
        """Wait for an event or a readable link, at most until `until_ns`."""
        owners: dict[Any, str] = {end: name for name, link in self._links.items() for end in link.sockets()}
        timeout_s = max(0, until_ns - self._now_ns()) / NS_PER_S
        ends, _, _ = select.select([self._wakeup_fd, *owners], [], [], min(timeout_s, 0.1 if self._links else 1.0))
        self._readable.clear()
        for end in ends:
            if end is self._wakeup_fd:
                os.eventfd_read(self._wakeup_fd)
                self._wakeup_armed = True  # before the queue is read, so that no later event is left unread
            else:
                self._readable.append(owners[end])

    def _collect(self, now_ns: int) -> bool:
        """Move all events into the inbox; returns whether one of them triggers a step."""
        self._set_inbox_time(now_ns)
        wanted = False
        while self._events:
            wanted |= self._dispatch(*self._events.popleft())
        return wanted

    def _set_inbox_time(self, now_ns: int) -> None:
        """Set the wall time of the inbox, which is slower than real time when vehicle time is slower on purpose.

        A process that is silent because vehicle time stands still is not dead. A fast vehicle time leaves it as it is.
        """
        if self._spec.lockstep is None:
            pace = self._clock.pace_now(now_ns)
            if pace < 1.0 and now_ns > self._held_until_ns:
                self._held_ns += int((now_ns - self._held_until_ns) * (1.0 - pace))
            self._held_until_ns = now_ns
        inbox = self._node.inbox
        inbox.wall_ns, inbox.stalled_ns = now_ns - self._held_ns, self._stalled_ns + self._held_ns

    def _dispatch(self, kind: Kind, name: str, value: Any) -> bool:
        """Move one event into the inbox; returns whether it triggers a step."""
        node = self._node
        wanted = False
        if kind == "sample":
            wanted = self._on_sample(name, value)
        elif kind == "newest":
            if name in self._newest:  # else this message was replaced by a newer one, which has been read
                wanted = self._on_sample(name, data_of(self._newest.pop(name)))
        elif kind == "query":
            wanted = self._on_query(name, value)
        elif kind == "response":
            wanted = node.deliver_response(name, *value)
        elif kind == "outcome":
            wanted = node.deliver_outcome(name, value)
        elif kind == "sent":
            arrival_ns, data = value
            node.inbox.sent.append(SentMessage(arrival_ns, name, data))
        elif kind == "departed":
            wanted = node.deliver_departure(name)
        return wanted

    def _collect_links(self, now_ns: int) -> bool:
        """Move bytes and states of the links into the inbox; returns whether one of them triggers a step."""
        self._set_inbox_time(now_ns)
        wanted = False
        names: Iterable[str] = self._readable
        if now_ns >= self._next_link_poll_ns:
            self._next_link_poll_ns = now_ns + LINK_POLL_PERIOD_NS
            names = self._links
        for name in names:
            link = self._links[name]
            data = link.poll(now_ns)
            state, known = (link.connections, link.up), self._link_states[name]
            if state != known:
                self._link_states[name] = state
                if state[0] != known[0]:
                    self._node.set_link(name, False)
                wanted |= self._node.set_link(name, link.up)
            if data:
                wanted |= self._node.deliver_bytes(name, data)
        return wanted

    def _on_sample(self, name: str, data: bytes) -> bool:
        if name == CLOCK_NAME:
            self._on_clock(data)
        if name in self._on_demand and name not in self._wanted:  # it came before the subscription ended
            return False
        return self._node.deliver(name, data)

    def _on_clock(self, data: bytes) -> None:
        """Update vehicle time.

        The arrival counts as now, not as the time of the loop's turn: from before the message was sent, that would
        make the master seem ahead for good.
        """
        try:
            clock: Clock = decode(Clock, data)
        except BadPayloadError:
            return
        self._clock.update(clock.t_ns, clock.epoch_id, clock.wall_ns, self._now_ns(), clock.pace)

    def _on_query(self, name: str, query: zenoh.Query) -> bool:
        payload, attachment = query.payload, query.attachment
        data = b"" if payload is None else payload.to_bytes()
        parameters = dict(cast(Iterable[tuple[str, str]], query.parameters))
        if "*" in name:  # the endpoint is a pattern, whose requests are the keys
            data, parameters = encode(UnknownAction(key=str(query.key_expr)[len(self._prefix) :])), {}
        return self._node.deliver_request(
            name,
            self._keep_query(name, query),
            "" if attachment is None else plain(attachment.to_bytes().decode("utf-8", "replace")[:64]),
            data,
            parameters,
        )

    def _keep_query(self, name: str, query: zenoh.Query) -> int:
        """Keep a query to an endpoint until its final reply; returns the request's id."""
        self._request_id += 1
        own = str(query.key_expr) if "*" in name else f"{self._prefix}{name}"
        self._queries[self._request_id] = (own, query)
        return self._request_id

    def _report(self, now_ns: int) -> None:
        """Check the router twice a second, and publish health when it is due."""
        if now_ns >= self._next_router_check_ns:
            self._next_router_check_ns = now_ns + NS_PER_S // 2
            self._node.inbox.connected = self._session.connected
        if now_ns >= self._node.health_due_ns(now_ns):
            t_ns = self._master_t_ns if self._spec.lockstep else self._clock.now_ns(now_ns)
            health = self._node.health(t_ns, self._late_ns / NS_PER_S, now_ns)
            self._late_ns = 0
            self._session.put(self._health_topic, encode(health))
        self._publish_journal()

    def _publish_journal(self, *, force: bool = False) -> None:
        if self._journal is not None:
            part = self._journal.take(self._now_ns(), force=force)
            if part is not None:
                self._session.put_journal(part)

    # -- Transport --

    def publish(self, topic: Topic[Any], data: bytes) -> None:
        self._session.put(topic, data)

    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None:
        if request_id not in self._queries:
            return
        own, query = self._queries[request_id]
        if data is not None and own in self._attached:
            json, attachment = split_attachment(data)
            octets = zenoh.Encoding.APPLICATION_OCTET_STREAM
            query.reply(own, attachment, encoding=octets, attachment=json)
        elif data is not None:
            query.reply(own, data, encoding=zenoh.Encoding.APPLICATION_JSON)
        if final:
            del self._queries[request_id]
            query.drop()  # type: ignore[no-untyped-call]

    def call(self, endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None:
        self._session.call(endpoint, data, call_id, timeout_s)

    def send(self, link: str, data: bytes) -> None:
        self._links[link].send(data)

    def subscribe(self, names: frozenset[str]) -> None:
        self._wanted = names

    def set_rate(self, rate_hz: float) -> None:
        self._period_ns = int(NS_PER_S / rate_hz)

    def set_pace(self, pace: float) -> None:
        self._pace = pace

    def reconnect(self, link: str) -> None:
        self._links[link].close()
        self._links[link].start()

    def run_task(self, function: Callable[[], Any], tag: str) -> None:
        self._tasks.add(function, tag)

    def cancel_task(self, tag: str) -> None:
        self._tasks.cancel(tag)


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
        self._last_value: dict[str, bytes | None] = dict.fromkeys((topic.name for topic in spec.last_value), None)
        """The newest message of each such topic, as the reply to a plain get on its key; None before the first."""
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
        for name in self._last_value:
            self._declare_last_value(name)
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
                data = self._last_value[name]
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
        if topic.name in self._last_value:
            self._last_value[topic.name] = data
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
