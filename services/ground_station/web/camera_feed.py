"""The camera's images for the page, with the detected tags drawn in. They are read only while somebody looks.

Images are too large for a radio and don't leave the vehicle's computer. A ground station on another computer shows the
camera's previews in their place.
"""

import asyncio
import io
import time
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from jezero.aio import JezeroError, TimedOut, Vehicle
from jezero.base.camera_preview import FRAME_TIMEOUT_S
from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    q_frd_from_camera,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    rotate_yaw,
    subtract,
)
from jezero.base.lens import distort
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.schemas import topics
from jezero.schemas.estimate import Relative, TagEstimate
from jezero.schemas.landing_board import BoardTag
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame, CameraPreview
from jezero.schemas.state import Odometry
from jezero.schemas.units import NS_PER_S

PICTURE_AGE_MAX_S = 2.0
RETRY_S = 0.2
LOOKER_TIMEOUT_S = 3.0
"""The camera's images are read until nobody has asked for one for this duration."""
JPEG_QUALITY = 75
MARK_AGE_MAX_NS = NS_PER_S // 4
"""Detections of an image that is older than this are not drawn into another one."""
ODOMETRY_KEPT = 32
GREEN = (61, 220, 132)
RANGE_MIN_M = 0.02
Pixel = tuple[float, float]


class CameraFeed:
    """The newest image of one vehicle's camera.

    Args:
        rate_hz: images per second that are compressed at most.

    Attributes:
        shows_previews: whether the newest image is a preview, because the camera's images don't arrive here.
    """

    def __init__(self, vehicle: VehicleConfig, rate_hz: float) -> None:
        self.shows_previews = False
        self._vehicle = vehicle
        self._period_s = 1.0 / rate_hz
        self._asked_s = self._frame_s = 0.0
        """Times at which a page asked for an image, and at which one arrived from the camera, or reading began."""
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
        self._frame_s = 0.0 if self.shows_previews else time.monotonic()  # else each look would begin with a wait
        beside = [
            asyncio.create_task(self._read_previews(uav)),
            asyncio.create_task(_keep(uav, topics.ODOMETRY, self._odometry)),
            asyncio.create_task(_keep(uav, topics.ESTIMATE_TAG, self._tags)),
            asyncio.create_task(_keep(uav, topics.RELATIVE, self._relative)),
        ]
        try:
            with suppress(JezeroError):  # no camera, or no router: `picture` shows that there is no image
                await self._read_frames(uav)
        finally:
            for task in beside:
                task.cancel()

    async def _read_frames(self, uav: Vehicle) -> None:
        """Read the camera's images until nobody looks any more."""
        next_s = 0.0
        async with uav.subscribe(topics.CAMERA) as stream:
            while time.monotonic() - self._asked_s < LOOKER_TIMEOUT_S:
                try:
                    frame = await stream.next(FRAME_TIMEOUT_S)
                except TimedOut:
                    continue
                self._frame_s = now_s = time.monotonic()
                self.shows_previews = False
                if now_s >= next_s:
                    next_s = now_s + self._period_s
                    self._picture = (now_s, await asyncio.to_thread(_marked_frame, frame, self._outlines(frame)))

    async def _read_previews(self, uav: Vehicle) -> None:
        """Read the camera's previews while no image arrives."""
        with suppress(JezeroError):  # the connection was closed
            while True:
                await asyncio.sleep(RETRY_S)
                if self._frames_are_silent():
                    await self._read_previews_until_frame(uav)

    async def _read_previews_until_frame(self, uav: Vehicle) -> None:
        async with uav.subscribe(topics.CAMERA_PREVIEW) as stream:
            while self._frames_are_silent():
                try:
                    preview = await stream.next(FRAME_TIMEOUT_S)
                    marked = await asyncio.to_thread(_marked_preview, preview, self._outlines(preview))
                except (JezeroError, OSError):  # none in time, not valid, or the JPEG is damaged
                    await asyncio.sleep(RETRY_S)
                    continue
                if self._frames_are_silent():
                    self._picture, self.shows_previews = (time.monotonic(), marked), True

    def _frames_are_silent(self) -> bool:
        return time.monotonic() - self._frame_s > FRAME_TIMEOUT_S

    def _outlines(self, frame: CameraFrame | CameraPreview) -> list[list[Pixel]]:
        """Corners, in pixels of a whole image, of the tags that were detected at about the time of an image."""
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


