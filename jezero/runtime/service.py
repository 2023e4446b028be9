"""The interface of a service: a declaration and a step.

A service owns no thread, socket, timer or clock. It declares its inputs and outputs in a `Spec`. The runtime gives it
an `Inbox` and the time, and executes the `Output`s that its step yields. The same class runs over Zenoh in real time
(`zenoh_bus`) and on the in-memory bus in virtual time (`memory_bus`).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, TypeVar

import msgspec

from jezero.schemas.health import ServiceState
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.struct import Message, Payload

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Payload)
R = TypeVar("R", bound=Payload)


@dataclass(frozen=True, kw_only=True)
class Spec:
    """Declaration of a service; to use anything else raises `UndeclaredError`.

    Attributes:
        name: unique within a vehicle; also part of its liveliness token and of the key of its health.
        inputs: topics to which it is always subscribed.
        on_demand: topics to which it is subscribed only while a `Subscribe` output names them.
        outputs: topics that it publishes.
        last_value: outputs whose latest message is also the reply to a plain get on the same key.
        serves: endpoints that it serves; a second process of the same service refuses to start.
        calls: endpoints to which it sends requests.
        links: names of its byte pipes; the process decides whether they are TCP, UDP or memory.
        picture_links: those of `links` that carry pictures: each delivery is one, and only the newest is kept for a
            step. A service with such a link keeps no journal, as that would be as large as the pictures.
        triggers: names of topics, endpoints and links whose arrival triggers a step.
        rate_hz: steps per second of vehicle time when no trigger arrives; `SetRate` changes it.
        lockstep: name of the link on which the time master awaits an answer after each step (at most 16 ms); vehicle
            time starts when this link first connects. None for every other service.
        pace: seconds of vehicle time in one of real time, of the time master in lockstep.
        watches: whose departures the inbox lists: those of clients, of services, or of nobody.
        hears_all: whether the inbox has every message that anybody publishes for the vehicle, as it was sent. Such
            messages trigger no step.
        made_with: arguments with which the service was made, by name: its settings, ids and seeds. They are recorded,
            so that `jezero replay` can make the service again.
    """

    name: str
    inputs: tuple[Topic[Any], ...] = ()
    on_demand: tuple[Topic[Any], ...] = ()
    outputs: tuple[Topic[Any], ...] = ()
    last_value: tuple[Topic[Any], ...] = ()
    serves: tuple[Endpoint[Any, Any], ...] = ()
    calls: tuple[Endpoint[Any, Any], ...] = ()
    links: tuple[str, ...] = ()
    picture_links: tuple[str, ...] = ()
    triggers: tuple[str, ...] = ()
    rate_hz: float = 10.0
    lockstep: str | None = None
    pace: float = 1.0
    watches: Literal["client", "service"] | None = None
    hears_all: bool = False
    made_with: Mapping[str, Any] = field(default_factory=dict)

    @property
    def keeps_journal(self) -> bool:
        """Whether its inputs and outputs are kept for a replay, where they are recorded."""
        return not self.hears_all and not self.picture_links


class UndeclaredError(RuntimeError):
    """A service used a topic, endpoint or link that its `Spec` doesn't declare."""


# -- outputs of a step -------------------------------------------------------------------------------------


class Publish(msgspec.Struct, frozen=True):
    """A message on a topic of `Spec.outputs`."""

    topic: Topic[Any]
    message: Message


class Reply(msgspec.Struct, frozen=True):
    """A reply to a request.

    Attributes:
        request_id: the request's.
        payload: content of the reply; None sends none, for endpoints shared by servers that each know a part.
        final: whether this reply ends the request; any number of others may precede it.
    """

    request_id: int
    payload: Payload | None
    final: bool = True


class Call(msgspec.Struct, frozen=True):
    """A request to an endpoint of `Spec.calls`.

    Attributes:
        endpoint: the endpoint.
        payload: content of the request.
        tag: that of the response.
        timeout_s: duration after which no more replies are awaited.
        streamed: whether every reply arrives as a `Response` of its own, and after the last one a `Response` with an
            error; otherwise the first reply, or the error that replaces it, is the only `Response`.
    """

    endpoint: Endpoint[Any, Any]
    payload: Payload
    tag: str
    timeout_s: float = 1.0
    streamed: bool = False


class Send(msgspec.Struct, frozen=True):
    """Bytes for a link of `Spec.links`; dropped when the link is down."""

    link: str
    data: bytes


class Subscribe(msgspec.Struct, frozen=True):
    """Subscribe to exactly these topics of `Spec.on_demand`; the latest values of the others are removed."""

    topics: tuple[Topic[Any], ...]


