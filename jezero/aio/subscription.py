"""Subscriptions to topics."""

import asyncio
import time
from collections.abc import AsyncIterator
from typing import Generic, Self, TypeVar

from jezero.aio.arrivals import AsyncArrivals
from jezero.client import subscription as client
from jezero.client.errors import TimedOut, Unreachable
from jezero.schemas.rows import Topic
from jezero.schemas.struct import Message

M = TypeVar("M", bound=Message)


class Subscription(Generic[M]):
    """Messages of one topic, oldest first, for one task; see `jezero.client.subscription.Subscription`.

    ```python
    async with uav.subscribe(topics.ODOMETRY) as stream:
        async for odometry in stream:
            print(odometry.pos_uav_ned_m)
    ```
    """

    def __init__(self, blocking: "client.Subscription[M]") -> None:
        self._blocking = blocking
        self._arrivals = AsyncArrivals(blocking._arrivals)

    @property
    def topic(self) -> Topic[M]:
        """The topic's row of the topic table."""
        return self._blocking.topic

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exception: object) -> None:
        self.close()

    async def __aiter__(self) -> AsyncIterator[M]:
        """Yield each message; ends when the subscription is closed, and raises the errors of `next`."""
        while not self._blocking._closed:
            try:
                yield await self.next()
            except Unreachable:
                if not self._blocking._closed:  # closed by another task, not by a lost connection
                    raise

    async def next(self, timeout_s: float | None = None) -> M:
        """The next message; arguments and errors as of `jezero.client.subscription.Subscription.next`."""
        try:
            data = await self._arrivals.take(None if timeout_s is None else time.monotonic() + timeout_s)
        except TimedOut:
            silence = await asyncio.to_thread(client.silence, self._blocking._connection, self.topic, timeout_s)
            raise TimedOut(silence) from None
        return self._blocking._read(data)

    def close(self) -> None:
        """End the subscription. May be called twice."""
        self._blocking.close()
