"""One running service: its inbox, the check of its declaration, its journal and its health; the same on both buses.

A bus delivers what arrives to the `Node`, which decodes it into the `Mailbox`. It steps the service when the bus says
so, checks what the service yields against its `Spec`, and hands it, encoded, to the bus' `Transport`.
"""

import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from msgspec import Raw

from jezero.base.codec import (
    BadPayloadError,
    NotFiniteError,
    decode,
    decode_request,
    encode,
    finite_readings,
    has_attachment,
    reader,
)
from jezero.base.plain_text import plain
from jezero.runtime.journal import NULL, Journal, content_of
from jezero.runtime.service import (
    BackgroundTask,
    Call,
    CancelTask,
    Health,
    Output,
    Publish,
    Reconnect,
    Reply,
    Request,
    Response,
    Send,
    SentMessage,
    Service,
    SetPace,
    SetRate,
    Subscribe,
    UndeclaredError,
)
from jezero.runtime.task import TaskOutcome
from jezero.schemas import journal as entries
from jezero.schemas.health import InputHealth, ServiceHealth, ServiceState
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.struct import TEXT_MAX, Payload, WithReadings
from jezero.schemas.units import NS_PER_S

LINK_BYTES_MAX = 4_000_000
"""Bytes of a link that wait for the next step; later ones are dropped, so that no peer can fill the memory."""
HEALTH_PERIOD_MIN_NS = 100_000_000
"""Period of health while its state changes in each step."""
FAILED_STEPS_MAX = 50
"""Steps in a row that may fail before the service ends, to be started anew: one message fails one step, and what the
service has kept of it may fail many."""


