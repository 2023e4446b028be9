"""The bus over Zenoh in real time: one service, one process, one loop.

Zenoh's callbacks append to a queue and wake the loop. Only the loop polls the sockets, moves messages into the
service's inbox and steps the service.
"""

import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from types import FrameType
from typing import Any, cast

import zenoh

from jezero.codec import BadPayloadError, decode, encode, has_attachment, split_attachment
from jezero.plain_text import plain
from jezero.runtime.clock import VehicleClock
from jezero.runtime.config import Instance, is_recorded
from jezero.runtime.journal import Journal
from jezero.runtime.links import SocketLink
from jezero.runtime.node import Node
from jezero.runtime.service import SentMessage, Service, Spec
from jezero.runtime.task_runner import TaskRunner
from jezero.runtime.zenoh_session import BusSession, Kind
from jezero.schemas import topics
from jezero.schemas.actions import UnknownAction
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.state import Clock
from jezero.schemas.topics import health_of, key
from jezero.schemas.units import NS_PER_S
from jezero.zenoh_client import data_of

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


class ServiceLoop:
    """The loop of one process: it moves messages into the inbox, and steps the service."""

    def __init__(self, service: Service, instance: Instance, boot_id: int, links: dict[str, SocketLink]) -> None:
        self._spec = service.spec
        if set(links) != set(self._spec.links):
            raise ValueError(f"service {self._spec.name!r} needs links {self._spec.links}, got {tuple(links)}")
        self._links = links
        self._prefix = topics.key(instance.vehicle, "")
        self._clock = VehicleClock()
        self._master_t_ns = 0
        self._stalled_ns = 0
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
        tasks = TaskRunner(lambda tag, outcome: self._enqueue("outcome", tag, outcome))
        self._out = ZenohTransport(instance, self._spec, self._session, links, tasks)
        process = f"{socket.gethostname()} pid {os.getpid()}"
        self._journal: Journal | None = None
        if is_recorded() and not self._spec.hears_all:
            self._journal = Journal(self._spec.name, boot_id, self._spec.made_with)
        self._node = Node(service, self._out, strict=False, boot_id=boot_id, process=process, journal=self._journal)
        self._due_ns = 0
        """Time of the next step, unless something triggers one before."""
        self._subscribed = self._out.subscribed
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
        self._out.forget_queries()
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
        self._due_ns = now_ns + self._out.period_ns

    def _update_subscriptions(self) -> None:
        """Subscribe to the topics on demand; after the step, as a declaration takes the router a millisecond."""
        if self._subscribed is not self._out.subscribed:
            self._subscribed = self._out.subscribed
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
            if self._node.inbox.connections(link) > 0:
                self._late_ns = max(self._late_ns, now_ns - due_ns)
                self._node.step(self._master_t_ns)
                self._master_t_ns += period_ns
                if self._links[link].up:
                    answered = self._await_answer(link, wait=unanswered < UNANSWERED_STEPS_MAX)
                    unanswered = 0 if answered else unanswered + 1
            due_ns = max(due_ns + period_ns, now_ns - MASTER_LATENESS_MAX_NS)
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
        self._node.inbox.wall_ns = now_ns
        wanted = False
        while self._events:
            wanted |= self._dispatch(*self._events.popleft())
        return wanted

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
        self._node.inbox.wall_ns = now_ns
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
        if name in self._on_demand and name not in self._out.subscribed:  # it came before the subscription ended
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
        self._clock.update(clock.t_ns, clock.epoch_id, clock.wall_ns, self._now_ns())

    def _on_query(self, name: str, query: zenoh.Query) -> bool:
        payload, attachment = query.payload, query.attachment
        data = b"" if payload is None else payload.to_bytes()
        parameters = dict(cast(Iterable[tuple[str, str]], query.parameters))
        if "*" in name:  # the endpoint is a pattern, whose requests are the keys
            data, parameters = encode(UnknownAction(key=str(query.key_expr)[len(self._prefix) :])), {}
        return self._node.deliver_request(
            name,
            self._out.keep_query(name, query),
            "" if attachment is None else plain(attachment.to_bytes().decode("utf-8", "replace")[:64]),
            data,
            parameters,
        )

    def _report(self, now_ns: int) -> None:
        """Check the router twice a second, and publish health when it is due."""
        if now_ns >= self._next_router_check_ns:
            self._next_router_check_ns = now_ns + NS_PER_S // 2
            self._node.inbox.connected = self._session.connected
        if now_ns >= self._node.health_due_ns(now_ns):
            t_ns = self._master_t_ns if self._spec.lockstep else self._clock.now_ns(now_ns)
            health = self._node.health(t_ns, self._late_ns / NS_PER_S)
            self._late_ns = 0
            self._session.put(self._health_topic, encode(health))
        self._publish_journal()

    def _publish_journal(self, *, force: bool = False) -> None:
        if self._journal is not None:
            part = self._journal.take(self._now_ns(), force=force)
            if part is not None:
                self._session.put_journal(part)


class ZenohTransport:
    """Executes the outputs of one service's steps.

    Attributes:
        period_ns: time from a step to the next, unless something triggers one before.
        subscribed: the topics on demand that the service wants; the loop declares them to the router.
    """

    def __init__(
        self, instance: Instance, spec: Spec, session: BusSession, links: Mapping[str, SocketLink], tasks: TaskRunner
    ) -> None:
        self.period_ns = int(NS_PER_S / spec.rate_hz)
        self.subscribed: frozenset[str] = frozenset()
        self._vehicle = instance.vehicle
        self._session = session
        self._links = links
        self._tasks = tasks
        self._last_value = frozenset(topic.name for topic in spec.last_value)
        attached = (endpoint.name for endpoint in spec.serves if has_attachment(endpoint.reply_type))
        self._attached = frozenset(key(instance.vehicle, name) for name in attached)
        """Keys whose replies have attachments."""
        self._queries: dict[int, tuple[str, zenoh.Query]] = {}
        """Queries without a final reply yet, with the keys of their replies."""
        self._request_id = 0

    def keep_query(self, name: str, query: zenoh.Query) -> int:
        """Keep a query to an endpoint until its final reply; returns the request's id."""
        self._request_id += 1
        own = str(query.key_expr) if "*" in name else key(self._vehicle, name)
        self._queries[self._request_id] = (own, query)
        return self._request_id

    def forget_queries(self) -> None:
        """End all requests without a reply."""
        self._queries.clear()

    # -- Transport --

    def publish(self, topic: Topic[Any], data: bytes) -> None:
        if topic.name in self._last_value:
            self._session.set_last_value(topic, data)
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
        self.subscribed = names

    def set_rate(self, rate_hz: float) -> None:
        self.period_ns = int(NS_PER_S / rate_hz)

    def run_task(self, function: Callable[[], Any], tag: str) -> None:
        self._tasks.add(function, tag)

    def cancel_task(self, tag: str) -> None:
        self._tasks.cancel(tag)
