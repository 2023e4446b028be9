"""What the services say on the bus: who is alive, how it does, and whether the vehicle is ready."""

import socket
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from jezero.runtime.config import Instance
from jezero.schemas import topics
from jezero.schemas.health import ServiceHealth
from jezero.schemas.topics import key, liveliness_key

if TYPE_CHECKING:
    import zenoh

CONNECT_TRY_MS = 500
LEAVE_WITHIN_S = 0.5


@dataclass(frozen=True)
class Verdict:
    """What is known of one service. `health` is "" until it has reported in its present life."""

    alive: bool = False
    health: str = ""
    text: str = ""

    @property
    def healthy(self) -> bool:
        return self.alive and self.health not in ("", "starting")


def answers(router: str) -> bool:
    """Whether a router listens on the endpoint already."""
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
    """A session of a client, unless there is no router within a moment."""
    import zenoh

    from jezero.zenoh_client import client_config

    config = client_config(router)
    config.insert_json5("connect/timeout_ms", str(CONNECT_TRY_MS))
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None


class HealthWatcher:
    """Listens on the bus in the background inside its `with` block.

    Args:
        on_change: called from a background thread after each change.
    """

    def __init__(self, instance: Instance, on_change: Callable[[], None]) -> None:
        self._instance = instance
        self._on_change = on_change
        self._verdicts: dict[str, Verdict] = {}
        self._signs: Counter[str] = Counter()
        self._status: tuple[bool, str] | None = None
        self._session: zenoh.Session | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="health", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join(CONNECT_TRY_MS / 1000 + LEAVE_WITHIN_S)

    @property
    def connected(self) -> bool:
        """Whether there is a router now."""
        session = self._session
        return session is not None and bool(session.info.routers_zid())

    def verdict(self, service: str) -> Verdict:
        return self._verdicts.get(service, Verdict())

    def signs(self, service: str) -> int:
        """How often it has been heard of: its reports, and its arrivals on the bus."""
        return self._signs[service]

    def forget(self, service: str) -> None:
        """Its process has ended: what it said no longer counts."""
        self._verdicts.pop(service, None)
        if service == "vehicle_bridge":
            self._status = None

    @property
    def vehicle_ready(self) -> tuple[bool, str]:
        """Whether a takeoff would be accepted, and else why not."""
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
        self._session = session
        self._on_change()
        self._stopping.wait()
        self._session = None
        for subscriber in (alive, health, status):
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        session.close()  # type: ignore[no-untyped-call]

    def _connect(self) -> "zenoh.Session | None":
        """Try until there is a router, or until the end."""
        while not self._stopping.is_set():
            session = _open(self._instance.router)
            if session is not None:
                return session
            self._stopping.wait(0.05)  # a refused connection is waited out by Zenoh; a bad address is not
        return None

    def _on_token(self, sample: "zenoh.Sample") -> None:
        import zenoh

        service = str(sample.key_expr).rpartition("/")[2]
        if sample.kind == zenoh.SampleKind.PUT:
            known = self.verdict(service)
            self._signs[service] += 1
            self._verdicts[service] = Verdict(True, known.health, known.text)
        else:
            self._verdicts.pop(service, None)
        self._on_change()

    def _on_health(self, sample: "zenoh.Sample") -> None:
        from jezero.codec import BadPayloadError, decode

        try:
            report: ServiceHealth = decode(ServiceHealth, sample.payload.to_bytes())
        except BadPayloadError:
            return
        if not self._is_put_on(topics.health_of(report.service).name, sample):
            return
        self._signs[report.service] += 1
        verdict = Verdict(self.verdict(report.service).alive, report.state, report.text)
        if verdict != self.verdict(report.service):
            self._verdicts[report.service] = verdict
            self._on_change()

    def _on_status(self, sample: "zenoh.Sample") -> None:
        from jezero.codec import BadPayloadError, decode

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
        """Whether it was sent to exactly this key: what is put on a wildcard changes nothing."""
        import zenoh

        return sample.kind == zenoh.SampleKind.PUT and str(sample.key_expr) == key(self._instance.vehicle, name)
