"""The vehicle's camera."""

import io
from pathlib import Path
from typing import TypeVar

from jezero.base.camera_preview import FRAME_TIMEOUT_S
from jezero.client.errors import JezeroError, TimedOut, Unreachable
from jezero.client.png import png_file, png_of
from jezero.client.session import Connection
from jezero.client.subscription import Subscription
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame, CameraPreview
from jezero.schemas.struct import Message
from jezero.schemas.topics import CAMERA, CAMERA_PREVIEW

M = TypeVar("M", bound=Message)


class Camera:
    """The camera of one vehicle, the attribute `Vehicle.camera`."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def frame(self, timeout_s: float = 3.0) -> CameraFrame:
        """The next image that the camera publishes, with its pixels; on the vehicle's own computer only.

        Raises:
            Unreachable: no image comes within `timeout_s`, or the connection was closed.
        """
        frame = self._next(CAMERA, timeout_s)
        if frame is None:
            hint = "On another computer than the vehicle's there are previews only."
            raise Unreachable(f"{self._silence('image', timeout_s)} {hint}")
        return frame

    def preview(self, timeout_s: float = 3.0) -> CameraPreview:
        """The next preview: a small picture as a JPEG, which also reaches other computers.

        Raises:
            Unreachable: no preview comes within `timeout_s`, or the connection was closed.
        """
        preview = self._next(CAMERA_PREVIEW, timeout_s)
        if preview is None:
            raise Unreachable(self._silence("preview", timeout_s))
        return preview

    def snap(self, file: Path | str, timeout_s: float = 3.0) -> CameraFrame | CameraPreview:
        """Save the next image as a PNG file, and return it; its preview where no image comes for two seconds.

        Args:
            file: the file, whose name ends with .png.
            timeout_s: longest wait for the image, of up to two seconds, and then for the preview.

        Raises:
            Unreachable: neither comes within `timeout_s`, or the connection was closed.
            JezeroError: there is a preview only, and no library that reads it.
            OSError: the file can't be written.
            ValueError: its name has another ending.
        """
        path = png_file(file)
        frame = self._next(CAMERA, min(timeout_s, FRAME_TIMEOUT_S))
        if frame is not None:
            path.write_bytes(png_of(frame.width_px, frame.height_px, frame.pixels))
            return frame
        preview = self._next(CAMERA_PREVIEW, timeout_s)
        if preview is None:
            raise Unreachable(self._silence("image and no preview", timeout_s))
        path.write_bytes(_png_of_jpeg(preview.jpeg))
        return preview

    def _next(self, topic: Topic[M], timeout_s: float) -> M | None:
        """The next message, or None if there is none in time."""
        with Subscription(self._connection, topic) as stream:
            try:
                return stream.next(timeout_s)
            except TimedOut:
                return None

    def _silence(self, what: str, timeout_s: float) -> str:
        hint = "does its camera run in the mode rendered? (`jezero ps`)"
        return f"no {what} of {self._connection.vehicle} within {timeout_s:g} s: {hint}"


def _png_of_jpeg(jpeg: bytes) -> bytes:
    try:
        from PIL import Image
    except ModuleNotFoundError:
        raise JezeroError(
            "only a preview of the camera reaches this computer, and saving it as PNG needs Pillow: "
            "pip install 'jezero[cli]', or write the field jpeg of `camera.preview()` to a file"
        ) from None
    converted = io.BytesIO()
    with Image.open(io.BytesIO(jpeg)) as image:
        image.save(converted, "png")
    return converted.getvalue()
