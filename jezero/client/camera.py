"""The vehicle's camera."""

from pathlib import Path

from jezero.client.errors import TimedOut, Unreachable
from jezero.client.png import png_of
from jezero.client.session import Connection
from jezero.client.subscription import Subscription
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import CAMERA


class Camera:
    """The camera of one vehicle, the attribute `Vehicle.camera`."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def frame(self, timeout_s: float = 3.0) -> CameraFrame:
        """The next image that the camera publishes, with its pixels.

        Raises:
            Unreachable: no image comes within `timeout_s`, or the connection was closed.
        """
        with Subscription(self._connection, CAMERA) as stream:
            try:
                return stream.next(timeout_s)
            except TimedOut:
                raise Unreachable(
                    f"no image of {self._connection.vehicle} within {timeout_s:g} s: does its camera run in the mode "
                    "rendered? (`jezero ps`)"
                ) from None

    def snap(self, file: Path | str, timeout_s: float = 3.0) -> CameraFrame:
        """Save the next image as a PNG file, and return it.

        Raises:
            Unreachable: no image comes within `timeout_s`, or the connection was closed.
            OSError: the file can't be written.
        """
        frame = self.frame(timeout_s)
        Path(file).write_bytes(png_of(frame.width_px, frame.height_px, frame.pixels))
        return frame
