"""Health of the services, as published on the bus, and whether the vehicle is ready."""

import contextlib
import socket
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from jezero.runtime.instance import Instance
from jezero.schemas import topics
from jezero.schemas.health import GateLinks, ServiceHealth
from jezero.schemas.topics import key, liveliness_key

if TYPE_CHECKING:
    import zenoh

CONNECT_TRY_MS = 500
CLOSE_TIMEOUT_S = 0.5
GATES_TIMEOUT_S = 3.0


@dataclass(frozen=True)
class ServiceReport:
    """State of one service on the bus.

    Attributes:
        alive: whether its liveliness token is present.
        health: its own health; "" until the present process has published it.
        text: its sentence for people.
        process: its host and process id, for people; "" until the present process has published its health.
    """

    alive: bool = False
    health: str = ""
    text: str = ""
    process: str = ""

    @property
    def healthy(self) -> bool:
        return self.alive and self.health not in ("", "starting")


def router_is_up(router: str) -> bool:
    """Whether a router listens on the endpoint."""
    protocol, _, address = router.partition("/")
    host, _, port = address.rpartition(":")
    if protocol == "tcp":
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=1.0).close()
        except (OSError, ValueError):
            return False
    session = _open(router)
    if session is None:
        return False
    session.close()  # type: ignore[no-untyped-call]
    return True


def _open(router: str) -> "zenoh.Session | None":
    """Open a client's session; None if no router replies at once."""
    import zenoh

    from jezero.base.zenoh_client import client_config

    config = client_config(router)
    config.insert_json5("connect/timeout_ms", str(CONNECT_TRY_MS))
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None


class HealthWatcher:
    """Subscriber of tokens, health and status in the background, inside its `with` block.

    Args:
        instance: the stack.
        on_change: called from a background thread after each change.
        on_gate: called from a background thread with each beat of a gate, and whether it is a reply.
    """

    def __init__(
        self,
        instance: Instance,
        on_change: Callable[[], None],
        on_gate: Callable[[GateLinks, bool], None] = lambda _links, _is_reply: None,
    ) -> None:
        self._instance = instance
        self._on_change = on_change
        self._on_gate = on_gate
        self._reports: dict[str, ServiceReport] = {}
        self._reports_received: Counter[str] = Counter()
        self._status: tuple[bool, str] | None = None
        self._session: zenoh.Session | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="health", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join(CONNECT_TRY_MS / 1000 + CLOSE_TIMEOUT_S)

    @property
    def connected(self) -> bool:
        """Whether a router is connected now."""
        session = self._session
        return session is not None and bool(session.info.routers_zid())

    def report(self, service: str) -> ServiceReport:
        return self._reports.get(service, ServiceReport())

    def reports_received(self, service: str) -> int:
        """Number of a service's health reports and arrivals on the bus so far."""
        return self._reports_received[service]

    def forget(self, service: str) -> None:
        """Forget a service whose process has ended."""
        self._reports.pop(service, None)
        if service == "vehicle_bridge":
            self._status = None

    @property
    def vehicle_ready(self) -> tuple[bool, str]:
        """(whether the vehicle is ready, reason if it is not)."""
        return self._status or (False, "vehicle_bridge has sent no status yet")

    def _run(self) -> None:
        session = self._connect()
        if session is None:
            return
        vehicle = self._instance.vehicle
        alive = session.liveliness().declare_subscriber(
            liveliness_key(vehicle, "service", "*"), self._on_token, history=True
        )
        health = session.declare_subscriber(key(vehicle, "health/*"), self._on_health)
        status = session.declare_subscriber(key(vehicle, topics.STATUS.name), self._on_status)
        gates = session.declare_subscriber(
            key(vehicle, topics.EVERY_LINK.name), lambda beat: self._on_beat(beat, is_reply=False)
        )
        self._session = session
        self._on_change()
        self._stopping.wait()
        self._session = None
        for subscriber in (alive, health, status, gates):
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        session.close()  # type: ignore[no-untyped-call]

    def _connect(self) -> "zenoh.Session | None":
        """Try until a router replies, or until the block ends."""
        while not self._stopping.is_set():
            session = _open(self._instance.router)
            if session is not None:
                return session
            self._stopping.wait(0.05)  # Zenoh waits after a refused connection, but not after a bad address
        return None

    def _on_token(self, sample: "zenoh.Sample") -> None:
        import zenoh

        service = str(sample.key_expr).rpartition("/")[2]
        if sample.kind == zenoh.SampleKind.PUT:
            previous = self.report(service)
            self._reports_received[service] += 1
            self._reports[service] = replace(previous, alive=True)
        else:
            self._reports.pop(service, None)
        self._on_change()

    def _on_health(self, sample: "zenoh.Sample") -> None:
        from jezero.base.codec import BadPayloadError, decode

        try:
            health: ServiceHealth = decode(ServiceHealth, sample.payload.to_bytes())
        except BadPayloadError:
            return
        if not self._is_put_on(topics.health_of(health.service).name, sample):
            return
        self._reports_received[health.service] += 1
        report = ServiceReport(self.report(health.service).alive, health.state, health.text, health.process)
        if report != self.report(health.service):
            self._reports[health.service] = report
            self._on_change()

    def ask_gates(self) -> None:
        """Send a request to all gates; `on_gate` gets their replies."""
        import zenoh

        def on_reply(reply: "zenoh.Reply") -> None:
            if reply.ok is not None:
                self._on_beat(reply.ok, is_reply=True)

        session = self._session
        if session is not None:
            with contextlib.suppress(zenoh.ZError):  # it was closed just now
                session.get(
                    key(self._instance.vehicle, topics.EVERY_LINK.name),
                    on_reply,
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=GATES_TIMEOUT_S,
                )

    def _on_beat(self, sample: "zenoh.Sample", *, is_reply: bool) -> None:
        from jezero.base.codec import BadPayloadError, decode

        try:
            links: GateLinks = decode(GateLinks, sample.payload.to_bytes())
        except BadPayloadError:
            return
        if self._is_put_on(topics.EVERY_LINK.name.replace("*", links.gate), sample):
            self._on_gate(links, is_reply)

    def _on_status(self, sample: "zenoh.Sample") -> None:
        from jezero.base.codec import BadPayloadError, decode

        if not self._is_put_on(topics.STATUS.name, sample):
            return
        try:
            message = decode(topics.STATUS.type, sample.payload.to_bytes())
        except BadPayloadError:
            return
        status = (message.ready, message.not_ready_reason)
        if status != self._status:
            self._status = status
            self._on_change()

    def _is_put_on(self, name: str, sample: "zenoh.Sample") -> bool:
        """Whether a sample is a PUT on exactly this key: a PUT on a wildcard must change nothing."""
        import zenoh

        return sample.kind == zenoh.SampleKind.PUT and str(sample.key_expr) == key(self._instance.vehicle, name)
