"""The rover."""

import asyncio
import math
import threading
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from jezero.aio.threads import Threads, in_thread
from jezero.client import rover as client
from jezero.client.rover import Leg, leg_refusal


class Rover:
    """The rover of one vehicle, the attribute `Vehicle.rover`; see `jezero.client.rover.Rover`.

    A task that is canceled while it drives stops the rover.
    """

    def __init__(self, threads: Threads, blocking: "client.Rover") -> None:
        self._threads = threads
        self._blocking = blocking

    async def drive(self, speed_mps: float, yaw_rate_rps: float = 0.0, *, for_s: float | None = None) -> None:
        """Drive, then stop the rover; arguments and errors as of `jezero.client.rover.Rover.drive`."""
        await self.follow([Leg(math.inf if for_s is None else for_s, speed_mps, yaw_rate_rps)])

    async def follow(self, legs: Sequence[Leg]) -> None:
        """Drive legs one after the other, then stop; errors as of `jezero.client.rover.Rover.follow`."""
        over = threading.Event()
        drive = self._threads.run(self._blocking._drive, legs, lambda number, leg: None, over)
        driving = asyncio.ensure_future(drive)
        try:
            await asyncio.shield(driving)
        except asyncio.CancelledError:
            over.set()
            await asyncio.wait([driving])  # until the rover has stopped
            raise

    @asynccontextmanager
    async def driving(self, speed_mps: float, yaw_rate_rps: float = 0.0) -> AsyncIterator[None]:
        """Drive during an `async with` block; arguments and errors as of `jezero.client.rover.Rover.driving`."""
        if refusal := leg_refusal(Leg(math.inf, speed_mps, yaw_rate_rps)):
            raise ValueError(refusal)
        task = asyncio.create_task(self.drive(speed_mps, yaw_rate_rps))
        try:
            yield
        finally:
            task.cancel()
            await asyncio.wait([task])
        if not task.cancelled():  # the drive had ended earlier, with an error
            task.result()

    steer = in_thread(client.Rover.steer)
    stop = in_thread(client.Rover.stop)
