"""Images of the vehicle's camera."""

import time

from jezero.client.errors import JezeroError, TimedOut, Unreachable
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
    return decode_frame(data)


def decode_frame(data: bytes) -> CameraFrame:
    """Decode an image: its header in JSON, a line feed, and its RGB pixels.

    Raises:
        JezeroError: it is not a valid image.
    """
    header, _, pixels = data.partition(b"\n")
    frame: CameraFrame = decode(CameraFrame, header)
    if len(pixels) != 3 * frame.width_px * frame.height_px:
        raise JezeroError(f"{len(pixels)} bytes are not {frame.width_px} x {frame.height_px} pixels of three bytes")
    return CameraFrame(
        t_ns=frame.t_ns,
        sequence=frame.sequence,
        width_px=frame.width_px,
        height_px=frame.height_px,
        pitch_camera_rad=frame.pitch_camera_rad,
        roll_camera_rad=frame.roll_camera_rad,
        exposure_s=frame.exposure_s,
        pixels=pixels,
    )
