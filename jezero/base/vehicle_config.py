"""The robot: vehicle, rover platform, and what is mounted on both, read from `deploy/config/vehicle.toml`.

Services take what they need of it and keep no copy. Frames: `frd` is the vehicle's body, forward, right, down, with
its origin in the centre of mass; `rover_body` has its origin in the middle of the platform's surface, forward, right,
down. The errors of the sensors and the simulated world are in the services' own settings.
"""

from math import hypot, radians, sqrt, tan
from typing import Annotated, Literal, NamedTuple

from msgspec import UNSET, Meta

from jezero.base.config import Config
from jezero.base.frames import Vec3, subtract
from jezero.schemas.landing_board import BoardTag, board_refusal, make_board
from jezero.schemas.sensors import (
    COEFFICIENTS,
    NO_DISTORTION,
    CameraInfo,
    Distortion,
    DistortionModel,
    FocalLength,
    PixelCoordinate,
    model_of,
    shows_straight,
)

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Mounting = Annotated[float, Meta(ge=-10.0, le=10.0)]
Place = tuple[Mounting, Mounting, Mounting]

TILT_STEADY_RAD = 0.55
"""Tilt of a steady flight against the wind; an autopilot allows a few degrees more, for gusts."""
PITCH_DOWN_RAD = -1.5708
"""Pitch of a camera that points straight down, as `command/camera_pitch` limits it."""

ORDERS: dict[DistortionModel, tuple[str, ...]] = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
"""Coefficients of each model of a lens, in their order."""


class CameraMountConfig(Config, frozen=True, kw_only=True):
    """The ventral camera, on a pitch axis that a roll axis carries.

    Attributes:
        width_px: width of an image.
        height_px: height of an image.
        field_of_view_deg: angle of view across the image's width, of a camera without a calibration: its pixels are
            squares, and its optical axis meets the image's middle.
        fx_px: focal length across the image, by a calibration; then the four have to be given together, and
            `field_of_view_deg` does not count.
        fy_px: focal length down the image.
        cx_px: principal point from the left; 0 is the centre of the first pixel.
        cy_px: principal point from the top.
        rate_hz: images per second.
        pos_camera_frd_m: position of the optical centre.
        pitch_offset_rad: pitch of the camera at rest, from straight down; positive points ahead, negative points back.
        roll_offset_rad: roll of the camera at rest, about the body's forward axis; positive points to the left.
        turn_rad: how far the camera is turned about its optical axis, clockwise in the direction of view; at 0 the top
            of an image is ahead.
        gimbal: what turns a real camera: `fixed` for nothing, so that the angles at rest hold; `mavlink` for a gimbal
            that the flight controller manages. The simulated camera turns in any case.
        distortion_model: model of the lens, by ROS' name.
        distortion: the lens' coefficients, as OpenCV's calibration gives them: k1, k2, p1, p2, k3 of plumb_bob; k1, k2,
            p1, p2, k3, k4, k5, k6 of rational_polynomial; k1, k2, k3, k4 of equidistant.

    Raises:
        ValueError: such a lens would show nothing in the image's corners; or the model has another number of
            coefficients; or a part of the calibration is missing.
    """

    width_px: Annotated[int, Meta(ge=16, le=4096)] = 640
    height_px: Annotated[int, Meta(ge=16, le=4096)] = 480
    field_of_view_deg: Annotated[float, Meta(gt=1.0, le=150.0)] = 80.0
    fx_px: FocalLength | None = None
    fy_px: FocalLength | None = None
    cx_px: PixelCoordinate | None = None
    cy_px: PixelCoordinate | None = None
    rate_hz: Annotated[float, Meta(gt=0.0, le=60.0)] = 15.0
    pos_camera_frd_m: Place = (0.0, 0.0, 0.03)
    pitch_offset_rad: Annotated[float, Meta(ge=-0.8, le=1.5708)] = 0.0
    roll_offset_rad: Annotated[float, Meta(ge=-0.8, le=0.8)] = 0.0
    turn_rad: Annotated[float, Meta(ge=-3.1416, le=3.1416)] = 0.0
    gimbal: Literal["fixed", "mavlink"] = "fixed"
    distortion_model: DistortionModel = "plumb_bob"
    distortion: Distortion = NO_DISTORTION

    def __post_init__(self) -> None:
        given = [self.fx_px, self.fy_px, self.cx_px, self.cy_px]
        if None in given and any(value is not None for value in given):
            raise ValueError("fx_px, fy_px, cx_px and cy_px are one calibration: give all four, or none")
        count = COEFFICIENTS[self.distortion_model]
        if len(self.distortion) != count:
            found = len(self.distortion)
            raise ValueError(f"distortion_model {self.distortion_model} has {count} coefficients, not {found}")
        model_of(self.distortion)
        if shows_straight(self.distortion):
            return
        from jezero.base.lens import image_radius  # numpy, which most services start faster without

        center_x_px, center_y_px = self.center_px
        right_px = max(center_x_px + 0.5, self.width_px - 0.5 - center_x_px)
        down_px = max(center_y_px + 0.5, self.height_px - 0.5 - center_y_px)
        corner_radius = hypot(right_px, down_px / self.aspect) / self.focal_px
        share = image_radius(self.distortion) / corner_radius
        if share < 1.0:
            order = ", ".join(ORDERS[self.distortion_model])
            if self.distortion_model == "equidistant":
                order += ", and that no corner is 89 degrees or more from the optical axis"
            raise ValueError(
                f"a lens with distortion {list(self.distortion)} shows nothing beyond {100.0 * share:.0f} % of the way "
                f"to the image's corners: check the order {order}"
            )

    @property
    def focal_px(self) -> float:
        """Focal length across the image."""
        return 0.5 * self.width_px / tan(0.5 * radians(self.field_of_view_deg)) if self.fx_px is None else self.fx_px

    @property
    def aspect(self) -> float:
        """Focal length down the image by that across it."""
        return 1.0 if self.fx_px is None or self.fy_px is None else self.fy_px / self.fx_px

    @property
    def center_px(self) -> tuple[float, float]:
        """Principal point; (0, 0) is the centre of the first pixel."""
        if self.cx_px is None or self.cy_px is None:
            return (0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1))
        return (self.cx_px, self.cy_px)

    @property
    def is_plain(self) -> bool:
        """Whether it is a pinhole with square pixels whose optical axis meets the image's middle."""
        return self.fx_px is None and shows_straight(self.distortion)

    @property
    def pitch_rest_rad(self) -> float:
        """Pitch of the optical axis against the body's forward axis while nobody commands the camera's axes."""
        return PITCH_DOWN_RAD + self.pitch_offset_rad

    def info(self, t_ns: int) -> CameraInfo:
        """Description of the camera, as it publishes it."""
        return CameraInfo(
            t_ns=t_ns,
            width_px=self.width_px,
            height_px=self.height_px,
            focal_px=self.focal_px,
            center_px=self.center_px,
            pos_camera_frd_m=self.pos_camera_frd_m,
            rate_hz=self.rate_hz,
            turn_camera_rad=self.turn_rad,
            distortion=self.distortion,
            focal_y_px=UNSET if self.aspect == 1.0 else self.aspect * self.focal_px,
        )


