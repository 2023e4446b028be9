"""Pictures of the vehicle's camera."""

import time

from jezero.client.errors import TimedOut, Unreachable
from jezero.client.session import Connection, decode
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import CAMERA


def next_picture(connection: Connection, timeout_s: float) -> CameraFrame:
    """The next picture that the camera takes.

    Raises:
        Unreachable: none comes in time.
        JezeroError: what comes is no picture.
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
            f"no picture of {connection.vehicle} within {timeout_s:g} s: does its camera run, in mode rendered? "
            "(`jezero ps`)"
        )
    frame: CameraFrame = decode(CameraFrame, data)
    return frame
