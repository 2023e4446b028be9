"""The messages of a vehicle, through the SDK, for the pages that somebody looks at."""

import asyncio
import io
import time
from contextlib import suppress
from typing import Any

from jezero.aio import JezeroError, Vehicle
from jezero.plugins import all_actions
from jezero.schemas import topics
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import Topic
from jezero.services.ground_station.state import VehicleState

ALL_HEALTH = Topic("health/*", ServiceHealth, 1.0, "every service")
WATCHED = (topics.ALTIMETER, topics.GNSS, topics.RELATIVE, topics.ROVER_ESTIMATE, topics.CAMERA_PITCH)
"""Topics that are read only while somebody looks."""
RETRY_S = 1.0
PICTURE_AGE_MAX_S = 2.0
LOOKER_TIMEOUT_S = 3.0
"""The camera's images are read until nobody has asked for one for this duration."""
JPEG_QUALITY = 75


class Feed:
    """The connection to one vehicle, for NiceGUI's event loop.

    Attributes:
        state: what arrived.
        problem: why there is no connection yet; "" with one.
    """

    def __init__(self, vehicle: str, router: str, rate_camera_hz: float) -> None:
        self.state = VehicleState()
        self.vehicle, self.router = vehicle, router
        self.problem = f"Connecting to {router} …"
        self._uav: Vehicle | None = None
        self._period_camera_s = 1.0 / rate_camera_hz
        self._always: list[asyncio.Task[None]] = []
        self._watching: list[asyncio.Task[None]] = []
        self._viewers = 0
        self._camera: asyncio.Task[None] | None = None
        self._asked_s = 0.0
        self._picture: tuple[float, bytes] | None = None

    @property
    def uav(self) -> Vehicle | None:
        """The vehicle; None until a router replies."""
        return self._uav

    @property
    def viewers(self) -> int:
        """Number of open pages."""
        return self._viewers

    # -- life --

    async def connect(self) -> None:
        """Connect, and read what is always read. Returns when a router has replied."""
        while self._uav is None:
            try:
                self._uav = await Vehicle.connect(self.vehicle, router=self.router)
            except JezeroError as error:
                self.problem = str(error)
                await asyncio.sleep(RETRY_S)
        self.problem = ""
        feedback: list[Topic[Any]] = [topics.feedback_of(action) for action in all_actions().values()]
        self._always = [self._reading(topic) for topic in (*feedback, topics.STATUS, ALL_HEALTH)]
        self._watch()

    async def close(self) -> None:
        """End all tasks and the connection."""
        for task in (*self._always, *self._watching, *((self._camera,) if self._camera else ())):
            task.cancel()
        if self._uav is not None:
            await self._uav.close()

    def add_viewer(self) -> None:
        """Somebody opened a page."""
        self._viewers += 1
        self._watch()

    def remove_viewer(self) -> None:
        """Somebody closed a page."""
        self._viewers -= 1
        self._watch()

    def _watch(self) -> None:
        if self._viewers > 0 and not self._watching and self._uav is not None:
            self._watching = [self._reading(topic) for topic in WATCHED]
        elif self._viewers == 0:
            for task in self._watching:
                task.cancel()
            self._watching = []

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

    # -- camera --

    async def picture(self) -> bytes | None:
        """The newest image of the camera as a JPEG; None when there is none of the last seconds."""
        self._asked_s = time.monotonic()
        if self._uav is None:
            return None
        if self._camera is None or self._camera.done():
            self._camera = asyncio.create_task(self._read_camera())
        if self._picture is None or time.monotonic() - self._picture[0] > PICTURE_AGE_MAX_S:
            return None
        return self._picture[1]

    async def _read_camera(self) -> None:
        assert self._uav is not None
        next_s = 0.0
        with suppress(JezeroError):  # no camera, or no router: `picture` shows that there is no image
            async with self._uav.subscribe(topics.CAMERA) as stream:
                while time.monotonic() - self._asked_s < LOOKER_TIMEOUT_S:
                    frame = await stream.next(LOOKER_TIMEOUT_S)
                    now_s = time.monotonic()
                    if now_s >= next_s:
                        next_s = now_s + self._period_camera_s
                        self._picture = (now_s, await asyncio.to_thread(_jpeg, frame))


def _jpeg(frame: CameraFrame) -> bytes:
    from PIL import Image

    compressed = io.BytesIO()
    image = Image.frombytes("RGB", (frame.width_px, frame.height_px), frame.pixels)
    image.save(compressed, "jpeg", quality=JPEG_QUALITY)
    return compressed.getvalue()