class AirframeConfig(Config, frozen=True, kw_only=True):
    """A quadrotor of the size of an Iris, with the rotor positions of PX4's airframe 10016.

    Attributes:
        mass_kg: mass at take-off.
        inertia_frd_kgm2: principal moments of inertia.
        pos_rotors_frd_m: forward and right position of each rotor, in the autopilot's order.
        moment_per_thrust_m: yaw moment of each rotor per newton of its thrust, positive to the right.
        radius_rotor_m: radius of each rotor.
        height_stand_m: height of the centre of mass when the vehicle stands.
        feet_frd_m: forward and right position of the front right foot; the four feet are symmetric.
        drag_rotors_nspm: drag in the rotors' plane per m/s of airspeed, in hover; it grows with the rotors' speed. When
            this and `drag_area_side_m2` are 0, the wind stays unknown.
        drag_area_side_m2: drag area of the body seen from the side, drag coefficient included.
        drag_area_top_m2: drag area of the body seen from above, drag coefficient included.
        hull_half_frd_m: half lengths of the hull, a box about the centre of mass that the simulation collides with.
        rotor_plane_half_frd_m: half lengths, forward and to the right, of the flat box of arms and rotors above it.
    """

    mass_kg: Positive = 1.5
    inertia_frd_kgm2: tuple[Positive, Positive, Positive] = (0.029, 0.029, 0.055)
    pos_rotors_frd_m: tuple[
        tuple[Mounting, Mounting], tuple[Mounting, Mounting], tuple[Mounting, Mounting], tuple[Mounting, Mounting]
    ] = ((0.1515, 0.245), (-0.1515, -0.1875), (0.1515, -0.245), (-0.1515, 0.1875))
    moment_per_thrust_m: tuple[Mounting, Mounting, Mounting, Mounting] = (0.05, 0.05, -0.05, -0.05)
    radius_rotor_m: Positive = 0.128
    height_stand_m: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.148
    feet_frd_m: tuple[Positive, Positive] = (0.13, 0.16)
    drag_rotors_nspm: NonNegative = 0.45
    drag_area_side_m2: NonNegative = 0.06
    drag_area_top_m2: NonNegative = 0.1

    hull_half_frd_m: tuple[Positive, Positive, Positive] = (0.17, 0.13, 0.03)
    rotor_plane_half_frd_m: tuple[Positive, Positive] = (0.27, 0.33)