class SetRate(msgspec.Struct, frozen=True):
    """Change the rate of steps without a trigger; None restores the rate of the `Spec`."""

    rate_hz: float | None


class SetPace(msgspec.Struct, frozen=True):
    """Change how fast the time master in lockstep lets vehicle time go.

    Attributes:
        pace: seconds of vehicle time in one of real time. With 0 it stands still: the service is stepped at one and the
            same time, 50 times a second, until another `SetPace`.
    """

    pace: float


class Reconnect(msgspec.Struct, frozen=True):
    """Close the connection of a link of `Spec.links`; its other end connects again."""

    link: str


class BackgroundTask(msgspec.Struct, frozen=True):
    """A function that takes too long for a step; a process of its own executes it while the service goes on stepping.

    Tasks are executed one at a time, in the order in which they were yielded.

    Attributes:
        function: pure, and a function of a module or a `partial` of one, because it is pickled; so is its return value,
            which arrives as the payload of a `Response` with the same tag. An exception arrives as the error.
        tag: identifies the task in its response.
    """

    function: Callable[[], Any]
    tag: str


class CancelTask(msgspec.Struct, frozen=True):
    """End a `BackgroundTask` that is not wanted any more; its response has the error "canceled"."""

    tag: str


class Health(msgspec.Struct, frozen=True):
    """State of the service and a sentence for people, published in `health/<service>` until the next one.

    Attributes:
        state: state of the service.
        text: a sentence for people.
        room_bytes: free space for what the service writes, if it writes.
    """

    state: ServiceState
    text: str
    room_bytes: int | None = None


Output = (
    Publish | Reply | Call | Send | Subscribe | SetRate | SetPace | Reconnect | BackgroundTask | CancelTask | Health
)


# -- inputs of a step --------------------------------------------------------------------------------------


class Request(msgspec.Struct, frozen=True):
    """One request of a client.

    Attributes:
        request_id: names the request in each `Reply`.
        client_id: the sender's; "" when it didn't name itself.
        payload: decoded; the runtime refuses requests that can't be decoded.
    """

    request_id: int
    client_id: str
    payload: Any


class Response(msgspec.Struct, frozen=True):
    """A reply to a `Call`, or the outcome of a call without one or of a `BackgroundTask`.

    Attributes:
        tag: that of the call or task.
        payload: the reply, or the function's return value; None after an error.
        error: reason why a call has no reply, or no more replies ("timeout", "no server", ...), or a task no value (its
            exception, the death of its process, "canceled").
    """

    tag: str
    payload: Any | None
    error: str | None = None


class SentMessage(msgspec.Struct, frozen=True):
    """A message as it was sent.

    Attributes:
        arrival_ns: time of its arrival: in real time ns since 1970 by the host's clock, in virtual time vehicle time.
        topic: name of the topic.
        data: the encoded message, with its attachment.
    """

    arrival_ns: int
    topic: str
    data: bytes


class Inbox(Protocol):
    """Everything that arrived since the last step."""

    @property
    def wall_ns(self) -> int:
        """Monotonic wall time in ns: for liveness of other processes, never for control.

        Stalls of this process are left out of it, as other processes may have stalled at the same time. It stands still
        while a simulator is paused, and slows down with one that is slower than real time.
        """

    @property
    def stalled_ns(self) -> int:
        """What `wall_ns` leaves out so far: both together are the computer's monotonic time, for the time master."""

    @property
    def connected(self) -> bool:
        """Whether the bus's router is reachable."""

    @property
    def departed(self) -> Sequence[str]:
        """Ids of the clients, or names of the services, that vanished since the last step; needs `Spec.watches`."""

    @property
    def responses(self) -> Sequence[Response]:
        """Outcomes of this service's calls and background tasks."""

    @property
    def sent(self) -> Sequence[SentMessage]:
        """All messages since the last step, in the order of their arrival; needs `Spec.hears_all`."""

    def new(self, topic: Topic[M]) -> Sequence[M]:
        """Messages since the last step, oldest first."""

    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message so far, or None."""

    @property
    def has_requests(self) -> bool:
        """Whether there are any requests since the last step."""

    def requests(self, endpoint: Endpoint[Any, Any]) -> Sequence[Request]:
        """Requests since the last step, oldest first."""

    def received(self, link: str) -> bytes:
        """Bytes of a link since the last step."""

    def connections(self, link: str) -> int:
        """Number of connections of a link so far."""

    def is_up(self, link: str) -> bool:
        """Whether a link is connected now; a UDP link always is."""


class Service(Protocol):
    """A declaration and a step."""

    @property
    def spec(self) -> Spec: ...

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Process the inbox and yield outputs.

        Args:
            t_ns: vehicle time; 0 before the first `clock` message.
            inbox: everything that arrived since the last step.
        """
