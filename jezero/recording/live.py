"""The channels of a recording, live: messages from the bus to Foxglove's WebSocket."""

import threading
import time
from collections import deque
from types import TracebackType
from typing import NamedTuple, Self

import foxglove
import zenoh

from jezero.base.zenoh_client import data_of
from jezero.recording.channels import json_schema, keys_without_images, schema_name, topic_of
from jezero.recording.images import HEADERS, ImageFormat, split_image
from jezero.recording.viewer_scene import ViewerScene
from jezero.schemas.topics import CAMERA, key

WAITING_MAX = 5000
"""Messages that wait for a busy server; beyond it the oldest are dropped. It is the load of about ten seconds."""


class ServeError(RuntimeError):
    """The server can't be started; the text says why."""


class LiveServer:
    """Foxglove's WebSocket server; a context manager. Its methods are for one thread.

    A channel is announced with its first message, those of the camera at once. What nobody has subscribed to is not
    sent, and an image that nobody has subscribed to is not even encoded.

    Args:
        name: shown in Foxglove.
        host: address on which it listens.
        port: 0 takes a free one.
        scene: makes the messages for 3D viewers.

    Raises:
        ServeError: the address can't be used.
    """

    def __init__(self, name: str, host: str, port: int, scene: ViewerScene) -> None:
        self._scene = scene
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        try:
            self._server = foxglove.start_server(name=name, host=host, port=port, context=self._context)
        except RuntimeError as error:
            raise ServeError(f"can't serve on {host}, port {port}: {error}") from None
        self._images, self._headers = self._channel(CAMERA.name), self._channel(HEADERS)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return self._server.port

    @property
    def wants_images(self) -> bool:
        """Whether anybody has subscribed to the camera."""
        return self._images.has_sinks() or self._headers.has_sinks()

    def publish(self, logged_ns: int, topic: str, data: bytes) -> None:
        """Serve one message.

        Args:
            logged_ns: time of arrival; never smaller than before.
            topic: name of the topic.
            data: the encoded message.
        """
        if topic != CAMERA.name:
            self._send(logged_ns, topic, data)
            return
        image_format = ImageFormat() if self._images.has_sinks() else None
        for channel, message in split_image(data, image_format, lambda t_ns: self._scene.time_of(t_ns, logged_ns)):
            self._send(logged_ns, channel, message)

    def _send(self, logged_ns: int, name: str, data: bytes) -> None:
        self._channel(name).log(data, log_time=logged_ns)
        for channel, message in self._scene.update(logged_ns, name, data):
            self._channel(channel).log(message, log_time=logged_ns)

    def _channel(self, name: str) -> foxglove.Channel:
        channel = self._channels.get(name)
        if channel is None:
            schema = foxglove.Schema(name=schema_name(name), encoding="jsonschema", data=json_schema(name))
            channel = foxglove.Channel(name, schema=schema, message_encoding="json", context=self._context)
            self._channels[name] = channel
        return channel


class Arrival(NamedTuple):
    """One message from the bus.

    Attributes:
        arrival_ns: ns since 1970 by the host's clock.
        topic: name of the topic.
        data: the encoded message, with its attachment.
    """

    arrival_ns: int
    topic: str
    data: bytes


class VehicleMessages:
    """All messages of a vehicle, and its images while they are wanted.

    Zenoh calls back in threads of its own, which only append to a queue: nothing waits for the reader of this queue.
    """

    def __init__(self, session: zenoh.Session, vehicle: str) -> None:
        self._session = session
        self._prefix = key(vehicle, "")
        self._waiting: deque[Arrival] = deque(maxlen=WAITING_MAX)
        self._image: deque[Arrival] = deque(maxlen=1)
        """Only the newest image is kept: one is as large as thousands of other messages."""
        self._arrived = threading.Event()
        self._subscribers = [
            session.declare_subscriber(self._prefix + name, self._on_sample) for name in keys_without_images()
        ]
        self._image_subscriber: zenoh.Subscriber[None] | None = None

    def want_images(self, wanted: bool) -> None:
        """Subscribe to the camera's images, or end the subscription."""
        if wanted and self._image_subscriber is None:
            self._image_subscriber = self._session.declare_subscriber(self._prefix + CAMERA.name, self._on_sample)
        elif not wanted and self._image_subscriber is not None:
            self._image_subscriber.undeclare()  # type: ignore[no-untyped-call]
            self._image_subscriber = None

    def take(self, timeout_s: float) -> list[Arrival]:
        """The messages since the last call, in the order of their arrival; waits for one until the time-out."""
        self._arrived.wait(timeout_s)
        self._arrived.clear()
        taken = [*_drained(self._waiting), *_drained(self._image)]
        return sorted(taken, key=lambda arrival: arrival.arrival_ns)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        topic = str(sample.key_expr).removeprefix(self._prefix)
        if sample.kind == zenoh.SampleKind.PUT and topic_of(topic) is not None:
            queue = self._image if topic == CAMERA.name else self._waiting
            queue.append(Arrival(time.time_ns(), topic, data_of(sample)))
            self._arrived.set()


def _drained(queue: deque[Arrival]) -> list[Arrival]:
    return [queue.popleft() for _ in range(len(queue))]
