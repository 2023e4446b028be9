"""Readings of the sensors. Ranges of values are those of the sensor, not those that are plausible in flight."""

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

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
    WithPixels,
    WithReadings,
)

PixelCoordinate = Annotated[float, Meta(ge=-1e5, le=1e5)]
Pixel = tuple[PixelCoordinate, PixelCoordinate]
"""(x, y) in an image: x to the right, y down, (0, 0) is the centre of the first pixel."""
FocalLength = Annotated[float, Meta(ge=1.0, le=1e6)]
"""Focal length in pixels."""
Coefficient = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Distortion = Annotated[tuple[Coefficient, ...], Meta(min_length=4, max_length=8)]
"""Coefficients of a lens, as OpenCV's calibration gives them; their number says which model they belong to.

plumb_bob: k1, k2, p1, p2, k3. rational_polynomial: k1, k2, p1, p2, k3, k4, k5, k6. equidistant, of fisheye lenses: k1,
k2, k3, k4. The names of the models are those of ROS.
"""
DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]
COEFFICIENTS: dict[DistortionModel, int] = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""Number of coefficients of each model."""
COEFFICIENT_MAX = 2.0
"""Largest coefficient of distortion, but not of the rational model: its numerator and denominator may both be large."""
NO_DISTORTION: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)


def model_of(distortion: Distortion) -> DistortionModel:
    """The model that coefficients belong to.

    Raises:
        ValueError: no model has so many, or one of them is larger than any lens'.
    """
    found = next((model for model, count in COEFFICIENTS.items() if count == len(distortion)), None)
    if found is None:
        raise ValueError(f"distortion has {len(distortion)} coefficients, expected 4, 5 or 8")
    if found != "rational_polynomial" and max(map(abs, distortion)) > COEFFICIENT_MAX:
        raise ValueError(f"distortion has a coefficient beyond {COEFFICIENT_MAX:g}: {list(distortion)}")
    return found


def shows_straight(distortion: Distortion) -> bool:
    """Whether a lens shows straight lines straight, as a pinhole does."""
    return len(distortion) != COEFFICIENTS["equidistant"] and not any(distortion)


class Imu(Message, frozen=True, kw_only=True):
    """Reading of the inertial measurement unit.

    Attributes:
        acc_imu_frd_mps2: specific force in body axes; at rest that against gravity, (0, 0, -9.81) on the Earth.
        gyro_imu_frd_rps: angular rates of the body.
    """

    acc_imu_frd_mps2: Vector
    gyro_imu_frd_rps: Vector


class Gnss(Message, frozen=True, kw_only=True):
    """One fix of the GNSS receiver.

    Attributes:
        position_deg: latitude, longitude and altitude.
        vel_uav_ned_mps: velocity over ground.
        std_horizontal_m: standard deviation of the horizontal position, as the receiver reports it.
        std_vertical_m: standard deviation of the altitude, as the receiver reports it.
        satellites: number of satellites in use.
        yaw_uav_rad: heading of the vehicle by two antennas on it; left out by a receiver with one.
    """

    position_deg: Geodetic
    vel_uav_ned_mps: VelocityNed
    std_horizontal_m: NonNegative
    std_vertical_m: NonNegative
    satellites: Annotated[int, Meta(ge=0, le=255)]
    yaw_uav_rad: Angle | UnsetType = UNSET


class Barometer(Message, frozen=True, kw_only=True):
    """Reading of the barometer.

    Attributes:
        pressure_pa: static pressure.
        altitude_pressure_m: altitude that has this pressure in the standard atmosphere, positive up.
        temperature_degc: temperature of the air.
    """

    pressure_pa: NonNegative
    altitude_pressure_m: Finite
    temperature_degc: Finite


class Magnetometer(Message, frozen=True, kw_only=True):
    """Reading of the magnetometer.

    Attributes:
        field_frd_gauss: magnetic field in body axes.
    """

    field_frd_gauss: Vector


class Altimeter(Message, frozen=True, kw_only=True):
    """Reading of the laser altimeter along the body's down axis.

    Attributes:
        range_m: distance from the lens to the ground or the platform. None when the beam met nothing within the
            sensor's limits; 0 never means an invalid range.
    """

    range_m: NonNegative | None = None


class UwbRange(Message, frozen=True, kw_only=True):
    """Range to one anchor, measured at its own time.

    Attributes:
        t_ns: vehicle time of the measurement.
        anchor: number of the anchor, from 0.
        pos_anchor_rover_body_m: position of the anchor on the rover.
        range_m: distance from the vehicle's UWB tag to the anchor.
    """

    anchor: Annotated[int, Meta(ge=0, le=63)]
    pos_anchor_rover_body_m: PositionNed
    range_m: NonNegative


class Uwb(Message, WithReadings, frozen=True, kw_only=True):
    """One round of UWB ranges.

    Attributes:
        ranges: ranges to the anchors; an anchor without a range is missing.
    """

    readings_field = "ranges"
    ranges: Annotated[tuple[UwbRange, ...], Meta(max_length=64)]


class RoverOdometry(Message, frozen=True, kw_only=True):
    """Odometry of the rover: dead reckoning from its start.

    Attributes:
        pos_odom_m: north and east distance from the rover's start, by its wheel odometry.
        yaw_rover_rad: heading in world NED, from the rover's compass.
        speed_rover_body_mps: speed along the heading; negative is backwards.
        yaw_rate_rover_rps: yaw rate, clockwise as seen from above.
        roll_rover_rad: roll of the platform, from the rover's IMU; 0 for a rover that doesn't measure it.
        pitch_rover_rad: pitch of the platform, as its roll.
    """

    pos_odom_m: tuple[Position, Position]
    yaw_rover_rad: Angle
    speed_rover_body_mps: Speed
    yaw_rate_rover_rps: Finite
    roll_rover_rad: Angle = 0.0
    pitch_rover_rad: Angle = 0.0


class CameraInfo(Message, frozen=True, kw_only=True):
    """Intrinsics and mounting of the ventral camera, on a pitch axis that a roll axis carries.

    Attributes:
        width_px: width of an image.
        height_px: height of an image.
        focal_px: focal length across the image, and down it too where there is no `focal_y_px`.
        center_px: principal point: x to the right, y down, (0, 0) is the centre of the first pixel.
        pos_camera_frd_m: position of the optical centre, which is on both axes, relative to the centre of mass.
        rate_hz: images per second.
        turn_camera_rad: how far the camera is turned about its optical axis, clockwise in the direction of view.
        distortion: the lens' coefficients, as in OpenCV: 5 of the model plumb_bob (all 0 for a pinhole), 8 of
            rational_polynomial, or 4 of equidistant.
        focal_y_px: focal length down the image, of a camera whose pixels are no squares; left out for another.
    """

    width_px: Annotated[int, Meta(ge=1, le=8192)]
    height_px: Annotated[int, Meta(ge=1, le=8192)]
    focal_px: FocalLength
    center_px: Pixel
    pos_camera_frd_m: PositionNed
    rate_hz: Annotated[float, Meta(ge=0.01, le=1e3)]
    turn_camera_rad: Angle = 0.0
    distortion: Distortion = NO_DISTORTION
    focal_y_px: FocalLength | UnsetType = UNSET

    def __post_init__(self) -> None:
        model_of(self.distortion)

    @property
    def aspect(self) -> float:
        """Focal length down the image by that across it."""
        return 1.0 if self.focal_y_px is UNSET else self.focal_y_px / self.focal_px


class CameraFrame(Message, WithPixels, frozen=True, kw_only=True, omit_defaults=True):
    """One image of the camera; `t_ns` is the middle of its exposure.

    On Zenoh the pixels are the payload and everything else is its attachment, in JSON.

    Attributes:
        sequence: number of the image, which grows by one each time.
        width_px: width of the image.
        height_px: height of the image.
        pitch_camera_rad: pitch of the optical axis against the body's forward axis; -pi/2 points straight down.
        roll_camera_rad: roll of the pitch axis about the body's forward axis; positive turns the view to the left.
        exposure_s: duration of the exposure.
        pixels: rows from the top, three bytes per pixel: red, green, blue. Empty in a flight log only.
    """

    sequence: Annotated[int, Meta(ge=0)]
    width_px: Annotated[int, Meta(ge=1, le=8192)]
    height_px: Annotated[int, Meta(ge=1, le=8192)]
    pitch_camera_rad: Angle
    roll_camera_rad: Angle = 0.0
    exposure_s: NonNegative
    pixels: bytes = b""


class CameraAttitude(Message, frozen=True, kw_only=True):
    """Measured angles of a real camera on a gimbal, as in `CameraFrame`; `t_ns` is the measurement's time."""

    pitch_camera_rad: Angle
    roll_camera_rad: Angle


