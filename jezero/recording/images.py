"""Images of the camera in a recording: `foxglove.CompressedImage`, a JPEG that viewers show."""

import base64
import io
from typing import Any

import msgspec

from jezero.schemas.sensors import CameraFrame
from jezero.schemas.units import NS_PER_S

HEADERS = "sensor/camera/header"
"""Channel of the images' other fields, as `CameraFrame` without pixels."""
SCHEMA_NAME = "foxglove.CompressedImage"
JSON_SCHEMA = msgspec.json.encode(
    {
        "title": SCHEMA_NAME,
        "type": "object",
        "properties": {
            "timestamp": {
                "type": "object",
                "title": "time",
                "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
            },
            "frame_id": {"type": "string"},
            "data": {"type": "string", "contentEncoding": "base64"},
            "format": {"type": "string"},
        },
    }
)
"""Source: https://docs.foxglove.dev/docs/sdk/schemas/compressed-image"""


class CompressedImage(msgspec.Struct, frozen=True, kw_only=True):
    """One image as Foxglove has it.

    Attributes:
        timestamp: time of the image, {"sec": …, "nsec": …}.
        frame_id: name of the camera's frame.
        data: the JPEG, base64.
        format: "jpeg".
    """

    timestamp: dict[str, int]
    frame_id: str
    data: str
    format: str


def compress(frame: CameraFrame, logged_ns: int, quality: int) -> bytes:
    """The encoded `CompressedImage` of a frame."""
    from PIL import Image

    jpeg = io.BytesIO()
    image = Image.frombytes("RGB", (frame.width_px, frame.height_px), frame.pixels)
    image.save(jpeg, "JPEG", quality=quality)
    return msgspec.json.encode(
        CompressedImage(
            timestamp={"sec": logged_ns // NS_PER_S, "nsec": logged_ns % NS_PER_S},
            frame_id="camera",
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
        message = msgspec.json.decode(data, type=CompressedImage)
        with Image.open(io.BytesIO(base64.b64decode(message.data))) as image:
            return np.asarray(image.convert("RGB"))
    except (msgspec.DecodeError, OSError) as error:
        raise ValueError(str(error)) from None
