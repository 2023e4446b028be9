"""Telemetry: the messages of a topic one by one, and the newest one of each."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Generic, Self, TypeVar

from jezero.base.mistakes import unknown
from jezero.client.errors import TimedOut, Unreachable
from jezero.client.session import Connection, decoder
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.struct import Message, WithAttachment

M = TypeVar("M", bound=Message)

QUEUE_MAX, PICTURES_MAX = 1000, 4
"""Messages, and pictures of a megabyte each, that wait for a slow reader; the oldest are dropped beyond."""
FRESH_S = 1.0
"""An older message isn't the latest value any more, but a leftover of a service that has stopped."""


class Subscription(Generic[M]):
    """Messages of one topic, oldest first: for use in a `with` block and by one thread.

    ```python
    with uav.subscribe(topics.ODOMETRY) as stream:
        for odometry in stream:
            print(odometry.pos_uav_ned_m)
    ```

    A reader that is too slow loses the oldest messages: 1000 are kept, of pictures 4.

    Attributes:
        topic: the topic's row of the topic table.
    """

    def __init__(self, connection: Connection, topic: Topic[M]) -> None:
        self.topic = topic
        self._connection = connection
        self._decode = decoder(topic.type)
        self._closed = False
        pictures = issubclass(topic.struct, WithAttachment)
        self._arrivals, self._undeclare = connection.subscribe(topic, PICTURES_MAX if pictures else QUEUE_MAX)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[M]:
        """Yield each message; ends when the subscription is closed, and raises the errors of `next`."""
        while not self._closed:
            try:
                yield self.next()
            except Unreachable:
                if not self._closed:  # closed by the thread that owns the subscription, not by a lost connection
                    raise

    def next(self, timeout_s: float | None = None) -> M:
        """The next message.

        Args:
            timeout_s: longest wait; None waits until one comes.

        Raises:
            TimedOut: no message came in time.
            Unreachable: the subscription or the connection was closed.
            JezeroError: the message is not valid.
        """
        try:
            data = self._arrivals.take(None if timeout_s is None else time.monotonic() + timeout_s)
        except TimedOut:
            raise TimedOut(silence(self._connection, self.topic, timeout_s)) from None
        return self._read(data)

    def close(self) -> None:
        """End the subscription. May be called twice, and from another thread."""
        if not self._closed:
            self._closed = True
            self._undeclare()

    def _read(self, data: bytes | None) -> M:
        """Decode a message; None is the end of all messages, which raises."""
        if data is None:
            raise Unreachable(self._connection.loss_reason() or f"the subscription to {self.topic.name} was closed")
        message: M = self._decode(data)
        return message


def call_for_each(subscription: Subscription[M], callback: Callable[[M], object]) -> None:
    """Call a function with each message, in a thread of its own: a slow one delays nobody else.

    The thread ends with the subscription or the connection. When the function raises, the traceback is printed and the
    subscription ends.
    """

    def run() -> None:
        with subscription:
            try:
                for message in subscription:
                    callback(message)
            except Unreachable:
                return

    threading.Thread(target=run, name=f"jezero {subscription.topic.name}", daemon=True).start()


class LatestValues:
    """The newest message of each topic that was asked for; a topic is subscribed to from the first request on."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._values: dict[str, _Latest] = {}
        self._lock = threading.Lock()

    def get(self, topic: Topic[M], timeout_s: float) -> M:
        """The newest message, at most a second old.

        Args:
            timeout_s: longest wait for a message where there is none yet.

        Raises:
            TimedOut: no message came in time.
            Unreachable: the connection was closed.
        """
        with self._lock:
            latest = self._values.get(topic.name)
            if latest is None:
                latest = self._values[topic.name] = _Latest(self._connection, topic)
        message: M = latest.get(timeout_s)
        return message


class _Latest:
    def __init__(self, connection: Connection, topic: Topic[Any]) -> None:
        self._connection = connection
        self._topic = topic
        self._decode = decoder(topic.type)
        self._condition = threading.Condition()
        self._data: bytes | None = None
        self._arrived_s = 0.0
        self._ended = False
        connection.subscribe_with(topic, self._on_data, self._on_end)

    def get(self, timeout_s: float) -> Any:
        with self._condition:
            self._condition.wait_for(lambda: self._ended or self._is_fresh(), timeout_s)
            if self._ended:
                raise Unreachable(self._connection.loss_reason() or "the connection was closed")
            if self._data is None or not self._is_fresh():
                raise TimedOut(silence(self._connection, self._topic, timeout_s))
            data = self._data
        return self._decode(data)

    def _is_fresh(self) -> bool:
        slowest_s = 3.0 / self._topic.rate_hz if self._topic.rate_hz else FRESH_S
        return self._data is not None and time.monotonic() - self._arrived_s <= max(FRESH_S, slowest_s)

    def _on_data(self, data: bytes) -> None:
        with self._condition:
            self._data, self._arrived_s = data, time.monotonic()
            self._condition.notify_all()

    def _on_end(self) -> None:
        with self._condition:
            self._ended = True
            self._condition.notify_all()


def silence(connection: Connection, topic: Topic[Any], timeout_s: float | None) -> str:
    """Error text for a topic without a message in time."""
    if hidden := connection.hidden_reason():
        return hidden
    return f"no message on {topic.name} of {connection.vehicle} for {timeout_s:g} s: is its service up? (`jezero ps`)"


def topic_named(topic: "str | Topic[M]") -> Topic[Any]:
    """The row of the topic table; a row stays as it is.

    Raises:
        ValueError: there is no topic of that name.
    """
    if isinstance(topic, Topic):
        return topic
    known = {row.name: row for row in topics.TOPICS}
    if topic not in known:
        raise ValueError(unknown("topic", topic, known))
    return known[topic]
