"""The messages of a vehicle, through the SDK, for the pages that somebody looks at."""

import asyncio
import time
from typing import Any

from jezero.aio import JezeroError, Vehicle
from jezero.router_address import shown_router
from jezero.runtime.config import links_from_environment
from jezero.schemas.health import ServiceHealth
from jezero.schemas.rows import Topic
from jezero.schemas.terrain import Ground
from jezero.services.ground_station.state import ALWAYS, WATCHED, VehicleState
from jezero.services.ground_station.web.coverage_map import CoverageMap
from jezero.services.ground_station.web.stack_actions import ALL_FEEDBACK, StackActions

ALL_HEALTH = Topic("health/*", ServiceHealth, 1.0, "every service")
RETRY_S = 1.0
SILENT_S = 5.0
"""Time without a status after which the keys are asked for the reason, and between two such checks."""
CONNECT_TIMEOUT_S = 3.0


class Feed:
    """The connection to one vehicle, for NiceGUI's event loop.

    Attributes:
        state: what arrived.
        actions: the actions of the stack.
        coverage_map: the map of the images of the goal in charge.
        problem: why there is no connection yet, or why none of the vehicle's messages come over TLS; "" for neither.
        ground: ground of the simulator; None while nobody has looked, and without a simulator.
        ground_version: grows with each reply to a request for the ground, also with one that there is none.
    """

    def __init__(self, vehicle: str, router: str) -> None:
        self.state = VehicleState()
        self.actions = StackActions(self.state)
        self.coverage_map = CoverageMap(self.state, self.actions)
        self.vehicle, self.router = vehicle, router
        self.ground: Ground | None = None
        self.ground_version = 0
        self.problem = f"Connecting to {shown_router(router)} …"
        self._uav: Vehicle | None = None
        self._always: list[asyncio.Task[None]] = []
        self._watching: list[asyncio.Task[None]] = []
        self._viewers = 0

    @property
    def uav(self) -> Vehicle | None:
        """The vehicle; None until a router replies."""
        return self._uav

    @property
    def now_s(self) -> float:
        """Present time, of the clock of `state`."""
        return time.monotonic()

    @property
    def viewers(self) -> int:
        """Number of open pages."""
        return self._viewers

    # -- life --

    async def connect(self) -> None:
        """Connect, and read what is always read. Returns when a router has replied."""
        while self._uav is None:
            try:
                self._uav = await Vehicle.connect(self.vehicle, router=self.router, insecure=True)  # as it was started
            except JezeroError as error:
                self.problem = str(error)
                await asyncio.sleep(RETRY_S)
        self.problem = ""
        self._always = [self._reading(topic) for topic in (ALL_FEEDBACK, ALL_HEALTH, *ALWAYS)]
        self._always += [
            asyncio.create_task(follow(self._uav)) for follow in (self.actions.follow, self.coverage_map.follow)
        ]
        self._always.append(asyncio.create_task(self._check_keys()))
        self._watch()

    async def close(self) -> None:
        """End all tasks and the connection."""
        for task in (*self._always, *self._watching):
            task.cancel()
        if self._uav is not None:
            await self._uav.close()

    def set_viewers(self, number: int) -> None:
        """Read what the pages show while there are any."""
        self._viewers = number
        self._watch()

    def _watch(self) -> None:
        if self._viewers > 0 and not self._watching and self._uav is not None:
            self._watching = [self._reading(topic) for topic in WATCHED]
            self._watching.append(asyncio.create_task(self._ask_for_ground()))
        elif self._viewers == 0:
            for task in self._watching:
                task.cancel()
            self._watching = []

    async def _ask_for_ground(self) -> None:
        """Ask for the ground once, and again when the vehicle was restarted: its simulator may be another one."""
        assert self._uav is not None
        asked_in: int | None = -1
        while True:
            if asked_in != self.state.epoch_id:
                asked_in = self.state.epoch_id
                try:
                    self.ground = await self._uav.ground()
                except JezeroError:  # a real vehicle: it has no simulator
                    self.ground = None
                self.ground_version += 1
            await asyncio.sleep(RETRY_S)

    async def _check_keys(self) -> None:
        """Find out why no status comes over TLS: the router of this computer hides that its keys are revoked."""
        routers = [each for each in (self.router, *links_from_environment().connect) if each.startswith("tls/")]
        while routers:
            await asyncio.sleep(SILENT_S)
            self.problem = "" if self.state.has_status(self.now_s, SILENT_S) else await self._silence(*routers)

    async def _silence(self, *routers: str) -> str:
        """Why the vehicle's status isn't to be had from a router over TLS, the first one with a reason; or ""."""
        for router in routers:
            try:
                async with await Vehicle.connect(self.vehicle, router=router, timeout_s=CONNECT_TIMEOUT_S) as uav:
                    await uav.status()
            except JezeroError as error:
                return str(error)
        return ""

    # -- messages --

    def _reading(self, topic: Topic[Any]) -> asyncio.Task[None]:
        return asyncio.create_task(self._read(topic))

    async def _read(self, topic: Topic[Any]) -> None:
        assert self._uav is not None
        async with self._uav.subscribe(topic) as stream:
            while True:
                try:
                    message = await stream.next()
                except JezeroError as error:
                    self.state.events.add(time.monotonic(), "warning", f"{topic.name}: {error}")
                    await asyncio.sleep(RETRY_S)
                else:
                    self.state.update(time.monotonic(), topic, message)
