"""The camera's images for the page, with the detected tags drawn in. They are read only while somebody looks."""

import asyncio
import io
import time
from collections import deque
from contextlib import suppress
from typing import Any

from jezero.aio import JezeroError, Vehicle
from jezero.schemas import topics
from jezero.schemas.estimate import Relative, TagEstimate
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.state import Odometry
from jezero.schemas.units import NS_PER_S
from jezero.services.ground_station.tag_marks import Pixel, tag_outlines
from jezero.vehicle_config import VehicleConfig

PICTURE_AGE_MAX_S = 2.0
LOOKER_TIMEOUT_S = 3.0
"""The camera's images are read until nobody has asked for one for this duration."""
JPEG_QUALITY = 75
MARK_AGE_MAX_NS = NS_PER_S // 4
"""Detections of an image that is older than this are not drawn into another one."""
ODOMETRY_KEPT = 32
GREEN = (61, 220, 132)


class CameraFeed:
    """The newest image of one vehicle's camera.

    Args:
        rate_hz: images per second that are compressed at most.
    """

    def __init__(self, vehicle: VehicleConfig, rate_hz: float) -> None:
        self._vehicle = vehicle
        self._period_s = 1.0 / rate_hz
        self._asked_s = 0.0
        self._reading: asyncio.Task[None] | None = None
        self._picture: tuple[float, bytes] | None = None
        self._odometry: deque[Odometry] = deque(maxlen=ODOMETRY_KEPT)
        self._tags: deque[TagEstimate] = deque(maxlen=1)
        self._relative: deque[Relative] = deque(maxlen=1)

    async def picture(self, uav: Vehicle) -> bytes | None:
        """The newest image as a JPEG; None when there is none of the last seconds."""
        self._asked_s = time.monotonic()
        if self._reading is None or self._reading.done():
            self._reading = asyncio.create_task(self._read(uav))
        if self._picture is None or time.monotonic() - self._picture[0] > PICTURE_AGE_MAX_S:
            return None
        return self._picture[1]

    def close(self) -> None:
        """End the task that reads the camera."""
        if self._reading is not None:
            self._reading.cancel()

    async def _read(self, uav: Vehicle) -> None:
        beside = [
            asyncio.create_task(_keep(uav, topics.ODOMETRY, self._odometry)),
            asyncio.create_task(_keep(uav, topics.ESTIMATE_TAG, self._tags)),
            asyncio.create_task(_keep(uav, topics.RELATIVE, self._relative)),
        ]
        try:
            with suppress(JezeroError):  # no camera, or no router: `picture` shows that there is no image
                await self._read_images(uav)
        finally:
            for task in beside:
                task.cancel()

    async def _read_images(self, uav: Vehicle) -> None:
        next_s = 0.0
        async with uav.subscribe(topics.CAMERA) as stream:
            while time.monotonic() - self._asked_s < LOOKER_TIMEOUT_S:
                frame = await stream.next(LOOKER_TIMEOUT_S)
                now_s = time.monotonic()
                if now_s >= next_s:
                    next_s = now_s + self._period_s
                    self._picture = (now_s, await asyncio.to_thread(_jpeg, frame, self._outlines(frame)))

    def _outlines(self, frame: CameraFrame) -> list[list[Pixel]]:
        """Corners of the tags that were detected at about the time of an image."""
        if not self._odometry or not self._tags or abs(self._tags[0].t_ns - frame.t_ns) > MARK_AGE_MAX_NS:
            return []
        yaw_rad = self._tags[0].yaw_rover_rad
        if yaw_rad is None:
            if not self._relative:
                return []
            yaw_rad = self._relative[0].yaw_rover_rad
        odometry = min(self._odometry, key=lambda kept: abs(kept.t_ns - frame.t_ns))
        angles_rad = (frame.pitch_camera_rad, frame.roll_camera_rad)
        camera, board = self._vehicle.camera, self._vehicle.platform.board
        return tag_outlines(self._tags[0], yaw_rad, odometry.q_ned_from_frd, angles_rad, camera, board)


async def _keep(uav: Vehicle, topic: Topic[Any], kept: deque[Any]) -> None:
    """Keep the newest messages of a topic."""
    with suppress(JezeroError):  # the connection was closed
        async with uav.subscribe(topic) as stream:
            async for message in stream:
                kept.append(message)


def _jpeg(frame: CameraFrame, outlines: list[list[Pixel]]) -> bytes:
    from PIL import Image, ImageDraw

    compressed = io.BytesIO()
    image = Image.frombytes("RGB", (frame.width_px, frame.height_px), frame.pixels)
    draw = ImageDraw.Draw(image)
    for corners in outlines:
        draw.line([*corners, corners[0]], fill=GREEN, width=3, joint="curve")
    image.save(compressed, "jpeg", quality=JPEG_QUALITY)
    return compressed.getvalue()
