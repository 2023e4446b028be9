"""Images of goals: their descriptions, and requests for their pixels."""

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from jezero.schemas.sensors import NO_DISTORTION, Distortion, FocalLength, Gnss, Imu, Pixel, model_of
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
    WithPixels,
)

LISTING = "images/images.json"
"""List of the images in the folder of a data set: each an `Image` and its `file`, which is beside the list."""
Index = Annotated[int, Meta(ge=0, le=100_000)]
QuatNedFromCamera = tuple[Unit, Unit, Unit, Unit]
"""Attitude [w, x, y, z] that turns the camera's right, down, forward into world NED, w >= 0."""


class Image(Payload, frozen=True, kw_only=True):
    """Description of one image of a goal. `GetImage` on `@action/<name>/image` requests its pixels.

    All values belong to the middle of the exposure and come from the vehicle's own estimate. In a result, the positions
    have moved along with the position resets since then.

    Attributes:
        index: number of the image among the planned ones, from 0.
        t_ns: vehicle time of the middle of the exposure.
        pos_uav_ned_m: position of the vehicle in world NED.
        q_ned_from_frd: attitude of the vehicle as a quaternion.
        yaw_rad: heading of the vehicle.
        pos_camera_ned_m: position of the camera's optical centre in world NED.
        q_ned_from_camera: attitude of the camera (right, down, forward) as a quaternion.
        position_camera_deg: latitude, longitude and altitude of the optical centre. None when the autopilot has not
            sent the position of the world frame's origin.
        pitch_camera_rad: pitch of the optical axis against the body's forward axis; -pi/2 points straight down.
        roll_camera_rad: roll of the pitch axis about the body's forward axis; positive turns the view to the left.
        exposure_s: duration of the exposure.
        width_px: width of the image.
        height_px: height of the image.
        focal_px: focal length across the image, and down it too where there is no `focal_y_px`.
        center_px: principal point: x to the right, y down, (0, 0) is the centre of the first pixel.
        distortion: the lens' coefficients, as in OpenCV: 5 of the model plumb_bob (all 0 for a pinhole), 8 of
            rational_polynomial, or 4 of equidistant.
        focal_y_px: focal length down the image, of a camera whose pixels are no squares; left out for another.
        range_m: range of the laser altimeter along the body's down axis. None when its beam met nothing.
        imu: IMU reading that is nearest in time. None without one.
        gnss: GNSS fix that is nearest in time. None without one.
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
    focal_px: FocalLength
    center_px: Pixel
    distortion: Distortion = NO_DISTORTION
    focal_y_px: FocalLength | UnsetType = UNSET
    range_m: NonNegative | None = None
    imu: Imu | None = None
    gnss: Gnss | None = None

    def __post_init__(self) -> None:
        model_of(self.distortion)

    @property
    def aspect(self) -> float:
        """Focal length down the image by that across it."""
        return 1.0 if self.focal_y_px is UNSET else self.focal_y_px / self.focal_px


class GetImage(Payload, frozen=True, kw_only=True):
    """Request for the pixels of one image of a goal.

    Attributes:
        goal_id: id of the goal.
        index: number of the image, from 0.
    """

    goal_id: Name
    index: Index


class ImageReply(Payload, WithPixels, frozen=True, kw_only=True):
    """Reply to `GetImage`.

    On Zenoh the pixels are the payload and everything else is its attachment, in JSON, as of a `CameraFrame`.

    Attributes:
        goal_id: id of the goal.
        index: number of the image, from 0.
        width_px: width of the image; 0 without one.
        height_px: height of the image; 0 without one.
        reason: reason why there is no image, for people.
        pixels: rows from the top, three bytes per pixel: red, green, blue.
    """

    goal_id: str = ""
    index: Index = 0
    width_px: Annotated[int, Meta(ge=0, le=8192)] = 0
    height_px: Annotated[int, Meta(ge=0, le=8192)] = 0
    reason: Text = ""
    pixels: bytes = b""
