"""One service on the in-memory bus."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from jezero.codec import encode
from jezero.runtime.epoch_filter import EpochFilter
from jezero.runtime.journal import Journal
from jezero.runtime.node import Node
from jezero.runtime.service import SentMessage, Service
from jezero.runtime.task import CANCELED, Outcome, execute, pickled, read_outcome
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.topics import CLOCK, health_of, journal_of
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    from jezero.runtime.memory_bus import MemoryBus

BACKGROUND_TASK_S = 0.2
"""Duration of every background task, which is executed in this process: flights must not depend on how fast this
machine is."""


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

    def __init__(self, bus: "MemoryBus", service: Service, *, strict: bool, journaled: bool = False) -> None:
        self.name = service.spec.name
        self.alive = True
        self.wants_step = False
        self.frozen_until_ns = 0
        self._bus = bus
        spec = service.spec
        keeps_journal = journaled and not spec.hears_all
        self._journal = Journal(spec.name, 0, spec.made_with) if keeps_journal else None
        self._epochs = EpochFilter()
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
        self._tasks: dict[str, bytes | Outcome] = {}
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
            bus.publish(self.name, self._health_topic, encode(self.node.health(bus.t_ns, 0.0)))
        self.publish_journal()

    def publish_journal(self, *, force: bool = False) -> None:
        """Give the open part of the service's journal to its reader, if it is long enough."""
        if self._journal is not None and (part := self._journal.take(self._bus.t_ns, force=force)) is not None:
            self._bus.publish_journal(self._journal_topic, part)

    # -- deliveries of the bus --

    def receive(self, name: str, data: bytes) -> None:
        if self.alive and name in self.subscribed:
            wall_ns = self.node.inbox.wall_ns = self._bus.t_ns
            if name == CLOCK.name and (refusal := self._epochs.refusal(data, wall_ns)):
                self.node.deliver(name, None, refusal)
                return
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
            self._deliver(tag, task if isinstance(task, Outcome) else read_outcome(execute(task)))

    def _deliver(self, tag: str, outcome: Outcome) -> None:
        if self.alive:
            self.wants_step |= self.node.deliver_outcome(tag, outcome)