GRAVITY_EARTH_MPS2 = 9.81
"""Gravity that PX4 assumes, and for which the constants of services are chosen; see `PlanetConfig.gravity_ratio`."""


HeadingSource = Literal["magnetometer", "gnss"]


class PlanetConfig(Config, frozen=True, kw_only=True):
    """Where the robot is: what every service has to know of it.

    Attributes:
        gravity_mps2: gravitational acceleration. PX4 assumes 9.81.
        density_air_kgpm3: density of the air.
        pressure_datum_pa: static pressure of the air at the altitude 0.
        scale_height_m: height in which the pressure falls by the factor e, of an atmosphere with one temperature;
            without it the pressure is that of the Earth's standard atmosphere.
    """

    gravity_mps2: Annotated[float, Meta(gt=0.0, le=100.0)] = GRAVITY_EARTH_MPS2
    density_air_kgpm3: Positive = 1.2
    pressure_datum_pa: Positive = 101_325.0
    scale_height_m: Positive | None = None

    @property
    def gravity_ratio(self) -> float:
        """Gravity relative to the Earth's. At the same tilt a multicopter accelerates in proportion to it."""
        return self.gravity_mps2 / GRAVITY_EARTH_MPS2


class AltimeterMountConfig(Config, frozen=True, kw_only=True):
    """The laser altimeter, whose narrow beam points along the body's down axis.

    Attributes:
        pos_altimeter_frd_m: position of the lens.
        range_min_m: smallest range that it measures.
        range_max_m: greatest range that it measures.
    """

    pos_altimeter_frd_m: Place = (0.0, 0.0, 0.05)
    range_min_m: NonNegative = 0.15
    range_max_m: Positive = 10.0


class UwbLayoutConfig(Config, frozen=True, kw_only=True):
    """The vehicle's UWB tag, and the anchors on the rover.

    Attributes:
        pos_tag_frd_m: position of the UWB tag's antenna.
        pos_anchors_rover_body_m: positions of the anchors: three or more, not all on one line.
        id_anchors: ids of the anchors' modules, in the order of their positions, for the driver of a real UWB module;
            empty for none.
        range_max_m: greatest range that is measured.

    Raises:
        ValueError: not one id for each position, or two anchors have one id.
    """

    pos_tag_frd_m: Place = (0.0, 0.0, 0.05)
    pos_anchors_rover_body_m: Annotated[tuple[Place, ...], Meta(min_length=3, max_length=64)] = (
        (0.45, 0.45, 0.0),
        (0.45, -0.45, 0.0),
        (-0.45, -0.45, 0.0),
        (-0.45, 0.45, 0.0),
    )
    id_anchors: tuple[Annotated[str, Meta(min_length=1, max_length=32)], ...] = ()
    range_max_m: Positive = 15.0

    def __post_init__(self) -> None:
        ids, places = self.id_anchors, self.pos_anchors_rover_body_m
        if ids and len(ids) != len(places):
            raise ValueError(f"id_anchors has {len(ids)} ids, pos_anchors_rover_body_m {len(places)} positions")
        if len({each.upper() for each in ids}) != len(ids):
            raise ValueError("two anchors have one id in id_anchors")


PLATFORM_THICKNESS_M = 0.06
"""Thickness of the platform's slab in the simulated world, and in pictures of it."""