def _marked_frame(frame: CameraFrame, outlines: list[list[Pixel]]) -> bytes:
    """An image as a JPEG with outlines."""
    from PIL import Image

    return _marked(Image.frombytes("RGB", (frame.width_px, frame.height_px), frame.pixels), outlines, width_px=3)


def _marked_preview(preview: CameraPreview, outlines: list[list[Pixel]]) -> bytes:
    """A preview with outlines, which are in pixels of a whole image; as it is, if there are none."""
    from PIL import Image

    if not outlines:
        return preview.jpeg
    scale = preview.scale
    scaled = [[(scale * (x + 0.5) - 0.5, scale * (y + 0.5) - 0.5) for x, y in corners] for corners in outlines]
    with Image.open(io.BytesIO(preview.jpeg)) as image:
        return _marked(image.convert("RGB"), scaled, width_px=2)


def _marked(image: Any, outlines: list[list[Pixel]], width_px: int) -> bytes:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(image)
    for corners in outlines:
        draw.line([*corners, corners[0]], fill=GREEN, width=width_px, joint="curve")
    compressed = io.BytesIO()
    image.save(compressed, "jpeg", quality=JPEG_QUALITY)
    return compressed.getvalue()


def tag_outlines(
    estimate: TagEstimate,
    yaw_rover_rad: float,
    q_ned_from_frd: Quat,
    angles_rad: tuple[float, float],
    camera: CameraMountConfig,
    board: Iterable[BoardTag],
) -> list[list[Pixel]]:
    """Corners of each detected tag in the image, (x, y) in pixels.

    Args:
        estimate: the detector's pose, of the time of the image.
        yaw_rover_rad: heading of the platform, which is taken as level.
        q_ned_from_frd: attitude of the vehicle at the time of the image.
        angles_rad: pitch and roll of the camera in the image.
        camera: optics and mounting of the camera.
        board: all tags of the platform.

    Returns:
        A list of four corners for each tag that is in front of the camera as a whole.
    """
    q_ned_from_camera = quat_multiply(q_ned_from_frd, q_frd_from_camera(*angles_rad, camera.turn_rad))
    pos_camera_m = add(estimate.pos_uav_rel_rover_ned_m, quat_rotate(q_ned_from_frd, camera.pos_camera_frd_m))
    outlines = []
    for tag in board:
        if tag.tag_id not in estimate.tag_ids:
            continue
        corners = [
            _pixel(subtract(rotate_yaw(corner_m, yaw_rover_rad), pos_camera_m), q_ned_from_camera, camera)
            for corner_m in tag.corners_rover_body_m
        ]
        seen = [corner for corner in corners if corner is not None]
        if len(seen) == len(corners):
            outlines.append(seen)
    return outlines


def _pixel(ray_ned_m: Vec3, q_ned_from_camera: Quat, camera: CameraMountConfig) -> Pixel | None:
    """Pixel of a point relative to the camera; None for one behind it or outside what the lens shows."""
    right_m, down_m, forward_m = quat_rotate(quat_conjugate(q_ned_from_camera), ray_ned_m)
    if forward_m < RANGE_MIN_M:
        return None
    x, y = distort(np.array([right_m / forward_m, down_m / forward_m]), camera.distortion, camera.aspect)
    if not (np.isfinite(x) and np.isfinite(y)):
        return None
    center_x, center_y = camera.center_px
    return float(center_x + camera.focal_px * x), float(center_y + camera.focal_px * y)
