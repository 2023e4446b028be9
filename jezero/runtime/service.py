"""The one shape of a service: a declaration and a step.

A service owns no thread, socket, timer or clock. It declares what it reads and writes in a `Spec`; the runtime
hands it an `Inbox` and the time, and carries out the `Output`s that its step yields. The same class runs over
Zenoh in real time (`zenoh_bus`) and on the in-memory bus in virtual time (`memory_bus`).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import msgspec

from jezero.schemas.health import ServiceState
from jezero.schemas.struct import Message, Payload
from jezero.schemas.topics import Endpoint, Topic

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Payload)
R = TypeVar("R", bound=Payload)


@dataclass(frozen=True, kw_only=True)
class Spec:
    """What a service reads, writes, answers and asks; anything else raises `UndeclaredError`.

    Attributes:
        name: unique within a vehicle; also the liveliness token and the key of its health.
        inputs: topics it always listens to.
        on_demand: topics it listens to only while a `Subscribe` output names them.
        outputs: topics it publishes.
        last_value: outputs whose latest message is also answered to a plain get on the same key.
        serves: endpoints it answers; the runtime refuses to start a second server of the same name.
        calls: endpoints it asks.
        links: byte pipes by name; the shell decides whether they are TCP, UDP or memory.
        triggers: names of topics, endpoints or links whose arrival makes a step at once.
        rate_hz: steps per second of vehicle time when no trigger arrives; `SetRate` changes it.
        lockstep: the time master names the link whose answer it awaits after each step (at most 20 ms); vehicle
            time starts when this link first connects. None for every other service.
        watches_clients: the inbox tells which clients have vanished.
    """

    name: str
    inputs: tuple[Topic[Any], ...] = ()
    on_demand: tuple[Topic[Any], ...] = ()
    outputs: tuple[Topic[Any], ...] = ()
    last_value: tuple[Topic[Any], ...] = ()
    serves: tuple[Endpoint[Any, Any], ...] = ()
    calls: tuple[Endpoint[Any, Any], ...] = ()
    links: tuple[str, ...] = ()
    triggers: tuple[str, ...] = ()
    rate_hz: float = 10.0
    lockstep: str | None = None
    watches_clients: bool = False


class UndeclaredError(RuntimeError):
    """A service used a topic, endpoint or link that its `Spec` doesn't declare."""


# -- what a step yields ------------------------------------------------------------------------------------


class Publish(msgspec.Struct, frozen=True):
    """A message on a topic of `Spec.outputs`."""

    topic: Topic[Any]
    message: Message


class Reply(msgspec.Struct, frozen=True):
    """An answer to `Request.request_id`. Any number may precede the one with `final`, which ends the request.

    A `payload` of None ends it without saying anything: for endpoints shared by servers that each know a part.
    """

    request_id: int
    payload: Payload | None
    final: bool = True


class Call(msgspec.Struct, frozen=True):
    """A question to an endpoint of `Spec.calls`; the answer comes as a `Response` with the same tag."""

    endpoint: Endpoint[Any, Any]
    payload: Payload
    tag: str
    timeout_s: float = 1.0


class Send(msgspec.Struct, frozen=True):
    """Bytes for a link of `Spec.links`; dropped when the link is down."""

    link: str
    data: bytes


class Subscribe(msgspec.Struct, frozen=True):
    """From now on listen to exactly these of `Spec.on_demand`; the others' latest values are forgotten."""

    topics: tuple[Topic[Any], ...]


class SetRate(msgspec.Struct, frozen=True):
    """From now on step so often when no trigger arrives; None is the rate of the `Spec` again."""

    rate_hz: float | None


class BackgroundTask(msgspec.Struct, frozen=True):
    """What takes too long for a step: carried out beside the service, which goes on stepping meanwhile.

    One at a time, in the order they were asked for.

    Args:
        function: pure; what it returns comes as the payload of a `Response` with the same tag.
    """

    function: Callable[[], Any]
    tag: str


class Health(msgspec.Struct, frozen=True):
    """The service's own verdict and sentence, shown in `health/<service>` until the next one."""

    state: ServiceState
    text: str


Output = Publish | Reply | Call | Send | Subscribe | SetRate | BackgroundTask | Health


# -- what a step is given ----------------------------------------------------------------------------------


class Request(msgspec.Struct, frozen=True):
    """One question that came in. `payload` is decoded; undecodable ones were already refused by the runtime."""

    request_id: int
    client_id: str
    payload: Any


class Response(msgspec.Struct, frozen=True):
    """An answer to a `Call`: a payload, or the reason why there is none ("timeout", "no server", ...); or the outcome
    of a `BackgroundTask`."""

    tag: str
    payload: Any | None
    error: str | None = None


class Inbox(Protocol):
    """What arrived since the last step."""

    @property
    def wall_ns(self) -> int:
        """Monotonic wall time in ns: for liveness of other processes, never for control.

        Time in which this process itself stood still is left out, as the others may have stood still as well.
        """

    @property
    def connected(self) -> bool:
        """Whether the bus's router is reachable."""

    @property
    def departed_clients(self) -> Sequence[str]:
        """Ids of clients that vanished since the last step (needs `Spec.watches_clients`)."""

    @property
    def responses(self) -> Sequence[Response]:
        """Answers to this service's calls, outcomes of its work."""

    def new(self, topic: Topic[M]) -> Sequence[M]:
        """Messages since the last step, oldest first."""

    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message ever seen, or None."""

    @property
    def has_requests(self) -> bool:
        """Whether there are any questions since the last step."""

    def requests(self, endpoint: Endpoint[Any, Any]) -> Sequence[Request]:
        """Questions since the last step, oldest first."""

    def received(self, link: str) -> bytes:
        """Bytes since the last step."""

    def connections(self, link: str) -> int:
        """How often this link has connected so far; 0 while it never did."""

    def is_up(self, link: str) -> bool:
        """Whether the link is connected now; a UDP link always is."""


class Service(Protocol):
    """A declaration and a step."""

    @property
    def spec(self) -> Spec: ...

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """React to what arrived.

        Args:
            t_ns: vehicle time; 0 while no `clock` message has been seen.
        """
