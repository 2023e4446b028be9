"""The bus in one process and virtual time: the same services and bytes, deterministic, without sleeping.

Events are carried out in the order (t_ns, topic, sequence). All that arrives at one instant is in a service's inbox
before it steps. Each link delays its messages by a seeded distribution and keeps their order, as a connection does.
"""

import heapq
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from math import exp
from random import Random
from typing import Any

from jezero.codec import decode, encode
from jezero.runtime.node import Node
from jezero.runtime.service import Service
from jezero.schemas.struct import Payload
from jezero.schemas.topics import Endpoint, Topic, health_of
from jezero.schemas.units import NS_PER_S

Observer = Callable[[int, str, bytes], None]
Tamper = Callable[[str, str, str, int, bytes], Iterable[tuple[int, bytes]]]
"""(sender, receiver, name, t_ns of arrival, data) to what arrives instead, and when.

`name` is a topic's, an endpoint's, or that of the receiver's link. Replies, and the end of a question, which has no
data, are called REPLY.
"""
REPLY = "@reply"


@dataclass(frozen=True)
class LinkDelay:
    """Log-normal delay of a link, measured on the real bus by `benchmarks/speed/link_delay.py`.

    Attributes:
        median_s: half of the messages take less.
        sigma: standard deviation of the logarithm; 0 makes every message take `median_s`.
        longest_s: nothing takes longer.
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
WORK_S = 0.2
"""Work takes so long, whatever it is: flights must not depend on how fast this machine is."""


@dataclass
class Answers:
    """What came back to a client's question so far."""

    replies: list[Any] = field(default_factory=list)
    ended: bool = False


