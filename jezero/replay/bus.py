"""A replay on a Zenoh bus: who else is there, and the messages on the vehicle's keys."""

import os
import socket
import threading
from collections.abc import Collection, Sequence
from types import TracebackType
from typing import Any, NamedTuple, Self

import msgspec
import zenoh

from jezero.base.codec import BadPayloadError, decode, encode, has_attachment, join_attachment
from jezero.base.zenoh_client import declare_publisher, put
from jezero.recording.images import decompress
from jezero.recording.mcap_file import RecordingError
from jezero.replay import NAME
from jezero.replay.player import ReplayMessage
from jezero.runtime.process import new_boot_id
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.state import Status
from jezero.schemas.topics import CAMERA, STATUS, TOPICS, health_of, key, liveliness_key

REPLY_TIMEOUT_S = 1.0
LISTEN_S = 0.5
"""Duration for which a replay listens before it starts, for writers that are no services of jezero."""
ROUTER = "router"
"""Name of the router, which publishes nothing but its health."""
_ATTACHED = frozenset(topic.name for topic in TOPICS if has_attachment(topic.type))


class Others(NamedTuple):
    """Who publishes as a vehicle on a bus already.

    Attributes:
        services: its services, and another replay.
        topics: topics on which something was published just now.
        flies: whether the vehicle is in the air, or armed.
    """

    services: tuple[str, ...]
    topics: tuple[str, ...]
    flies: bool

    def in_words(self, vehicle: str, router: str) -> str:
        """Who is there, for people; "" for nobody.

        Args:
            vehicle: name of the vehicle.
            router: address of the bus.
        """
        flies = ", and the vehicle flies" if self.flies else ""
        if self.services:
            verb = "runs" if len(self.services) == 1 else "run"
            return f"{_listed(self.services)} of {vehicle} {verb} on {router}{flies}"
        return f"somebody publishes {_listed(self.topics)} of {vehicle} on {router}{flies}" if self.topics else ""


def find_others(session: zenoh.Session, vehicle: str) -> Others:
    """Find out who publishes as a vehicle already; takes up to a second."""
    alive = session.liveliness().get(liveliness_key(vehicle, "service", "*"), timeout=REPLY_TIMEOUT_S)
    names = {str(reply.ok.key_expr).rpartition("/")[2] for reply in alive if reply.ok is not None}
    services = tuple(sorted(names - {ROUTER}))
    topics = () if services else _published_now(session, vehicle)
    return Others(services, topics, services != (NAME,) and _flies(session, vehicle))


def _published_now(session: zenoh.Session, vehicle: str) -> tuple[str, ...]:
    """Topics on which messages arrive."""
    prefix = key(vehicle, "")
    found: set[str] = set()
    arrived = threading.Event()

    def on_sample(sample: zenoh.Sample) -> None:
        found.add(str(sample.key_expr).removeprefix(prefix))
        arrived.set()

    names = [topic.name for topic in TOPICS if topic.name not in _ATTACHED]
    subscribers = [session.declare_subscriber(prefix + name, on_sample) for name in names]
    arrived.wait(LISTEN_S)
    for subscriber in subscribers:
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    return tuple(sorted(found))


def _flies(session: zenoh.Session, vehicle: str) -> bool:
    for reply in session.get(key(vehicle, STATUS.name), timeout=REPLY_TIMEOUT_S):
        if reply.ok is not None:
            try:
                status: Status = decode(Status, reply.ok.payload.to_bytes())
            except BadPayloadError:
                continue
            return status.armed or not status.landed
    return False


def _listed(names: Sequence[str], shown_max: int = 3) -> str:
    """Names for people, the first ones of many."""
    rest = len(names) - shown_max
    text = ", ".join(names[:shown_max])
    return f"{text} and {rest} more" if rest > 0 else text


class ReplayBus:
    """Publishes a recording's messages as the services of a vehicle did; a context manager.

    Args:
        session: session on the bus; it stays open.
        vehicle: name of the vehicle whose keys are used.
        topics: topics that will be published.

    Attributes:
        published: number of messages published so far.
    """

    def __init__(self, session: zenoh.Session, vehicle: str, topics: Collection[str]) -> None:
        self.published = 0
        self._boot_id = new_boot_id()
        self._started: set[str] = set()
        self._status: bytes | None = None
        congestion = zenoh.CongestionControl.BLOCK  # a slow reader slows the replay down, and gets every message
        self._publishers = {
            name: declare_publisher(session, key(vehicle, name), attached=name in _ATTACHED, congestion=congestion)
            for name in (*topics, health_of(NAME).name)
        }
        status = key(vehicle, STATUS.name)

        def on_query(query: zenoh.Query) -> None:
            with query:
                if self._status is not None:
                    query.reply(status, self._status, encoding=zenoh.Encoding.APPLICATION_JSON)

        def on_token(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr).rpartition("/")[2]
            if sample.kind == zenoh.SampleKind.PUT and name not in (ROUTER, NAME):
                self._started.add(name)

        liveliness = session.liveliness()
        self._declared: list[Any] = [
            liveliness.declare_token(liveliness_key(vehicle, "service", NAME)),
            liveliness.declare_subscriber(liveliness_key(vehicle, "service", "*"), on_token),
        ]
        if STATUS.name in topics:
            self._declared.append(session.declare_queryable(status, on_query, complete=True))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for declared in (*self._declared, *self._publishers.values()):
            declared.undeclare()

    @property
    def started_services(self) -> tuple[str, ...]:
        """Services of the vehicle that have started since the replay did."""
        return tuple(sorted(self._started))

    def publish(self, message: ReplayMessage) -> None:
        """Publish a message; an image only while somebody has subscribed to it.

        Raises:
            RecordingError: an image is damaged.
        """
        publisher = self._publishers[message.topic]
        data = message.data
        if message.topic == CAMERA.name:
            matching: Any = publisher.matching_status
            if not matching.matching:
                return
            data = join_attachment(message.data, _pixels(message))
        put(publisher, data, attached=message.topic in _ATTACHED)
        if message.topic == STATUS.name:
            self._status = data
        self.published += 1

    def publish_health(self, text: str) -> None:
        """Publish the health of the replay, by which others know who publishes."""
        report = ServiceHealth(
            t_ns=0,
            service=NAME,
            boot_id=self._boot_id,
            process=f"{socket.gethostname()} pid {os.getpid()}",
            state="ok",
            text=text,
        )
        put(self._publishers[health_of(NAME).name], encode(report), attached=False)


def _pixels(message: ReplayMessage) -> bytes:
    """The pixels of an image.

    Raises:
        RecordingError: the image is damaged, or it is not the one of its other fields.
    """
    try:
        frame: CameraFrame = msgspec.json.decode(message.data, type=CameraFrame)
        pixels = decompress(message.image)
    except (ValueError, msgspec.DecodeError) as error:
        raise RecordingError(f"the image of {message.at_ns / 1e9:.3f} s is damaged ({error})") from None
    if pixels.shape != (frame.height_px, frame.width_px, 3):
        raise RecordingError(f"the image of {message.at_ns / 1e9:.3f} s is damaged: it has another size than recorded")
    data: bytes = pixels.tobytes()
    return data