JPEG_START = b"\xff\xd8\xff"
PREVIEW_MAX_BYTES = 18_000
"""Size of a preview. Two in a second are 288 kbit/s, so that a radio of 1 Mbit/s has room for all other topics."""


class CameraPreview(Message, WithAttachment, frozen=True, kw_only=True, omit_defaults=True):
    """A small picture of the camera, for people on another computer; `t_ns` is the middle of its exposure.

    On Zenoh the JPEG is the payload and everything else is its attachment, in JSON.

    Attributes:
        width_px: width of the picture.
        height_px: height of the picture.
        scale: pixels of the picture per pixel of the `CameraFrame` from which it was made, in both directions.
        pitch_camera_rad: pitch of the optical axis against the body's forward axis; -pi/2 points straight down.
        roll_camera_rad: roll of the pitch axis about the body's forward axis; positive turns the view to the left.
        jpeg: the picture as a JPEG file of up to `PREVIEW_MAX_BYTES`.
    """

    attached_field = "jpeg"
    width_px: Annotated[int, Meta(ge=1, le=8192)]
    height_px: Annotated[int, Meta(ge=1, le=8192)]
    scale: Annotated[float, Meta(gt=0.0, le=1.0)]
    pitch_camera_rad: Angle
    roll_camera_rad: Angle = 0.0
    jpeg: bytes = b""

    def check_attachment(self) -> None:
        """Raise ValueError where the attachment is no JPEG, or too large for a radio."""
        if not self.jpeg.startswith(JPEG_START):
            raise ValueError(f"the {len(self.jpeg)} bytes of the preview are no JPEG")
        if len(self.jpeg) > PREVIEW_MAX_BYTES:
            raise ValueError(f"a preview of {len(self.jpeg)} bytes is larger than {PREVIEW_MAX_BYTES}")


class CornersOfTag(Payload, frozen=True, kw_only=True):
    """Corners of one tag in an image.

    Attributes:
        tag_id: id of the tag in the family 36h11.
        corners_px: corners of the black square: top left, top right, bottom right, bottom left of the tag's own image.
    """

    tag_id: Annotated[int, Meta(ge=0, le=586)]
    corners_px: tuple[Pixel, Pixel, Pixel, Pixel]


class TagCorners(Message, WithReadings, frozen=True, kw_only=True):
    """Corners of the tags that a detector would find in an image that is not rendered; `t_ns` is the middle of its
    exposure.

    Attributes:
        pitch_camera_rad: pitch of the optical axis against the body's forward axis; -pi/2 points straight down.
        roll_camera_rad: roll of the pitch axis about the body's forward axis; positive turns the view to the left.
        tags: corners of each tag.
    """

    readings_field = "tags"
    pitch_camera_rad: Angle
    roll_camera_rad: Angle = 0.0
    tags: Annotated[tuple[CornersOfTag, ...], Meta(max_length=32)]
