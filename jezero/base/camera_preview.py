"""The preview of a camera's frame: a small JPEG that a radio carries. Every driver of a camera publishes it."""

import io
from typing import Any

from jezero.schemas.sensors import PREVIEW_MAX_BYTES, CameraFrame, CameraPreview
from jezero.schemas.topics import CAMERA_PREVIEW
from jezero.schemas.units import NS_PER_S

PREVIEW_PERIOD_NS = int(NS_PER_S / (CAMERA_PREVIEW.rate_hz or 1.0))
FRAME_TIMEOUT_S = 2.0
"""Without an image for this duration, a preview is shown or saved in its place. Images don't leave the vehicle's
computer; even the slowest renderer makes several in this time."""
SIDE_MAX_PX = 480
"""Longer side of a preview. Simulated ground, with its stones, fits into `PREVIEW_MAX_BYTES` in quality 45 or 60; a
picture of 320 px shows less of it, in whatever quality."""
QUALITIES = (60, 45, 30)
"""Qualities of the JPEG; the first one that makes the picture small enough is taken."""
SHRINKING = 0.7
"""Factor of the sides of a picture that is too large in all qualities."""


def preview_of(frame: CameraFrame) -> CameraPreview:
    """The preview of a frame; its JPEG has `PREVIEW_MAX_BYTES` or less, whatever the frame shows."""
    from PIL import Image

    image = Image.frombytes("RGB", (frame.width_px, frame.height_px), frame.pixels)
    scale = min(1.0, SIDE_MAX_PX / max(image.size))
    while True:
        size_px = (max(1, round(scale * frame.width_px)), max(1, round(scale * frame.height_px)))
        small = image if size_px == image.size else image.resize(size_px, Image.Resampling.HAMMING)
        for quality in QUALITIES:
            jpeg = _jpeg(small, quality)
            if len(jpeg) <= PREVIEW_MAX_BYTES:
                return CameraPreview(
                    t_ns=frame.t_ns,
                    width_px=small.width,
                    height_px=small.height,
                    scale=scale,
                    pitch_camera_rad=frame.pitch_camera_rad,
                    roll_camera_rad=frame.roll_camera_rad,
                    jpeg=jpeg,
                )
        scale *= SHRINKING


def _jpeg(image: Any, quality: int) -> bytes:
    compressed = io.BytesIO()
    image.save(compressed, "jpeg", quality=quality, optimize=True)
    return compressed.getvalue()
