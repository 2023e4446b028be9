"""Pictures that goals take, and what was known when each was exposed."""

from typing import Annotated

from msgspec import Meta

from jezero.schemas.sensors import Gnss, Imu, Pixel
from jezero.schemas.state import Geodetic
from jezero.schemas.struct import (
    Angle,
    Name,
    NonNegative,
    Payload,
    PositionNed,
    QuatNedFromFrd,
    Text,
    TimeNs,
    Unit,
    WithAttachment,
)

LISTING = "images/images.json"
"""In a dataset's folder, the list of its pictures: each an `Image` and its `file`, which is beside the list."""
Index = Annotated[int, Meta(ge=0, le=100_000)]
QuatNedFromCamera = tuple[Unit, Unit, Unit, Unit]
"""Attitude [w, x, y, z] that turns the camera's right, down, forward into world NED, w >= 0."""


class Image(Payload, frozen=True, kw_only=True):
    """One picture of a goal, without its pixels: `GetImage` asks for those.

    Everything is as of the middle of the exposure, by the vehicle's own estimate; in a result, positions have moved
    along with the world frame where the autopilot has corrected it since.

    Attributes:
        index: which of the planned pictures, from 0.
        q_ned_from_frd, yaw_rad: of the vehicle.
        pos_camera_ned_m: of the optical centre; position_camera_deg is the same on the globe, None when the
            autopilot hasn't told where the world's origin is.
        pitch_camera_rad, roll_camera_rad, focal_px, center_px: see `CameraFrame` and `CameraInfo`.
        range_m: of the laser altimeter along the body's down axis; None when it met nothing.
        imu, gnss: the nearest in time, which their `t_ns` tells; None when there was none.
    """

    index: Index
    t_ns: TimeNs
    pos_uav_ned_m: PositionNed
    q_ned_from_frd: QuatNedFromFrd
    yaw_rad: Angle
    pos_camera_ned_m: PositionNed
    q_ned_from_camera: QuatNedFromCamera
    position_camera_deg: Geodetic | None = None
    pitch_camera_rad: Angle
    roll_camera_rad: Angle = 0.0
    exposure_s: NonNegative
    width_px: Annotated[int, Meta(ge=1, le=8192)]
    height_px: Annotated[int, Meta(ge=1, le=8192)]
    focal_px: NonNegative
    center_px: Pixel
    range_m: NonNegative | None = None
    imu: Imu | None = None
    gnss: Gnss | None = None


class GetImage(Payload, frozen=True, kw_only=True):
    """Ask for the pixels of one picture of a goal."""

    goal_id: Name
    index: Index


class ImageReply(Payload, WithAttachment, frozen=True, kw_only=True):
    """One picture's pixels, or the reason why there are none.

    On Zenoh the pixels are the payload and everything else is its attachment, in JSON, as of a `CameraFrame`.

    Attributes:
        pixels: rows from the top, three bytes red, green, blue each.
    """

    goal_id: str = ""
    index: Index = 0
    width_px: Annotated[int, Meta(ge=0, le=8192)] = 0
    height_px: Annotated[int, Meta(ge=0, le=8192)] = 0
    reason: Text = ""
    pixels: bytes = b""
