"""The bus in one process and virtual time: the same services and bytes, deterministic, without sleeping.

Events happen in the order (t_ns, topic, sequence). Everything that arrives at one time is in a service's inbox before
it steps. Each link delays its messages by a seeded distribution and keeps their order, as a connection does.
"""

import heapq
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from math import exp
from random import Random
from typing import Any, Literal

from jezero.base.codec import decode, encode
from jezero.runtime.journal import Journal, class_of
from jezero.runtime.node import Node
from jezero.runtime.service import SentMessage, Service
from jezero.runtime.task import CANCELED, TaskOutcome, execute, pickled, read_outcome
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.struct import Payload
from jezero.schemas.topics import health_of, journal_of
from jezero.schemas.units import NS_PER_S

Observer = Callable[[int, str, bytes], None]
Tamper = Callable[[str, str, str, int, bytes], Iterable[tuple[int, bytes]]]
"""Maps (sender, receiver, name, t_ns of arrival, data) to the deliveries that replace it, each (t_ns of arrival, data).

`name` is a topic's, an endpoint's, or that of the receiver's link; `REPLY` for a reply, and for the end of a request,
which has no data.
"""
REPLY = "@reply"
BACKGROUND_TASK_S = 0.2
"""Duration of every background task, which is executed in this process: flights must not depend on how fast this
machine is."""


@dataclass(frozen=True)
class LinkDelay:
    """Log-normal delay of a link, measured on the real bus by `benchmarks/speed/link_delay.py`.

    Attributes:
        median_s: median of the delay.
        sigma: standard deviation of its logarithm; 0 delays every message by `median_s`.
        longest_s: upper limit of the delay.
    """

    median_s: float
    sigma: float = 0.0
    longest_s: float = 0.1

    def sample_ns(self, rng: Random) -> int:
        """One delay."""
        if self.sigma == 0.0:
            return int(self.median_s * NS_PER_S)
        return int(min(self.median_s * exp(rng.normalvariate(0.0, self.sigma)), self.longest_s) * NS_PER_S)


BUS_DELAY = LinkDelay(median_s=0.0007, sigma=0.4, longest_s=0.02)
UDP_DELAY = LinkDelay(median_s=0.0002, sigma=0.5)
NO_DELAY = LinkDelay(median_s=0.0)


@dataclass
class SentRequest:
    """An outside client's request, and the replies to it so far.

    Attributes:
        replies: decoded, oldest first.
        ended: whether no more replies will come.
    """

    replies: list[Any] = field(default_factory=list)
    ended: bool = False