class PlatformConfig(Config, frozen=True, kw_only=True):
    """The rover's landing platform, level and square, with the AprilTags on it.

    Attributes:
        side_m: length of each side.
        height_m: height of the surface over the ground at the rover's middle.
        side_tag_m: side of the landing board's big tag; the small tags scale with it.
        tags: all tags of a board that is not the landing board; empty for the landing board.

    Raises:
        ValueError: a tag reaches beyond the platform, or two tags have one id.
    """

    side_m: Positive = 1.0
    height_m: Annotated[float, Meta(ge=0.2, le=5.0)] = 0.5
    side_tag_m: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.6
    tags: Annotated[tuple[BoardTag, ...], Meta(max_length=32)] = ()

    def __post_init__(self) -> None:
        refusal = board_refusal(self.board, self.side_m)
        if refusal:
            raise ValueError(refusal)

    @property
    def board(self) -> tuple[BoardTag, ...]:
        """All tags, in the order in which they are painted."""
        return self.tags or make_board(self.side_tag_m)


class VehicleLimitsConfig(Config, frozen=True, kw_only=True):
    """Limits of every goal and of hover points. Of setpoints the bridge holds the upper ones, 2 m and 2 m/s beyond.

    Attributes:
        altitude_min_m: minimum height above the world's origin; of a takeoff above the take-off point; of a goal in the
            rover's frame above the platform. A landing alone leads lower.
        altitude_max_m: maximum height above the world's origin; of a takeoff above the take-off point.
        distance_max_m: maximum horizontal distance from the world's origin.
        speed_max_mps: maximum speed of a goal.
        braking_mps2: deceleration in front of the fence and of these limits: that of planned ways, and less than the
            greatest tilt leaves in gusts, 1.3 m/s² in those of 11 m/s in the Earth's gravity.
    """

    altitude_min_m: Annotated[float, Meta(gt=0.0, le=1e4)] = 0.5
    altitude_max_m: Annotated[float, Meta(gt=0.0, le=1e4)] = 120.0
    distance_max_m: Annotated[float, Meta(gt=0.0, le=1e4)] = 500.0
    speed_max_mps: Annotated[float, Meta(gt=0.0, le=100.0)] = 10.0
    braking_mps2: Annotated[float, Meta(gt=0.0, le=10.0)] = 1.0


CRITICAL_MARGIN = 0.01
"""Fraction of the capacity above the critical level at which a landing is over before the autopilot intervenes."""
LEAST_USE = 0.5
"""Fraction of the declared use of the battery in hover that every flight uses."""


class BatteryConfig(Config, frozen=True, kw_only=True):
    """A lithium polymer battery.

    Attributes:
        capacity_mah: charge when full.
        cells: number of cells in series.
        full_v: voltage of a full cell without load.
        empty_v: voltage of an empty cell without load.
        internal_ohm: internal resistance of a cell.
        electronics_a: current that is always drawn.
        hover_a: current of all motors in hover.
        reserve: fraction of the capacity that is left after a return.
    """

    capacity_mah: Positive = 5000.0
    cells: Annotated[int, Meta(ge=1, le=16)] = 4
    full_v: Positive = 4.05
    empty_v: Positive = 3.6
    internal_ohm: NonNegative = 0.005
    electronics_a: NonNegative = 0.5
    hover_a: NonNegative = 15.0
    reserve: Annotated[float, Meta(ge=0.0, le=0.9)] = 0.1

    def used(self, flight_s: float) -> float:
        """Fraction of the capacity that a flight of this duration uses, at the current that is drawn in hover.

        A flight at a few metres a second in still air draws the same within some percent.
        """
        return (self.electronics_a + self.hover_a) * flight_s / (3.6 * self.capacity_mah)

    def kept(self, critical: float | None) -> float:
        """Fraction of the capacity that must be left after a landing: the reserve, and more than the critical level.

        Args:
            critical: level at which the autopilot flies its own return, see `Battery`; None where it is unknown.
        """
        return max(self.reserve, (critical or 0.0) + CRITICAL_MARGIN)

    def least_used(self, flight_s: float) -> float:
        """Fraction of the capacity that a flight of this duration uses in any case: half of that in hover.

        A gauge that shows less use is wrong, as none that measures the charge of a flying vehicle can.
        """
        return LEAST_USE * self.used(flight_s)