class MemoryBus:
    """Runs services in virtual time, which starts at 0.

    Args:
        seed: of every link's delays.
        delay: of all topics and questions.
        strict: services that publish what is not finite raise.

    Attributes:
        tamper: changes what is sent from now on, to simulate faults; None, the default, changes nothing.
    """

    def __init__(self, seed: int = 0, delay: LinkDelay = BUS_DELAY, *, strict: bool = True) -> None:
        self.t_ns = 0
        self.tamper: Tamper | None = None
        self._seed = seed
        self._delay = delay
        self._strict = strict
        self._heap: list[tuple[int, str, int, Callable[[], None]]] = []
        self._sequence = 0
        self._ports: dict[str, _Port] = {}
        self._order: list[_Port] = []
        self._listeners: dict[str, list[_Port]] = {}
        """By topic, as far as they were looked for since the last change."""
        self._wires: dict[tuple[str, str], _Wire] = {}
        self._paths: dict[tuple[str, str], _Path] = {}
        self._requests: dict[int, _Question] = {}
        self._observers: list[Observer] = []

    # -- building --

    def add(self, service: Service) -> None:
        """Start a service; it steps first at the present time."""
        name = service.spec.name
        if name in self._ports:
            raise ValueError(f"a service named {name!r} runs already")
        port = _Port(self, service)
        self._ports[name] = port
        self._order.append(port)
        self._listeners.clear()
        for (owner, link), wire in self._wires.items():
            if owner == name or wire.peer[0] == name:
                self._set_link(owner, link, up=owner in self._ports and wire.peer[0] in self._ports)
        port.schedule_tick(self.t_ns)

    def remove(self, name: str) -> None:
        """Let a service die at once: its links go down and its open requests end without a reply."""
        port = self._ports.pop(name)
        self._order.remove(port)
        self._listeners.clear()
        port.alive = False
        for (owner, link), wire in self._wires.items():
            if wire.peer[0] == name:
                self._set_link(owner, link, up=False)
        for request_id, question in [(i, q) for i, q in self._requests.items() if q.server == name]:
            del self._requests[request_id]
            self._later(question.asker, name, b"", partial(_ignoring_data, question.end))

    def freeze(self, name: str, seconds: float) -> None:
        """Let a service stand still for a while, as a stopped process does; what arrives waits for it."""
        port = self._ports[name]
        port.frozen_until_ns = self.t_ns + int(seconds * NS_PER_S)
        self.at(port.frozen_until_ns, "", port.wake)

    def has(self, name: str) -> bool:
        """Whether a service of this name is there, be it frozen."""
        return name in self._ports

    def runs(self, name: str) -> bool:
        """Whether a service of this name is there and not frozen."""
        port = self._ports.get(name)
        return port is not None and port.frozen_until_ns <= self.t_ns

    def wire(self, a: tuple[str, str], b: tuple[str, str], delay: LinkDelay = NO_DELAY) -> None:
        """Join two services' links, each named (service, link)."""
        self._wires[a] = _Wire(b, delay, self._path(".".join(a), ".".join(b)))
        self._wires[b] = _Wire(a, delay, self._path(".".join(b), ".".join(a)))
        if a[0] in self._ports and b[0] in self._ports:
            self._set_link(*a, up=True)
            self._set_link(*b, up=True)

    def observe(self, observer: Observer) -> None:
        """Call `observer(t_ns, topic, data)` for every published message, when it is sent."""
        self._observers.append(observer)

    # -- running --

    def run_until(self, t_ns: int, stop: Callable[[], bool] | None = None) -> bool:
        """Carry out events up to and including `t_ns`; returns early with True when `stop()` holds."""
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
        """`run_until` for a span of virtual time."""
        return self.run_until(self.t_ns + int(seconds * NS_PER_S), stop)

    def ask(self, endpoint: Endpoint[Any, Any], payload: Payload, client_id: str = "client") -> Answers:
        """Put a question as an outside client would; run the bus to see its replies come in."""
        answers = Answers()

        def on_reply(data: bytes) -> None:
            answers.replies.append(decode(endpoint.reply_type, data))

        def on_end() -> None:
            answers.ended = True

        self._ask(client_id, endpoint, encode(payload), on_reply, on_end)
        return answers

    def client_departs(self, client_id: str) -> None:
        """Tell the services that watch clients that one has vanished."""
        for port in self._order:
            if port.node.spec.watches_clients:
                port.node.inbox.departed_clients.append(client_id)
                self.at(self.t_ns, "", port.wake)

    # -- what ports use --

    def at(self, t_ns: int, name: str, action: Callable[[], None]) -> None:
        self._sequence += 1
        heapq.heappush(self._heap, (t_ns, name, self._sequence, action))

    def publish(self, sender: str, topic: Topic[Any], data: bytes) -> None:
        for observer in self._observers:
            observer(self.t_ns, topic.name, data)
        listeners = self._listeners.get(topic.name)
        if listeners is None:
            listeners = self._listeners[topic.name] = [port for port in self._order if topic.name in port.listening]
        for port in listeners:
            t_ns = self._arrival(self._path(sender, port.name), self._delay)
            self._deliver(sender, port.name, topic.name, t_ns, data, partial(port.receive, topic.name))

    def send(self, owner: str, link: str, data: bytes) -> None:
        wire = self._wires.get((owner, link))
        if wire is None:
            return
        peer, peer_link = wire.peer
        port = self._ports.get(peer)
        if port is not None:
            t_ns = self._arrival(wire.path, wire.delay)
            self._deliver(owner, peer, peer_link, t_ns, data, partial(port.receive_bytes, peer_link))

    def call(self, caller: "_Port", endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None:
        answered = [False]

        def finish(reply: bytes | None, error: str | None) -> None:
            if not answered[0] and caller.alive:
                answered[0] = True
                caller.wants_step |= caller.node.deliver_response(call_id, reply, error)

        self._ask(
            caller.name,
            endpoint,
            data,
            lambda reply: finish(reply, None),
            lambda: finish(None, "no server"),
        )
        self.at(self.t_ns + int(timeout_s * NS_PER_S), endpoint.name, lambda: finish(None, "timeout"))

    def reply(self, server: str, request_id: int, data: bytes | None, *, final: bool) -> None:
        question = self._requests.get(request_id)
        if question is None:
            return
        if data is not None:
            self._later(question.asker, server, data, question.on_reply)
        if final:
            del self._requests[request_id]
            self._later(question.asker, server, b"", partial(_ignoring_data, question.end))

    # -- inside --

    def _ask(
        self,
        asker: str,
        endpoint: Endpoint[Any, Any],
        data: bytes,
        on_reply: Callable[[bytes], None],
        on_end: Callable[[], None],
    ) -> None:
        servers = [port for port in self._order if endpoint.name in port.serving]
        if not servers:
            self._later(asker, "", b"", partial(_ignoring_data, on_end))
            return
        waiting = [len(servers)]

        def end() -> None:
            waiting[0] -= 1
            if waiting[0] == 0:
                on_end()

        for port in servers:
            self._sequence += 1
            request_id = self._sequence
            self._requests[request_id] = _Question(asker, port.name, on_reply, end)
            t_ns = self._arrival(self._path(asker, port.name), self._delay)
            ask = partial(port.receive_request, endpoint.name, request_id, asker)
            self._deliver(asker, port.name, endpoint.name, t_ns, data, ask)

    def _later(self, receiver: str, sender: str, data: bytes, receive: Callable[[bytes], None]) -> None:
        t_ns = self._arrival(self._path(sender, receiver), self._delay)
        self._deliver(sender, receiver, REPLY, t_ns, data, receive)

    def _deliver(
        self, sender: str, receiver: str, name: str, t_ns: int, data: bytes, receive: Callable[[bytes], None]
    ) -> None:
        """Everything that travels from one service or client to another passes here."""
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


def _ignoring_data(end: Callable[[], None], data: bytes) -> None:
    end()


@dataclass(slots=True)
class _Path:
    """What travels from one to another; `arrived_ns` is when the last of it arrives."""

    rng: Random
    arrived_ns: int = 0


@dataclass(frozen=True)
class _Wire:
    peer: tuple[str, str]
    delay: LinkDelay
    path: _Path


@dataclass(frozen=True)
class _Question:
    asker: str
    server: str
    on_reply: Callable[[bytes], None]
    end: Callable[[], None]


class _Port:
    """A service on the memory bus; the `Transport` of its node."""

    def __init__(self, bus: MemoryBus, service: Service) -> None:
        self.name = service.spec.name
        self.alive = True
        self.wants_step = False
        self.frozen_until_ns = 0
        self._bus = bus
        self.node = Node(service, self, strict=bus._strict, boot_id=0)
        spec = self.node.spec
        self.listening = frozenset(topic.name for topic in spec.inputs)
        self.serving = frozenset(endpoint.name for endpoint in spec.serves)
        self._always = self.listening
        self._period_ns = int(NS_PER_S / spec.rate_hz)
        self._tick_at = 0
        self._alarm_at: int | None = None
        self._work_ends_ns = 0
        self._health_at = bus.t_ns + NS_PER_S
        self._health_topic = health_of(self.name)

    def schedule_tick(self, t_ns: int) -> None:
        """Step at that time; each step puts it off. The alarm that is set already comes first and is set anew then."""
        self._tick_at = t_ns
        if self._alarm_at is None or self._alarm_at > t_ns:
            self._alarm_at = t_ns
            self._bus.at(t_ns, "", partial(self._alarm, t_ns))

    def _alarm(self, t_ns: int) -> None:
        if not self.alive or t_ns != self._alarm_at:
            return
        self._alarm_at = None
        if t_ns < self._tick_at:
            self.schedule_tick(self._tick_at)
        else:
            self.wants_step = True

    def wake(self) -> None:
        self.wants_step = True

    def step(self) -> None:
        bus = self._bus
        self.wants_step = False
        self.node.inbox.wall_ns = bus.t_ns
        self.node.step(bus.t_ns)
        if self.alive:
            self.schedule_tick(bus.t_ns + self._period_ns)
        if bus.t_ns >= self._health_at:
            self._health_at += NS_PER_S
            bus.publish(self.name, self._health_topic, encode(self.node.health(bus.t_ns, 0.0)))

    def receive(self, name: str, data: bytes) -> None:
        if self.alive and name in self.listening:
            self.node.inbox.wall_ns = self._bus.t_ns
            self.wants_step |= self.node.deliver(name, data)

    def receive_request(self, name: str, request_id: int, client: str, data: bytes) -> None:
        if self.alive:
            self.node.inbox.wall_ns = self._bus.t_ns
            self.wants_step |= self.node.deliver_request(name, request_id, client, data, {})

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

    def listen(self, names: frozenset[str]) -> None:
        self.listening = self._always | names
        self._bus._listeners.clear()

    def pace(self, rate_hz: float) -> None:
        self._period_ns = int(NS_PER_S / rate_hz)

    def work(self, function: Callable[[], Any], tag: str) -> None:
        self._work_ends_ns = max(self._work_ends_ns, self._bus.t_ns) + int(WORK_S * NS_PER_S)
        self._bus.at(self._work_ends_ns, "", partial(self._finish_work, function, tag))

    def _finish_work(self, function: Callable[[], Any], tag: str) -> None:
        if self.alive:
            self.wants_step |= self.node.deliver_outcome(tag, function())
