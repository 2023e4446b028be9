"""Waits of tasks for messages that arrive in Zenoh's threads."""

import asyncio
import time
from contextlib import suppress

from jezero.client.errors import TimedOut
from jezero.client.session import ReplyArrivals


class AsyncArrivals:
    """Queue of messages from Zenoh's threads to one task.

    No thread waits for a message: a task that is canceled in its wait leaves nobody behind who would take the next
    message away, and any number of tasks may wait.

    Raises:
        RuntimeError: no event loop runs.
    """

    def __init__(self, arrivals: ReplyArrivals) -> None:
        self._arrivals = arrivals
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()
        arrivals.on_put = self._on_put

    def _on_put(self) -> None:
        with suppress(RuntimeError):  # the loop is closed, and nobody waits
            self._loop.call_soon_threadsafe(self._arrived.set)

    async def take(self, deadline_s: float | None) -> bytes | None:
        """Wait for the next message; None at the end. Arguments and errors as of `Arrivals.take`."""
        left_s = None if deadline_s is None else max(deadline_s - time.monotonic(), 0.0)
        try:
            async with asyncio.timeout(left_s):
                while True:
                    self._arrived.clear()  # before the queue is read, so that no later message is missed
                    with suppress(TimedOut):
                        return self._arrivals.take(deadline_s=0.0)
                    await self._arrived.wait()
        except TimeoutError:
            raise TimedOut("no reply in time") from None
