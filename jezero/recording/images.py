"""Images of the camera in a recording: `foxglove.CompressedImage`, a JPEG that viewers show."""

import base64
import io
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from jezero.codec import decode, split_attachment
from jezero.recording import foxglove
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import CAMERA

HEADERS = "sensor/camera/header"
"""Channel of the images' other fields, as `CameraFrame` without pixels."""
CAMERA_FRAME = "camera"
"""Name of the frame of the images: right, down, forward of the camera."""


def split_image(data: bytes, quality: int | None, time_of: Callable[[int], int]) -> Iterator[tuple[str, bytes]]:
    """Messages of an image, each (channel, encoded message): its other fields, and the JPEG.

    Args:
        data: the encoded `CameraFrame`.
        quality: of the JPEG from 1 to 95; None for no JPEG.
        time_of: gives the time on the recording's clock of a vehicle time.
    """
    header, pixels = split_attachment(data)
    yield HEADERS, header
    if pixels and quality is not None:
        frame = decode(CameraFrame, data)
        yield CAMERA.name, compress(frame, time_of(frame.t_ns), quality)


def compress(frame: CameraFrame, exposed_ns: int, quality: int) -> bytes:
    """The encoded `CompressedImage` of a frame that was exposed at a time on the recording's clock."""
    from PIL import Image

    jpeg = io.BytesIO()
    image = Image.frombytes("RGB", (frame.width_px, frame.height_px), frame.pixels)
    image.save(jpeg, "JPEG", quality=quality)
    return msgspec.json.encode(
        foxglove.CompressedImage(
            timestamp=foxglove.time_of(exposed_ns),
            frame_id=CAMERA_FRAME,
            data=base64.b64encode(jpeg.getvalue()).decode(),
            format="jpeg",
        )
    )


def decompress(data: bytes) -> Any:
    """(height, width, 3) array of red, green and blue from an encoded `CompressedImage`.

    Raises:
        ValueError: the message or its image is damaged.
    """
    import numpy as np
    from PIL import Image

    try:
        message = msgspec.json.decode(data, type=foxglove.CompressedImage)
        with Image.open(io.BytesIO(base64.b64decode(message.data))) as image:
            return np.asarray(image.convert("RGB"))
    except (msgspec.DecodeError, OSError) as error:
        raise ValueError(str(error)) from None
