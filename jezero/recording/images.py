"""Images of the camera in a recording: `foxglove.CompressedImage`, which viewers show."""

import base64
import io
from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple

import msgspec

from jezero.base.codec import decode, split_attachment
from jezero.recording import foxglove
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import CAMERA

HEADERS = "sensor/camera/header"
"""Channel of the images' other fields, as `CameraFrame` without pixels."""
CAMERA_FRAME = "camera"
"""Name of the frame of the images: right, down, forward of the camera."""
PNG_LEVEL = 1
"""Of zlib: the fastest."""


class ImageFormat(NamedTuple):
    """How images are compressed.

    Attributes:
        name: "jpeg" loses detail; "png" loses none, and takes about ten times the room.
        jpeg_quality: from 1 to 95.
    """

    name: Literal["jpeg", "png"] = "jpeg"
    jpeg_quality: int = 80


def split_image(
    data: bytes, image_format: ImageFormat | None, time_of: Callable[[int], int]
) -> Iterator[tuple[str, bytes]]:
    """Messages of an image, each (channel, encoded message): its other fields, and the compressed image.

    Args:
        data: the encoded `CameraFrame`.
        image_format: None for the other fields alone.
        time_of: gives the time on the recording's clock of a vehicle time.
    """
    header, pixels = split_attachment(data)
    yield HEADERS, header
    if pixels and image_format is not None:
        frame = decode(CameraFrame, data)
        yield CAMERA.name, compress(frame, time_of(frame.t_ns), image_format)


def compress(frame: CameraFrame, exposed_ns: int, image_format: ImageFormat) -> bytes:
    """The encoded `CompressedImage` of a frame that was exposed at a time on the recording's clock."""
    from PIL import Image

    compressed = io.BytesIO()
    image = Image.frombytes("RGB", (frame.width_px, frame.height_px), frame.pixels)
    image.save(compressed, image_format.name, quality=image_format.jpeg_quality, compress_level=PNG_LEVEL)
    return msgspec.json.encode(
        foxglove.CompressedImage(
            timestamp=foxglove.time_of(exposed_ns),
            frame_id=CAMERA_FRAME,
            data=base64.b64encode(compressed.getvalue()).decode(),
            format=image_format.name,
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
