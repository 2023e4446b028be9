"""What the sensors measure. Ranges are what the sensor could report, not what is plausible in flight."""

from typing import Annotated

from msgspec import Meta

from jezero.schemas.state import Geodetic
from jezero.schemas.struct import (
    Angle,
    Finite,
    Message,
    NonNegative,
    Payload,
    Position,
    PositionNed,
    Speed,
    Vector,
    VelocityNed,
    WithAttachment,
)

Pixel = tuple[Finite, Finite]
"""(x, y) in the picture."""


class Imu(Message, frozen=True, kw_only=True):
    """Specific force and angular rate in body FRD; at rest acc_imu_frd_mps2 is (0, 0, -g)."""

    acc_imu_frd_mps2: Vector
    gyro_imu_frd_rps: Vector


class Gnss(Message, frozen=True, kw_only=True):
    """One fix. Standard deviations are the receiver's own claim."""

    position_deg: Geodetic
    vel_uav_ned_mps: VelocityNed
    std_horizontal_m: NonNegative
    std_vertical_m: NonNegative
    satellites: Annotated[int, Meta(ge=0, le=255)]


class Barometer(Message, frozen=True, kw_only=True):
    """Static pressure and the pressure altitude in the standard atmosphere, positive up."""

    pressure_pa: NonNegative
    altitude_pressure_m: Finite
    temperature_degc: Finite


class Magnetometer(Message, frozen=True, kw_only=True):
    """Magnetic field in body FRD."""

    field_frd_gauss: Vector


class Altimeter(Message, frozen=True, kw_only=True):
    """Laser range along the body's down axis.

    Attributes:
        range_m: None when the beam met nothing between the sensor's limits; never zero for "invalid".
    """

    range_m: NonNegative | None = None


class UwbRange(Message, frozen=True, kw_only=True):
    """Range to one anchor, at its own time; `pos_anchor_rover_body_m` is where the anchor is mounted."""

    anchor: Annotated[int, Meta(ge=0, le=63)]
    pos_anchor_rover_body_m: PositionNed
    range_m: NonNegative


class Uwb(Message, frozen=True, kw_only=True):
    """One round of ranges; an anchor that gave none is missing."""

    ranges: Annotated[tuple[UwbRange, ...], Meta(max_length=64)]


class RoverOdometry(Message, frozen=True, kw_only=True):
    """What the rover knows of itself: dead reckoning from where it started.

    Attributes:
        yaw_rover_rad: heading in world NED, from the rover's compass.
        pos_odom_m: (2,) north and east travelled since the rover's start by wheel odometry.
    """

    pos_odom_m: tuple[Position, Position]
    yaw_rover_rad: Angle
    speed_rover_body_mps: Speed
    yaw_rate_rover_rps: Finite


class CameraInfo(Message, frozen=True, kw_only=True):
    """The ventral camera: a pinhole without distortion, on a pitch axis that a roll axis carries.

    Attributes:
        focal_px, center_px: intrinsics; (0, 0) is the centre of the first pixel, x to the right and y down.
        pos_camera_frd_m: of the optical centre, which is on both axes, from the centre of mass.
    """

    width_px: Annotated[int, Meta(ge=1, le=8192)]
    height_px: Annotated[int, Meta(ge=1, le=8192)]
    focal_px: NonNegative
    center_px: tuple[Finite, Finite]
    pos_camera_frd_m: PositionNed
    rate_hz: NonNegative


class CameraFrame(Message, WithAttachment, frozen=True, kw_only=True, omit_defaults=True):
    """One picture; `t_ns` is the middle of its exposure.

    On Zenoh the pixels are the payload and everything else is its attachment, in JSON.

    Attributes:
        pitch_camera_rad: of the optical axis against the body's forward axis; -pi/2 looks straight down.
        roll_camera_rad: of the pitch axis about the body's forward axis; positive looks to the left.
        pixels: rows from the top, three bytes red, green, blue each. Only a flight's log leaves them out.
    """

    sequence: Annotated[int, Meta(ge=0)]
    width_px: Annotated[int, Meta(ge=1, le=8192)]
    height_px: Annotated[int, Meta(ge=1, le=8192)]
    pitch_camera_rad: Angle
    roll_camera_rad: Angle = 0.0
    exposure_s: NonNegative
    pixels: bytes = b""


class CornersOfTag(Payload, frozen=True, kw_only=True):
    """Corners of the black square: top left, top right, bottom right, bottom left of the tag's own picture."""

    tag_id: Annotated[int, Meta(ge=0, le=586)]
    corners_px: tuple[Pixel, Pixel, Pixel, Pixel]


class TagCorners(Message, frozen=True, kw_only=True):
    """Tags as a detector would have found them in a picture that nobody rendered; `t_ns` as in `CameraFrame`."""

    pitch_camera_rad: Angle
    roll_camera_rad: Angle = 0.0
    tags: Annotated[tuple[CornersOfTag, ...], Meta(max_length=32)]