class VehicleConfig(Config, frozen=True, kw_only=True):
    """Tables of `vehicle.toml`.

    Attributes:
        camera: optics and mounting of the camera.
        airframe: mass, size and rotors of the vehicle.
        altimeter: mounting of the laser altimeter.
        uwb: positions of the UWB tag and of the anchors.
        platform: the rover's platform and its tags.
        limits: limits of every goal.
        battery: the vehicle's battery.
        planet: gravity and air.
        heading_by: what measures the heading: a magnetometer, or a GNSS receiver, or what takes its place, with two
            antennas on the vehicle; a vehicle without a magnetometer needs the latter.
    """

    camera: CameraMountConfig = CameraMountConfig()
    airframe: AirframeConfig = AirframeConfig()
    altimeter: AltimeterMountConfig = AltimeterMountConfig()
    uwb: UwbLayoutConfig = UwbLayoutConfig()
    platform: PlatformConfig = PlatformConfig()
    limits: VehicleLimitsConfig = VehicleLimitsConfig()
    battery: BatteryConfig = BatteryConfig()
    planet: PlanetConfig = PlanetConfig()
    heading_by: HeadingSource = "magnetometer"

    @property
    def height_altimeter_m(self) -> float:
        """Height of the altimeter's lens when the vehicle stands."""
        return self.airframe.height_stand_m - self.altimeter.pos_altimeter_frd_m[2]

    @property
    def weight_n(self) -> float:
        """Weight at take-off."""
        return self.airframe.mass_kg * self.planet.gravity_mps2

    def drag_n(self, airspeed_mps: float) -> float:
        """Drag in the rotors' plane at an airspeed."""
        linear, quadratic = self._drag_coefficients
        return (linear + quadratic * airspeed_mps) * airspeed_mps

    def airspeed_mps(self, drag_n: float) -> float:
        """Airspeed in the rotors' plane at which the drag is this; 0 for a vehicle whose drag isn't declared."""
        linear, quadratic = self._drag_coefficients
        root = sqrt(linear * linear + 4.0 * quadratic * drag_n)
        return 2.0 * drag_n / (linear + root) if root > 0.0 else 0.0

    @property
    def airspeed_max_mps(self) -> float:
        """Airspeed of a steady flight at `TILT_STEADY_RAD`; infinite for a vehicle whose drag isn't declared."""
        return self.airspeed_mps(self.weight_n * tan(TILT_STEADY_RAD)) or float("inf")

    def power_ratio(self, airspeed_mps: float) -> float:
        """Power of the rotors relative to that in hover: their thrust carries the weight and holds against the drag.

        The power of a rotor is proportional to its thrust to the power of 3/2.
        """
        thrust = hypot(1.0, self.drag_n(airspeed_mps) / self.weight_n)
        return thrust * sqrt(thrust)

    @property
    def _drag_coefficients(self) -> tuple[float, float]:
        """Drag per m/s of airspeed, and per square of it."""
        airframe = self.airframe
        return airframe.drag_rotors_nspm, 0.5 * self.planet.density_air_kgpm3 * airframe.drag_area_side_m2


def px4_refusal(vehicle: VehicleConfig) -> str:
    """Reason why PX4 can't fly this vehicle, or ""."""
    gravity_mps2 = vehicle.planet.gravity_mps2
    if gravity_mps2 == GRAVITY_EARTH_MPS2:
        return ""
    return (
        f"PX4 assumes the Earth's gravity of {GRAVITY_EARTH_MPS2:g} m/s², and here it is {gravity_mps2:g} m/s²: fly "
        "with the embedded autopilot, JEZERO_AUTOPILOT=embedded"
    )


class FlightCost(NamedTuple):
    """Time of a flight, and what the flight takes from the battery.

    Attributes:
        time_s: of the flight.
        hover_s: time in hover, in still air, that uses the same charge.
    """

    time_s: float
    hover_s: float

    def plus(self, other: "FlightCost") -> "FlightCost":
        """Both flights, one after the other."""
        return FlightCost(self.time_s + other.time_s, self.hover_s + other.hover_s)


def flight_cost(time_s: float, vel_ned_mps: Vec3, wind_ned_mps: Vec3, vehicle: VehicleConfig) -> FlightCost:
    """Cost of a steady flight, or of a hover in the wind.

    Args:
        vel_ned_mps: velocity over ground.
    """
    battery, (north_mps, east_mps, _) = vehicle.battery, subtract(vel_ned_mps, wind_ned_mps)
    hover_a = battery.electronics_a + battery.hover_a
    flight_a = battery.electronics_a + battery.hover_a * vehicle.power_ratio(hypot(north_mps, east_mps))
    return FlightCost(time_s, time_s * flight_a / hover_a if hover_a > 0.0 else time_s)