class MemoryBus:
    """Runs services in virtual time, which starts at 0.

    Args:
        seed: seed of every link's delays.
        delay: distribution of the delays of messages, requests and replies.
        strict: whether a number that is not finite raises when a service publishes it, and whether a step that fails
            does.

    Attributes:
        t_ns: virtual time.
        tamper: changes deliveries from now on, to simulate faults; None, the default, changes nothing.
    """

    def __init__(self, seed: int = 0, delay: LinkDelay = BUS_DELAY, *, strict: bool = True) -> None:
        self.t_ns = 0
        self.tamper: Tamper | None = None
        self._seed = seed
        self._delay = delay
        self._strict = strict
        self._heap: list[tuple[int, str, int, Callable[[], None]]] = []
        self._sequence = 0
        self._ports: dict[str, Port] = {}
        self._order: list[Port] = []
        self._subscribers: dict[str, list[Port]] = {}
        """Cache by topic, emptied when a service starts, dies or changes its subscriptions."""
        self._wires: dict[tuple[str, str], _Wire] = {}
        self._paths: dict[tuple[str, str], _Path] = {}
        self._requests: dict[int, _PendingRequest] = {}
        self._observers: list[Observer] = []
        self._journal_reader: Observer | None = None

    # -- building --

    def add(self, service: Service) -> None:
        """Start a service; its first step is at the present time."""
        name = service.spec.name
        if name in self._ports:
            raise ValueError(f"a service named {name!r} runs already")
        port = Port(self, service, strict=self._strict, journaled=self._journal_reader is not None)
        self._ports[name] = port
        self._order.append(port)
        self._subscribers.clear()
        if service.spec.hears_all:
            self.observe(port.hear)
        for (owner, link), wire in self._wires.items():
            if owner == name or wire.peer[0] == name:
                self._set_link(owner, link, up=owner in self._ports and wire.peer[0] in self._ports)
        port.schedule_tick(self.t_ns)

    def remove(self, name: str) -> None:
        """End a service at once: its links go down and its pending requests end without a reply."""
        port = self._ports.pop(name)
        self._order.remove(port)
        self._subscribers.clear()
        port.alive = False
        for (owner, link), wire in self._wires.items():
            if wire.peer[0] == name:
                self._set_link(owner, link, up=False)
        for request_id, request in [(i, r) for i, r in self._requests.items() if r.server == name]:
            del self._requests[request_id]
            self._send_back(request.client_id, name, b"", partial(_ignoring_data, request.on_end))
        self._report_departure("service", name)

    def freeze(self, name: str, seconds: float) -> None:
        """Stop a service's steps for a duration, as SIGSTOP does; arrivals wait in its inbox."""
        port = self._ports[name]
        port.frozen_until_ns = self.t_ns + int(seconds * NS_PER_S)
        self.at(port.frozen_until_ns, "", port.request_step)

    def has(self, name: str) -> bool:
        """Whether a service of this name runs or is frozen."""
        return name in self._ports

    def runs(self, name: str) -> bool:
        """Whether a service of this name runs and is not frozen."""
        port = self._ports.get(name)
        return port is not None and port.frozen_until_ns <= self.t_ns

    def wire(self, a: tuple[str, str], b: tuple[str, str], delay: LinkDelay = NO_DELAY) -> None:
        """Connect two services' links, each named (service, link)."""
        self._wires[a] = _Wire(b, delay, self._path(".".join(a), ".".join(b)))
        self._wires[b] = _Wire(a, delay, self._path(".".join(b), ".".join(a)))
        if a[0] in self._ports and b[0] in self._ports:
            self._set_link(*a, up=True)
            self._set_link(*b, up=True)

    def reconnect(self, owner: str, link: str) -> None:
        """Close the connection of a link, and connect it again at once."""
        wire = self._wires.get((owner, link))
        if wire is not None and wire.peer[0] in self._ports:
            for up in (False, True):
                self._set_link(owner, link, up=up)
                self._set_link(*wire.peer, up=up)

    def observe(self, observer: Observer) -> None:
        """Call `observer(t_ns, topic, data)` for every published message, when it is sent."""
        self._observers.append(observer)

    def read_journals(self, reader: Observer) -> None:
        """Let the services that are added from now on keep journals; `reader` gets their parts, as an observer."""
        self._journal_reader = reader

    def end_journals(self) -> None:
        """Give the reader of the journals what it has not got yet."""
        for port in self._order:
            port.publish_journal(force=True)

    # -- running --

    def run_until(self, t_ns: int, stop: Callable[[], bool] | None = None) -> bool:
        """Execute all events up to and including `t_ns`; return early with True when `stop()` is true."""
        heap = self._heap
        while heap and heap[0][0] <= t_ns:
            now_ns = self.t_ns = heap[0][0]
            while heap and heap[0][0] == now_ns:
                heapq.heappop(heap)[3]()
            for port in self._order:
                if port.wants_step and port.frozen_until_ns <= now_ns:
                    port.step()
            if stop is not None and stop():
                return True
        self.t_ns = max(self.t_ns, t_ns)
        return stop is not None and stop()

    def run_for(self, seconds: float, stop: Callable[[], bool] | None = None) -> bool:
        """Execute all events of a duration, as `run_until`."""
        return self.run_until(self.t_ns + int(seconds * NS_PER_S), stop)

    def send_request(self, endpoint: Endpoint[Any, Any], payload: Payload, client_id: str = "client") -> SentRequest:
        """Send a request as an outside client does; its replies arrive while the bus runs."""
        request = SentRequest()

        def on_reply(data: bytes) -> None:
            request.replies.append(decode(endpoint.reply_type, data))

        def on_end() -> None:
            request.ended = True

        self._request(client_id, endpoint, encode(payload), on_reply, on_end)
        return request

    def client_departs(self, client_id: str) -> None:
        """Report to the services that watch clients that one has vanished."""
        self._report_departure("client", client_id)

    # -- for ports --

    def at(self, t_ns: int, name: str, action: Callable[[], None]) -> None:
        """Schedule an event; events of one time happen in the order of their names."""
        self._sequence += 1
        heapq.heappush(self._heap, (t_ns, name, self._sequence, action))

    def forget_subscribers(self) -> None:
        """Find the subscribers of each topic again, as a service has changed its subscriptions."""
        self._subscribers.clear()

    def publish(self, sender: str, topic: Topic[Any], data: bytes) -> None:
        """Deliver a message to every subscriber."""
        for observer in self._observers:
            observer(self.t_ns, topic.name, data)
        subscribers = self._subscribers.get(topic.name)
        if subscribers is None:
            subscribers = [port for port in self._order if topic.name in port.subscribed]
            self._subscribers[topic.name] = subscribers
        for port in subscribers:
            t_ns = self._arrival(self._path(sender, port.name), self._delay)
            self._deliver(sender, port.name, topic.name, t_ns, data, partial(port.receive, topic.name))

    def publish_journal(self, name: str, part: bytes) -> None:
        """Give a part of a service's journal to the reader."""
        if self._journal_reader is not None:
            self._journal_reader(self.t_ns, name, part)

    def send(self, owner: str, link: str, data: bytes) -> None:
        """Deliver bytes to the other end of a service's link."""
        wire = self._wires.get((owner, link))
        if wire is None:
            return
        peer, peer_link = wire.peer
        port = self._ports.get(peer)
        if port is not None:
            t_ns = self._arrival(wire.path, wire.delay)
            self._deliver(owner, peer, peer_link, t_ns, data, partial(port.receive_bytes, peer_link))

    def call(self, caller: "Port", endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None:
        """Send a service's request; its node gets each reply, the end of the replies and the timeout."""

        def respond(reply: bytes | None, error: str | None) -> None:
            if caller.alive:
                caller.wants_step |= caller.node.deliver_response(call_id, reply, error)

        self._request(
            caller.name, endpoint, data, lambda reply: respond(reply, None), lambda: respond(None, "no server")
        )
        self.at(self.t_ns + int(timeout_s * NS_PER_S), endpoint.name, lambda: respond(None, "timeout"))

    def reply(self, server: str, request_id: int, data: bytes | None, *, final: bool) -> None:
        """Send a reply (None: none) back to the client of a request."""
        request = self._requests.get(request_id)
        if request is None:
            return
        if data is not None:
            self._send_back(request.client_id, server, data, request.on_reply)
        if final:
            del self._requests[request_id]
            self._send_back(request.client_id, server, b"", partial(_ignoring_data, request.on_end))

    # -- inside --

    def _report_departure(self, kind: Literal["client", "service"], name: str) -> None:
        for port in self._order:
            if port.node.spec.watches == kind:
                port.node.deliver_departure(name)
                self.at(self.t_ns, "", port.request_step)

    def _request(
        self,
        client_id: str,
        endpoint: Endpoint[Any, Any],
        data: bytes,
        on_reply: Callable[[bytes], None],
        on_end: Callable[[], None],
    ) -> None:
        servers = [port for port in self._order if endpoint.name in port.serving]
        if not servers:
            self._send_back(client_id, "", b"", partial(_ignoring_data, on_end))
            return
        pending = len(servers)

        def on_end_of_one() -> None:
            nonlocal pending
            pending -= 1
            if pending == 0:
                on_end()

        for port in servers:
            self._sequence += 1
            request_id = self._sequence
            self._requests[request_id] = _PendingRequest(client_id, port.name, on_reply, on_end_of_one)
            t_ns = self._arrival(self._path(client_id, port.name), self._delay)
            receive = partial(port.receive_request, endpoint.name, request_id, client_id)
            self._deliver(client_id, port.name, endpoint.name, t_ns, data, receive)

    def _send_back(self, receiver: str, sender: str, data: bytes, receive: Callable[[bytes], None]) -> None:
        t_ns = self._arrival(self._path(sender, receiver), self._delay)
        self._deliver(sender, receiver, REPLY, t_ns, data, receive)

    def _deliver(
        self, sender: str, receiver: str, name: str, t_ns: int, data: bytes, receive: Callable[[bytes], None]
    ) -> None:
        """Schedule the arrival of anything that travels between two services or clients."""
        if self.tamper is None:
            self.at(t_ns, name, partial(receive, data))
            return
        for arrival_ns, changed in self.tamper(sender, receiver, name, t_ns, data):
            self.at(max(self.t_ns, arrival_ns), name, partial(receive, changed))

    def _path(self, sender: str, receiver: str) -> "_Path":
        path = self._paths.get((sender, receiver))
        if path is None:
            rng = Random(zlib.crc32(f"{self._seed}/{sender}>{receiver}".encode()))
            path = self._paths[sender, receiver] = _Path(rng)
        return path

    def _arrival(self, path: "_Path", delay: LinkDelay) -> int:
        t_ns = self.t_ns + delay.sample_ns(path.rng)
        if t_ns < path.arrived_ns:
            return path.arrived_ns
        path.arrived_ns = t_ns
        return t_ns

    def _set_link(self, owner: str, link: str, *, up: bool) -> None:
        port = self._ports.get(owner)
        if port is not None:
            port.wants_step |= port.node.set_link(link, up)


class Port:
    """A running service with its node; the `Transport` of that node.

    Attributes:
        name: the service's.
        alive: False when the service has died.
        wants_step: something has arrived that triggers a step.
        frozen_until_ns: time before which the service stands still.
        node: the service's mailbox and the check of its declaration.
        subscribed: names of the topics that it receives now.
        serving: names of its endpoints.
    """

    def __init__(self, bus: MemoryBus, service: Service, *, strict: bool, journaled: bool = False) -> None:
        self.name = service.spec.name
        self.alive = True
        self.wants_step = False
        self.frozen_until_ns = 0
        self._bus = bus
        spec = service.spec
        keeps_journal = journaled and spec.keeps_journal
        self._journal = Journal(spec.name, 0, spec.made_with, class_of(service)) if keeps_journal else None
        self.node = Node(service, self, strict=strict, boot_id=0, journal=self._journal)
        self.subscribed = frozenset(topic.name for topic in spec.inputs)
        self.serving = frozenset(endpoint.name for endpoint in spec.serves)
        self._inputs = self.subscribed
        self._period_ns = int(NS_PER_S / spec.rate_hz)
        self._tick_ns = 0
        """Time of the next step, unless something triggers one before."""
        self._timer_ns: int | None = None
        """Time of the one event on the bus that makes the step of `_tick_ns`; it may be earlier."""
        self._tasks_end_ns = 0
        self._tasks: dict[str, bytes | TaskOutcome] = {}
        """Background tasks by tag that are not over: pickled functions, and outcomes of those that can't be pickled."""
        self._health_topic = health_of(self.name)
        self._journal_topic = journal_of(self.name).name

    def schedule_tick(self, t_ns: int) -> None:
        """Step at `t_ns`. Each step puts the next one off, so one timer is kept and set again when it fires early."""
        self._tick_ns = t_ns
        if self._timer_ns is None or self._timer_ns > t_ns:
            self._timer_ns = t_ns
            self._bus.at(t_ns, "", partial(self._on_timer, t_ns))

    def _on_timer(self, t_ns: int) -> None:
        if not self.alive or t_ns != self._timer_ns:
            return
        self._timer_ns = None
        if t_ns < self._tick_ns:
            self.schedule_tick(self._tick_ns)
        else:
            self.wants_step = True

    def request_step(self) -> None:
        """Step as soon as the bus has delivered all that arrives now."""
        self.wants_step = True

    def step(self) -> None:
        """Step the service, and publish its health when it is due."""
        bus = self._bus
        self.wants_step = False
        self.node.inbox.wall_ns = bus.t_ns
        self.node.step(bus.t_ns)
        if self.alive:
            self.schedule_tick(bus.t_ns + self._period_ns)
        if bus.t_ns >= self.node.health_due_ns(bus.t_ns):
            bus.publish(self.name, self._health_topic, encode(self.node.health(bus.t_ns, 0.0, bus.t_ns)))
        self.publish_journal()

    def publish_journal(self, *, force: bool = False) -> None:
        """Give the open part of the service's journal to its reader, if it is long enough."""
        if self._journal is not None and (part := self._journal.take(self._bus.t_ns, force=force)) is not None:
            self._bus.publish_journal(self._journal_topic, part)

    # -- deliveries of the bus --

    def receive(self, name: str, data: bytes) -> None:
        if self.alive and name in self.subscribed:
            self.node.inbox.wall_ns = self._bus.t_ns
            self.wants_step |= self.node.deliver(name, data)

    def hear(self, t_ns: int, name: str, data: bytes) -> None:
        if self.alive:
            self.node.inbox.sent.append(SentMessage(t_ns, name, data))

    def receive_request(self, name: str, request_id: int, client_id: str, data: bytes) -> None:
        if self.alive:
            self.node.inbox.wall_ns = self._bus.t_ns
            self.wants_step |= self.node.deliver_request(name, request_id, client_id, data, {})

    def receive_bytes(self, link: str, data: bytes) -> None:
        if self.alive:
            self.wants_step |= self.node.deliver_bytes(link, data)

    # -- Transport --

    def publish(self, topic: Topic[Any], data: bytes) -> None:
        self._bus.publish(self.name, topic, data)

    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None:
        self._bus.reply(self.name, request_id, data, final=final)

    def call(self, endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None:
        self._bus.call(self, endpoint, data, call_id, timeout_s)

    def send(self, link: str, data: bytes) -> None:
        self._bus.send(self.name, link, data)

    def subscribe(self, names: frozenset[str]) -> None:
        self.subscribed = self._inputs | names
        self._bus.forget_subscribers()

    def set_rate(self, rate_hz: float) -> None:
        self._period_ns = int(NS_PER_S / rate_hz)

    def set_pace(self, pace: float) -> None:
        raise RuntimeError("virtual time has no pace: whoever runs the bus lets it go on")

    def reconnect(self, link: str) -> None:
        self._bus.reconnect(self.name, link)

    def run_task(self, function: Callable[[], Any], tag: str) -> None:
        self._tasks_end_ns = max(self._tasks_end_ns, self._bus.t_ns) + int(BACKGROUND_TASK_S * NS_PER_S)
        self._tasks[tag] = pickled(function)
        self._bus.at(self._tasks_end_ns, "", partial(self._finish_task, tag))

    def cancel_task(self, tag: str) -> None:
        if self._tasks.pop(tag, None) is not None:
            self._bus.at(self._bus.t_ns, "", partial(self._deliver, tag, CANCELED))

    def _finish_task(self, tag: str) -> None:
        task = self._tasks.pop(tag, None)
        if task is not None:
            self._deliver(tag, task if isinstance(task, TaskOutcome) else read_outcome(execute(task)))

    def _deliver(self, tag: str, outcome: TaskOutcome) -> None:
        if self.alive:
            self.wants_step |= self.node.deliver_outcome(tag, outcome)


def _ignoring_data(end: Callable[[], None], data: bytes) -> None:
    end()


@dataclass(slots=True)
class _Path:
    """The way from one service or client to another.

    Attributes:
        rng: generator of its delays.
        arrived_ns: arrival of the last message, which the next one may not overtake.
    """

    rng: Random
    arrived_ns: int = 0


@dataclass(frozen=True)
class _Wire:
    """One direction of two connected links."""

    peer: tuple[str, str]
    delay: LinkDelay
    path: _Path


@dataclass(frozen=True)
class _PendingRequest:
    """A request at one server.

    Attributes:
        client_id: sender of the request.
        server: name of the service that has not ended it yet.
        on_reply: receives each reply.
        on_end: called when there will be no more replies of this server.
    """

    client_id: str
    server: str
    on_reply: Callable[[bytes], None]
    on_end: Callable[[], None]