class Transport(Protocol):
    """A bus as a node uses it. All payloads are encoded; data of None replies nothing."""

    def publish(self, topic: Topic[Any], data: bytes) -> None: ...
    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None: ...
    def call(self, endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None: ...
    def send(self, link: str, data: bytes) -> None: ...
    def subscribe(self, names: frozenset[str]) -> None: ...
    def set_rate(self, rate_hz: float) -> None: ...
    def set_pace(self, pace: float) -> None: ...
    def reconnect(self, link: str) -> None: ...
    def run_task(self, function: Callable[[], Any], tag: str) -> None: ...
    def cancel_task(self, tag: str) -> None: ...


class SilentTransport:
    """A transport on which nothing goes out: the base of those that only look at some of a service's outputs."""

    def publish(self, topic: Topic[Any], data: bytes) -> None: ...
    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None: ...
    def call(self, endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None: ...
    def send(self, link: str, data: bytes) -> None: ...
    def subscribe(self, names: frozenset[str]) -> None: ...
    def set_rate(self, rate_hz: float) -> None: ...
    def set_pace(self, pace: float) -> None: ...
    def reconnect(self, link: str) -> None: ...
    def run_task(self, function: Callable[[], Any], tag: str) -> None: ...
    def cancel_task(self, tag: str) -> None: ...


class Node:
    """Runs a service on a transport.

    Args:
        service: the service to run.
        transport: the bus's side for this service.
        strict: whether a number that is not finite, and a step that fails, raises; otherwise it is counted and not
            sent, or the service goes on with its next step.
        boot_id: differs between two runs of the same service; part of its health.
        process: host and process id, for people.
        journal: gets all inputs and outputs of the service; None keeps none.
    """

    def __init__(
        self,
        service: Service,
        transport: Transport,
        *,
        strict: bool,
        boot_id: int,
        process: str = "",
        journal: Journal | None = None,
    ) -> None:
        self.service = service
        self.spec = service.spec
        self.inbox = Mailbox(self.spec.links)
        self._transport = transport if journal is None else _JournaledTransport(transport, journal)
        self._journal = journal
        self._strict = strict
        self._boot_id = boot_id
        self._process = process
        self._outputs = {topic.name: topic for topic in self.spec.outputs}
        self._serves = {endpoint.name: endpoint for endpoint in self.spec.serves}
        self._calls = {endpoint.name: endpoint for endpoint in self.spec.calls}
        self._demandable = frozenset(topic.name for topic in self.spec.on_demand)
        self._triggers = frozenset(self.spec.triggers)
        kinds = {topic.name: topic.type for topic in (*self.spec.inputs, *self.spec.on_demand)}
        kinds |= {endpoint.name: endpoint.request_type for endpoint in self.spec.serves}
        self._inputs = {name: _Input(kind, triggers=name in self._triggers) for name, kind in kinds.items()}
        self._pending_calls: dict[str, Call] = {}
        self._call_number = 0
        self._not_sent = 0
        self._last_error = ""
        self._failed_steps = self._failed_in_row = 0
        self._has_failed = False
        """Whether a step has failed since the last report of health."""
        self._printed_failure = ""
        self._health_ns: int | None = None
        self._reported_state: ServiceState | None = None
        self._state: ServiceState = "ok"
        self._room_bytes: int | None = None
        self._text = (
            f"listening; vehicle time starts when link {self.spec.lockstep!r} connects"
            if self.spec.lockstep
            else "running"
        )

    # -- deliveries of the bus; each returns whether it triggers a step --

    def deliver(self, name: str, data: bytes) -> bool:
        """Put a topic's message into the inbox if the service reads this topic.

        Args:
            name: the topic's.
            data: the message.
        """
        source = self._inputs.get(name)
        if source is None:
            return False
        source.received += 1
        try:
            message = source.reader.read(data)
        except BadPayloadError as error:
            source.rejected += 1
            self._last_error = f"{name}: {error}"[:500]
            return False
        if dropped := source.reader.dropped(data):
            source.dropped += len(dropped)
            self._last_error = f"{name}: {dropped[0]}"[:500]
        source.last_ns = self.inbox.wall_ns
        if self._journal is not None:
            self._journal.received(name, data, attached=source.attached)
        self.inbox.add_message(name, message)
        return source.triggers

    def deliver_request(
        self, name: str, request_id: int, client_id: str, data: bytes, parameters: Mapping[str, str]
    ) -> bool:
        """Put a request into the inbox; a malformed one is refused here with the reason."""
        source, endpoint = self._inputs[name], self._serves[name]
        source.received += 1
        try:
            payload = decode_request(source.kind, data, parameters, needs_field=endpoint.needs_field)
        except BadPayloadError as error:
            source.rejected += 1
            self._last_error = f"{name}: {error}"[:500]
            refusal = endpoint.refuse(plain(str(error)[:1000]))
            if self._journal is not None:
                text = data.decode("utf-8", "replace")
                self._journal.add(entries.Refused(name, client_id, text, str(error)), len(data))
            self._transport.reply(request_id, encode(refusal), final=True)
            return False
        source.last_ns = self.inbox.wall_ns
        if self._journal is not None:
            content = Raw(data) if data else NULL
            self._journal.add(entries.Requested(name, request_id, client_id, content, dict(parameters)), len(data))
        self.inbox.add_request(name, Request(request_id, client_id, payload))
        return source.triggers

    def deliver_response(self, call_id: str, data: bytes | None, error: str | None) -> bool:
        """Put a reply to a call into the inbox, or the error that ends it; what comes after its end is ignored.

        A call ends with an error or a wrong reply, and with its first reply unless it is streamed.
        """
        call = self._pending_calls.pop(call_id, None)
        if call is None:
            return False
        payload = None
        if data is not None:
            try:
                payload = decode(call.endpoint.reply_type, data)
            except BadPayloadError as bad:
                endpoint = call.endpoint
                error, data = f"{endpoint.server} sent a wrong reply on {endpoint.name}: {bad}", None
        if call.streamed and data is not None:
            self._pending_calls[call_id] = call
        if self._journal is not None:
            self._journal.add(entries.Answered(call_id, NULL if data is None else Raw(data), error))
        self.inbox.responses.append(Response(call.tag, payload, error))
        return True

    def deliver_outcome(self, tag: str, outcome: TaskOutcome) -> bool:
        """Put a background task's outcome into the inbox."""
        if self._journal is not None:
            self._journal.add(entries.TaskEnded(tag, outcome.error))
        self.inbox.responses.append(Response(tag, outcome.value, outcome.error))
        return True

    def deliver_bytes(self, link: str, data: bytes) -> bool:
        """Put a link's bytes into the inbox."""
        if self._journal is not None:
            self._journal.add(entries.LinkBytes(link, data), len(data))
        if link in self.spec.picture_links:
            self.inbox.replace_bytes(link, data)
        else:
            self.inbox.add_bytes(link, data)
        return link in self._triggers

    def set_link(self, link: str, up: bool) -> bool:
        """Set whether a link is connected."""
        if self._journal is not None:
            self._journal.add(entries.LinkState(link, up))
        self.inbox.set_link(link, up)
        return link in self._triggers

    def deliver_departure(self, name: str) -> bool:
        """Put the id of a client, or the name of a service, that has vanished into the inbox."""
        if self._journal is not None:
            self._journal.add(entries.Departed(name))
        self.inbox.departed.append(name)
        return True

    # -- the step --

    def step(self, t_ns: int) -> None:
        """Step the service once and execute its outputs.

        A step that fails is left where it failed, and its inbox is cleared: no message may end a service, or fail it
        again after a restart.

        Raises:
            UndeclaredError: the service used a topic, endpoint or link that its `Spec` doesn't name.
            NotFiniteError: a number is not finite, and the node is strict.
            Exception: the step failed, and the node is strict or `FAILED_STEPS_MAX` steps before it failed too.
        """
        inbox = self.inbox
        if self._journal is not None:
            self._journal.step(t_ns, inbox.wall_ns, connected=inbox.connected, stalled_ns=inbox.stalled_ns)
        try:
            self._step(t_ns)
        except UndeclaredError:
            raise
        except Exception as error:  # noqa: BLE001 - nothing that a message may cause ends the service
            self._on_failed_step(error)
        else:
            self._failed_in_row = 0
        inbox.clear()

    def _step(self, t_ns: int) -> None:
        inbox = self.inbox
        for output in self.service.step(t_ns, inbox):
            if type(output) is Publish:
                self._publish(output)
            elif type(output) is Send:
                if output.link not in self.inbox._up:
                    self._require(False, "link", output.link)
                self._transport.send(output.link, output.data)
            else:
                self._execute(output)

    def _on_failed_step(self, error: Exception) -> None:
        """Count it and print its traceback, of equal ones in a row only the first; or raise it again."""
        if self._strict or self._failed_in_row >= FAILED_STEPS_MAX:
            raise error
        self._failed_steps += 1
        self._failed_in_row += 1
        self._has_failed = True
        failure = plain(f"{type(error).__name__}: {error}"[:400])
        self._last_error = f"step failed: {failure}"
        if failure != self._printed_failure:
            self._printed_failure = failure
            traceback.print_exception(error)

    def _execute(self, output: Output) -> None:
        """Execute one of the rarer outputs; not for all, as each pattern that doesn't match costs 0.5 us."""
        match output:
            case Reply():
                data = None if output.payload is None else self._encoded(output.payload)
                self._transport.reply(output.request_id, data, final=output.final)
            case Call():
                self._call(output)
            case Subscribe():
                self._subscribe(output)
            case SetRate():
                self._transport.set_rate(output.rate_hz or self.spec.rate_hz)
            case SetPace():
                self._require(self.spec.lockstep is not None, "lockstep", "pace")
                self._transport.set_pace(output.pace)
            case Reconnect():
                self._require(output.link in self.inbox._up, "link", output.link)
                self._transport.reconnect(output.link)
            case BackgroundTask():
                self._transport.run_task(output.function, output.tag)
            case CancelTask():
                self._transport.cancel_task(output.tag)
            case Health():
                self._state, self._text, self._room_bytes = output.state, output.text[:TEXT_MAX], output.room_bytes

    def _publish(self, output: Publish) -> None:
        topic, message = output.topic, output.message
        if topic.name not in self._outputs:
            self._require(False, "output", topic.name)
        if type(message) is not topic.struct:
            raise TypeError(f"{topic.name} carries {topic.struct.__name__}, not {type(message).__name__}")
        data = self._encoded(message)
        if data is None and isinstance(message, WithReadings):
            data = self._encoded(finite_readings(message))
        if data is not None:
            self._transport.publish(topic, data)

    def _call(self, output: Call) -> None:
        self._require(output.endpoint.name in self._calls, "call", output.endpoint.name)
        data = self._encoded(output.payload)
        if data is not None:
            self._call_number += 1
            call_id = f"{output.tag}#{self._call_number}"
            self._pending_calls[call_id] = output
            self._transport.call(output.endpoint, data, call_id, output.timeout_s)

    def _subscribe(self, output: Subscribe) -> None:
        names = frozenset(topic.name for topic in output.topics)
        for name in sorted(names - self._demandable):
            self._require(False, "on_demand", name)
        for name in self._demandable - names:
            self.inbox.forget(name)
        self._transport.subscribe(names)

    def _encoded(self, payload: Payload) -> bytes | None:
        try:
            return encode(payload)
        except NotFiniteError as error:
            self._drop(error)
            return None

    def _drop(self, error: NotFiniteError) -> None:
        if self._strict:
            raise error
        self._not_sent += 1
        self._last_error = f"not sent: {error}"[:500]

    def _require(self, declared: bool, part: str, name: str) -> None:
        if not declared:
            raise UndeclaredError(f"service {self.spec.name!r} uses {part} {name!r}, which its Spec doesn't declare")

    # -- health --

    def health_due_ns(self, now_ns: int) -> int:
        """Time of the next report: once a second, and at once when the state has changed.

        With reports once a second only, the vehicle would be ready before its bridge says that it is well.
        """
        if self._health_ns is None:
            return now_ns
        return self._health_ns + (NS_PER_S if self._state == self._reported_state else HEALTH_PERIOD_MIN_NS)

    def health(self, t_ns: int, late_s: float, now_ns: int) -> ServiceHealth:
        """Report of the service, which the runtime publishes when `health_due_ns` says so.

        Args:
            t_ns: vehicle time.
            late_s: greatest lateness of a step since the last report.
            now_ns: time, on the clock of `health_due_ns`.
        """
        self._health_ns = now_ns
        wall_ns = self.inbox.wall_ns
        self._reported_state = self._state
        state, text = self._state, self._text
        if self._failed_steps:
            text = f"{text}; {self._failed_steps} steps failed, its log has the traceback"[-TEXT_MAX:]
            state = "degraded" if self._has_failed and state == "ok" else state
            self._has_failed = False
        return ServiceHealth(
            t_ns=t_ns,
            service=self.spec.name,
            boot_id=self._boot_id,
            process=self._process,
            state=state,
            text=text,
            inputs={
                name: InputHealth(
                    received=source.received,
                    rejected=source.rejected,
                    dropped=source.dropped,
                    age_s=None if source.last_ns is None else max(0, wall_ns - source.last_ns) / 1e9,
                )
                for name, source in self._inputs.items()
            },
            not_sent=self._not_sent,
            failed_steps=self._failed_steps,
            last_error=self._last_error,
            room_bytes=self._room_bytes,
            late_s=max(0.0, late_s),
        )


class Mailbox:
    """The `Inbox` of a service, which its node fills."""

    def __init__(self, declared_links: Sequence[str]) -> None:
        self.wall_ns = 0
        self.stalled_ns = 0
        self.connected = True
        self.departed: list[str] = []
        self.responses: list[Response] = []
        self.sent: list[SentMessage] = []
        self._new: dict[str, list[Any]] = {}
        self._latest: dict[str, Any] = {}
        self._requests: dict[str, list[Request]] = {}
        self._bytes: dict[str, list[bytes]] = {link: [] for link in declared_links}
        self._sizes = dict.fromkeys(declared_links, 0)
        self._connections = dict.fromkeys(declared_links, 0)
        self._up = dict.fromkeys(declared_links, False)

    def new(self, topic: Topic[Any]) -> Sequence[Any]:
        return self._new.get(topic.name, ())

    def latest(self, topic: Topic[Any]) -> Any | None:
        return self._latest.get(topic.name)

    @property
    def has_requests(self) -> bool:
        return bool(self._requests)

    def requests(self, endpoint: Endpoint[Any, Any]) -> Sequence[Request]:
        return self._requests.get(endpoint.name, ())

    def received(self, link: str) -> bytes:
        parts = self._bytes[link]
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def connections(self, link: str) -> int:
        return self._connections[link]

    def is_up(self, link: str) -> bool:
        return self._up[link]

    def clear(self) -> None:
        """Remove everything that the last step has read; latest values and link states stay."""
        self._new.clear()
        if self.departed:
            self.departed.clear()
        if self.responses:
            self.responses.clear()
        if self._requests:
            self._requests.clear()
        if self.sent:
            self.sent.clear()
        for link, parts in self._bytes.items():
            if parts:
                parts.clear()
                self._sizes[link] = 0

    def add_message(self, name: str, message: Any) -> None:
        self._latest[name] = message
        if name in self._new:
            self._new[name].append(message)
        else:
            self._new[name] = [message]

    def forget(self, name: str) -> None:
        self._new.pop(name, None)
        self._latest.pop(name, None)

    def add_request(self, name: str, request: Request) -> None:
        self._requests.setdefault(name, []).append(request)

    def add_bytes(self, link: str, data: bytes) -> None:
        size = self._sizes[link] + len(data)
        if size <= LINK_BYTES_MAX:
            self._sizes[link] = size
            self._bytes[link].append(data)

    def replace_bytes(self, link: str, data: bytes) -> None:
        self._bytes[link] = [data]

    def set_link(self, link: str, up: bool) -> None:
        if up and not self._up[link]:
            self._connections[link] += 1
        if not up:
            self._bytes[link].clear()
            self._sizes[link] = 0
        self._up[link] = up


class _Input:
    """A topic or endpoint of a node's inputs.

    Attributes:
        kind: type of its decoded messages.
        reader: decodes a message.
        attached: whether its messages have attachments.
        triggers: whether a message triggers a step.
        received: number of messages so far.
        rejected: number of invalid ones among them.
        dropped: number of bad readings that were left out of valid ones.
        last_ns: wall time of the last valid message; None before the first.
    """

    __slots__ = ("attached", "dropped", "kind", "last_ns", "reader", "received", "rejected", "triggers")

    def __init__(self, kind: Any, *, triggers: bool) -> None:
        self.kind = kind
        self.reader = reader(kind)
        self.attached = has_attachment(kind)
        self.triggers = triggers
        self.received = 0
        self.rejected = 0
        self.dropped = 0
        self.last_ns: int | None = None


class _JournaledTransport:
    """Hands a service's outputs on to another transport, and writes them into its journal.

    Messages are sent first, as their receivers wait for them.
    """

    def __init__(self, transport: Transport, journal: Journal) -> None:
        self._transport = transport
        self._journal = journal

    def publish(self, topic: Topic[Any], data: bytes) -> None:
        self._transport.publish(topic, data)
        message, checksum = content_of(data)
        self._journal.add(entries.Published(topic.name, message, checksum), len(message))

    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None:
        self._transport.reply(request_id, data, final=final)
        message, checksum = (NULL, None) if data is None else content_of(data)
        self._journal.add(entries.Replied(request_id, message, final, checksum), len(message))

    def call(self, endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None:
        self._transport.call(endpoint, data, call_id, timeout_s)
        self._journal.add(entries.Called(endpoint.name, call_id, Raw(data)), len(data))

    def send(self, link: str, data: bytes) -> None:
        self._transport.send(link, data)
        self._journal.add(entries.Sent(link, data), len(data))

    def subscribe(self, names: frozenset[str]) -> None:
        self._journal.add(entries.Changed("subscriptions", " ".join(sorted(names))))
        self._transport.subscribe(names)

    def set_rate(self, rate_hz: float) -> None:
        self._journal.add(entries.Changed("rate_hz", repr(rate_hz)))
        self._transport.set_rate(rate_hz)

    def set_pace(self, pace: float) -> None:
        self._journal.add(entries.Changed("pace", repr(pace)))
        self._transport.set_pace(pace)

    def reconnect(self, link: str) -> None:
        self._journal.add(entries.Changed("reconnected", link))
        self._transport.reconnect(link)

    def run_task(self, function: Callable[[], Any], tag: str) -> None:
        self._journal.add(entries.Changed("task started", tag))
        self._transport.run_task(function, tag)

    def cancel_task(self, tag: str) -> None:
        self._journal.add(entries.Changed("task canceled", tag))
        self._transport.cancel_task(tag)
