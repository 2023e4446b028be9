"""An event loop with a connected vehicle, and messages of hand-made servers."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import msgspec

from jezero.aio import Vehicle
from jezero.schemas.state import Clock, Odometry
from tests.client.rig import (
    ODOMETRY,
    Server,
)

TAKEOFF = "@action/takeoff"
CANCEL = "@action/takeoff/cancel"


@asynccontextmanager
async def connected(endpoint: str, server: Server) -> AsyncIterator[Vehicle]:
    """A connection to vehicle `v`; a server that is declared later is known to it at once."""
    async with await Vehicle.connect("v", router=endpoint) as uav:
        server.clients.append(uav._blocking._connection._session)
        yield uav


def with_vehicle(endpoint: str, server: Server, test: Callable[[Vehicle], Awaitable[None]]) -> None:
    """Run a test in an event loop with a connected vehicle."""

    async def run() -> None:
        async with asyncio.timeout(20), connected(endpoint, server) as uav:
            await test(uav)

    asyncio.run(run())


async def happens(condition: Callable[[], object], timeout_s: float = 3.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.005)


def asked(server: Server) -> list[str]:
    return [name for name, _, _ in server.asked]


def odometry(t_ns: int) -> Odometry:
    return msgspec.structs.replace(ODOMETRY, t_ns=t_ns)


def clock(t_ns: int) -> Clock:
    return Clock(t_ns=100_000_000 * t_ns, epoch_id=1, wall_ns=t_ns)


# -- goals --
