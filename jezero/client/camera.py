"""Images of the vehicle's camera."""

import time

from jezero.client.errors import TimedOut, Unreachable
from jezero.client.session import Connection, decode
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import CAMERA


def next_frame(connection: Connection, timeout_s: float) -> CameraFrame:
    """The next image that the camera publishes.

    Raises:
        Unreachable: no image comes within `timeout_s`.
        JezeroError: the message is not a valid image.
    """
    arrivals, undeclare = connection.subscribe(CAMERA)
    try:
        data = arrivals.take(time.monotonic() + timeout_s)
    except TimedOut:
        data = None
    finally:
        undeclare()
    if data is None:
        raise Unreachable(
            f"no image of {connection.vehicle} within {timeout_s:g} s: does its camera run in the mode rendered? "
            "(`jezero ps`)"
        )
    frame: CameraFrame = decode(CameraFrame, data)
    return frame
