"""Settings of the simulated world and of the errors of its sensors. The robot itself is described in `vehicle.toml`.

Frame: `map` is NED with its origin in the middle of the terrain, on the ground, which is levelled there.
"""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.base.config import Config
from jezero.base.frames import Vec3

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Coordinate = Annotated[float, Meta(ge=-1e4, le=1e4)]
Angle = Annotated[float, Meta(ge=-6.2832, le=6.2832)]
Gauss = Annotated[float, Meta(ge=-10.0, le=10.0)]
Rate = Annotated[float, Meta(gt=0.0, le=250.0)]
Delay = Annotated[float, Meta(ge=0.0, le=1.0)]


class OriginConfig(Config, frozen=True, kw_only=True):
    """Geodetic position of the map's origin, and the magnetic field there.

    The autopilot compares the field with its own model of the place, so both belong together.

    Attributes:
        latitude_deg: latitude, positive north.
        longitude_deg: longitude, positive east.
        altitude_m: altitude above sea level.
        field_ned_gauss: magnetic field at the map's origin.
    """

    latitude_deg: Annotated[float, Meta(ge=-85.0, le=85.0)] = 47.397742
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 8.545594
    altitude_m: Annotated[float, Meta(ge=-9000.0, le=25_000.0)] = 488.0
    field_ned_gauss: tuple[Gauss, Gauss, Gauss] = (0.216, 0.012, 0.432)

    @property
    def origin_deg(self) -> Vec3:
        return (self.latitude_deg, self.longitude_deg, self.altitude_m)


Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Size = Annotated[float, Meta(ge=0.01, le=100.0)]
Height = Annotated[float, Meta(ge=0.0, le=100.0)]
CONCRETE = (0.62, 0.60, 0.57)


class BoxConfig(Config, frozen=True, kw_only=True):
    """A box that stands on the ground, or hangs above it.

    Attributes:
        north_m: place of its middle, north of the map's origin.
        east_m: place of its middle, east of the map's origin.
        size_m: length, width and height.
        yaw_rad: direction of its length, clockwise from north.
        height_m: height of its lower side above the ground at its middle.
        colour: red, green and blue.
    """

    north_m: Coordinate
    east_m: Coordinate
    size_m: tuple[Size, Size, Size]
    yaw_rad: Angle = 0.0
    height_m: Height = 0.0
    colour: tuple[Share, Share, Share] = CONCRETE


class PoleConfig(Config, frozen=True, kw_only=True):
    """A round pole that stands upright.

    Attributes:
        north_m: place, north of the map's origin.
        east_m: place, east of the map's origin.
        length_m: its length above the ground.
        radius_m: its radius.
        colour: red, green and blue.
    """

    north_m: Coordinate
    east_m: Coordinate
    length_m: Size
    radius_m: Size = 0.05
    colour: tuple[Share, Share, Share] = CONCRETE


class ModelConfig(Config, frozen=True, kw_only=True):
    """A model of one's own, such as an object to photograph.

    Attributes:
        file: glTF (.glb, .gltf), OBJ, STL or PLY, in the folder of the settings or with its whole path.
        north_m: place of its origin, north of the map's origin.
        east_m: place of its origin, east of the map's origin.
        yaw_rad: direction of its front, clockwise from north: of its z axis in glTF and OBJ, whose y axis is up; of its
            x axis in STL and PLY, whose z axis is up.
        height_m: height of its origin above the ground.
        scale: metres in one unit of the file.
        colour: red, green and blue of a model without colours.
    """

    file: str
    north_m: Coordinate
    east_m: Coordinate
    yaw_rad: Angle = 0.0
    height_m: Annotated[float, Meta(ge=-100.0, le=100.0)] = 0.0
    scale: Annotated[float, Meta(gt=0.0, le=1000.0)] = 1.0
    colour: tuple[Share, Share, Share] = CONCRETE


class TerrainConfig(Config, frozen=True, kw_only=True):
    """Mars-like ground, a square of 127.5 m; beyond it the ground is level.

    Attributes:
        seed: seed of the shape; simulator and camera make the same ground from it.
        slope_deg: slope of the hillside on which the vehicle starts; it ends 15 m away and returns to level ground.
        slope_towards_deg: direction in which the hillside descends, clockwise from north.
        water_depth_m: depth of the water on which the rover floats; 0 for dry land. The water's level is the map's 0,
            and the ground lies below it but for a pier of one metre around the origin.
        std_ground_m: standard deviation of the fractal part, before the limits on height and slope scale it down.
        craters: number of craters.
        radius_crater_min_m: smallest radius of a crater.
        radius_crater_max_m: greatest radius of a crater.
        rocks: number of rocks, half buried, none within 8 m of the origin.
        radius_rock_min_m: smallest radius of a rock.
        radius_rock_max_m: greatest radius of a rock.
        friction: friction of the ground; the friction coefficient is its product with `friction_feet` of the vehicle.
        heights: GeoTIFF of a real place, whose heights replace hills and craters; in the folder of the settings, or
            with its whole path; "" for none. The rocks stay.
        heights_north_m: where the map's origin is in it, to the north of its middle.
        heights_east_m: where the map's origin is in it, to the east of its middle.
        basin_radius_m: radius of a crater at one place, a fifth as deep as wide from its middle to the rim; 0 for none.
        basin_north_m: place of its middle, north of the map's origin.
        basin_east_m: place of its middle, east of the map's origin.
        boxes: boxes that stand in it, a table `[[terrain.boxes]]` for each.
        poles: poles that stand in it, a table `[[terrain.poles]]` for each.
        models: models from files that stand in it, a table `[[terrain.models]]` for each.
    """

    seed: Annotated[int, Meta(ge=0)] = 1
    slope_deg: Annotated[float, Meta(ge=0.0, le=15.0)] = 0.0
    slope_towards_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0
    water_depth_m: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.0
    std_ground_m: NonNegative = 0.25
    craters: Annotated[int, Meta(ge=0, le=200)] = 14
    radius_crater_min_m: Positive = 3.0
    radius_crater_max_m: Positive = 12.0
    rocks: Annotated[int, Meta(ge=0, le=300)] = 60
    radius_rock_min_m: Positive = 0.1
    radius_rock_max_m: Positive = 0.35
    friction: NonNegative = 0.9
    heights: str = ""
    heights_north_m: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0
    heights_east_m: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0
    basin_radius_m: Annotated[float, Meta(ge=0.0, le=50.0)] = 0.0
    basin_north_m: Coordinate = 0.0
    basin_east_m: Coordinate = 0.0
    boxes: Annotated[tuple[BoxConfig, ...], Meta(max_length=100)] = ()
    poles: Annotated[tuple[PoleConfig, ...], Meta(max_length=100)] = ()
    models: Annotated[tuple[ModelConfig, ...], Meta(max_length=20)] = ()


class WindConfig(Config, frozen=True, kw_only=True):
    """Mean wind and Dryden gusts.

    Attributes:
        mean_mps: speed of the mean wind.
        from_deg: direction from which the mean wind blows, clockwise from north.
        std_gust_mps: standard deviation of each horizontal component of the gusts.
    """

    mean_mps: Annotated[float, Meta(ge=0.0, le=30.0)] = 1.5
    from_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 250.0
    std_gust_mps: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.3


class UavConfig(Config, frozen=True, kw_only=True):
    """Start of the vehicle, its motors, and its legs.

    Attributes:
        start: "ground" starts on the map's origin, "platform" on the middle of the rover's platform.
        start_yaw_rad: heading at the start, clockwise from north.
        thrust_to_weight: ratio of the thrust at full command on all motors to the weight; the thrust is proportional to
            the command.
        tau_motor_s: time constant of the first-order lag of a rotor's speed.
        damping_rates_nms: moment against a rotation, per rad/s.
        sag_legs_m: height by which the legs give way under the vehicle's weight.
        stiffness_foot_npm: spring constant of each leg.
        damping_foot_nspm: damping constant of each leg.
        friction_feet: friction of the feet; the friction coefficient is its product with that of the ground or the
            platform.
    """

    start: Literal["ground", "platform"] = "ground"
    start_yaw_rad: Angle = 0.0
    thrust_to_weight: Positive = 2.0
    tau_motor_s: Positive = 0.02
    damping_rates_nms: NonNegative = 0.005
    sag_legs_m: NonNegative = 0.002
    stiffness_foot_npm: Positive = 2000.0
    damping_foot_nspm: Positive = 16.0
    friction_feet: NonNegative = 0.9


class SeaConfig(Config, frozen=True, kw_only=True):
    """Waves that move the rover like a boat, see `sea`. They need water that is as deep as they are high.

    Attributes:
        wave_height_m: significant height of the deck's heave: the mean of the highest third, from trough to crest,
            which is four standard deviations; 0 for a deck that doesn't move.
        period_s: period of the highest waves.
        tilt_deg: significant angle of the deck's tilt, which is two standard deviations.
        from_deg: direction from which the waves come, clockwise from north.
    """

    wave_height_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    period_s: Annotated[float, Meta(ge=1.0, le=30.0)] = 5.0
    tilt_deg: Annotated[float, Meta(ge=0.0, le=20.0)] = 5.0
    from_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 60.0


class RoverConfig(Config, frozen=True, kw_only=True):
    """Start and motion of the rover.

    Attributes:
        start_north_m: start position, north of the map's origin; its height follows from the ground there.
        start_east_m: start position, east of the map's origin.
        start_yaw_rad: heading at the start, clockwise from north.
        tilt_deg: angle of the platform against the rover's own level.
        tilt_towards_deg: direction of the platform's low side, clockwise from the rover's front.
        tilts_with_ground: the rover's four wheels stand on the ground and on the rocks, so that the whole rover leans
            and heaves as it drives; otherwise it stays upright and drives through rocks.
        sea: waves that move the rover like a boat.
        friction_platform: friction of the platform; the friction coefficient is its product with `friction_feet` of the
            vehicle.
        acc_max_mps2: maximum acceleration.
        acc_yaw_max_rps2: maximum yaw acceleration.
        command_timeout_s: time without a command after which the rover stops.
    """

    start_north_m: Coordinate = 5.0
    start_east_m: Coordinate = -3.0
    start_yaw_rad: Angle = 0.5
    tilt_deg: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    tilt_towards_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0
    tilts_with_ground: bool = False
    sea: SeaConfig = SeaConfig()
    friction_platform: NonNegative = 0.9
    acc_max_mps2: Positive = 0.5
    acc_yaw_max_rps2: Positive = 0.5
    command_timeout_s: Positive = 0.5


class ImuConfig(Config, frozen=True, kw_only=True):
    """Errors of the IMU.

    The autopilot gets all 250 readings a second without delay; rate and delay are those on the bus.

    Attributes:
        rate_hz: readings per second on the bus.
        delay_s: time until a reading arrives on the bus.
        std_acc_mps2: standard deviation of the white noise of the specific force at 250 Hz, on each axis.
        std_bias_acc_mps2: standard deviation of the slowly varying bias of the specific force, on each axis.
        std_gyro_rps: standard deviation of the white noise of the angular rate at 250 Hz, on each axis.
        std_bias_gyro_rps: standard deviation of the slowly varying bias of the angular rate, on each axis.
        tau_bias_s: time constant of both biases.
        limit_acc_mps2: largest specific force that is measured, on each axis.
        limit_gyro_rps: largest angular rate that is measured, on each axis.
    """

    rate_hz: Rate = 50.0
    delay_s: Delay = 0.0
    std_acc_mps2: NonNegative = 0.05
    std_bias_acc_mps2: NonNegative = 0.1
    std_gyro_rps: NonNegative = 0.004
    std_bias_gyro_rps: NonNegative = 0.003
    tau_bias_s: Positive = 1000.0
    limit_acc_mps2: Positive = 156.9
    limit_gyro_rps: Positive = 34.9


class GnssConfig(Config, frozen=True, kw_only=True):
    """Errors of the GNSS receiver. The standard deviations that it reports contain noise and bias, rounded up to 0.1 m.

    Attributes:
        rate_hz: fixes per second.
        delay_s: time until a fix arrives.
        std_horizontal_m: standard deviation of the white noise of the north and of the east position.
        std_vertical_m: standard deviation of the white noise of the altitude.
        std_bias_horizontal_m: standard deviation of the slowly varying error of the north and of the east position.
        std_bias_vertical_m: standard deviation of the slowly varying error of the altitude.
        tau_bias_s: time constant of the slowly varying errors.
        std_velocity_mps: standard deviation of the white noise of the velocity, on each axis.
        std_yaw_rad: standard deviation of the white noise of the heading by two antennas, of a vehicle that has them
            (`heading_by` in vehicle.toml).
        std_bias_yaw_rad: standard deviation of the slowly varying error of this heading.
        satellites: reported number of satellites.
    """

    rate_hz: Rate = 10.0
    delay_s: Delay = 0.1
    std_horizontal_m: NonNegative = 0.1
    std_vertical_m: NonNegative = 0.15
    std_bias_horizontal_m: NonNegative = 0.25
    std_bias_vertical_m: NonNegative = 0.35
    tau_bias_s: Positive = 120.0
    std_velocity_mps: NonNegative = 0.05
    std_yaw_rad: NonNegative = 0.02
    std_bias_yaw_rad: NonNegative = 0.01
    satellites: Annotated[int, Meta(ge=0, le=255)] = 14


class BarometerConfig(Config, frozen=True, kw_only=True):
    """Errors of the barometer.

    Attributes:
        rate_hz: readings per second on the bus, a subset of those that the autopilot gets.
        rate_hil_hz: readings per second that the autopilot gets.
        delay_s: time until a reading arrives on the bus.
        std_pressure_pa: standard deviation of the white noise of the pressure.
        std_bias_pa: standard deviation of the slowly varying error of the pressure.
        tau_bias_s: time constant of the slowly varying error.
        temperature_degc: reported temperature of the air.
    """

    rate_hz: Rate = 10.0
    rate_hil_hz: Rate = 50.0
    delay_s: Delay = 0.0
    std_pressure_pa: NonNegative = 2.0
    std_bias_pa: NonNegative = 3.0
    tau_bias_s: Positive = 300.0
    temperature_degc: Annotated[float, Meta(ge=-100.0, le=60.0)] = 20.0


class MagnetometerConfig(Config, frozen=True, kw_only=True):
    """Errors of the magnetometer.

    Attributes:
        rate_hz: readings per second on the bus, a subset of those that the autopilot gets.
        rate_hil_hz: readings per second that the autopilot gets.
        delay_s: time until a reading arrives on the bus.
        std_gauss: standard deviation of the white noise of the field, on each axis.
        std_bias_gauss: standard deviation of the slowly varying hard-iron error that is left after the calibration, on
            each axis.
        tau_bias_s: time constant of the slowly varying error.
    """

    rate_hz: Rate = 10.0
    rate_hil_hz: Rate = 50.0
    delay_s: Delay = 0.0
    std_gauss: NonNegative = 0.003
    std_bias_gauss: NonNegative = 0.004
    tau_bias_s: Positive = 600.0


class AltimeterConfig(Config, frozen=True, kw_only=True):
    """Errors of the laser altimeter.

    Attributes:
        rate_hz: ranges per second.
        delay_s: time until a range arrives.
        std_m: standard deviation of the white noise of a range.
        std_bias_m: standard deviation of the slowly varying error of the range.
        tau_bias_s: time constant of the slowly varying error.
        on_hil: whether the autopilot gets the ranges too, as DISTANCE_SENSOR. PX4 may then use them for its own height.
    """

    rate_hz: Rate = 25.0
    delay_s: Delay = 0.02
    std_m: NonNegative = 0.025
    std_bias_m: NonNegative = 0.005
    tau_bias_s: Positive = 600.0
    on_hil: bool = False


class UwbConfig(Config, frozen=True, kw_only=True):
    """Errors of the UWB ranges.

    Attributes:
        rate_hz: rounds per second, each with a range to every anchor.
        delay_s: time until a round arrives.
        std_m: standard deviation of the white noise of a range.
        std_bias_m: standard deviation of the slowly varying error of the range, which differs between anchors.
        tau_bias_s: time constant of the slowly varying errors.
        slot_s: time between the ranges of two anchors.
        share_blocked: fraction of the ranges without a line of sight, which are measured along a detour.
        detour_min_m: smallest error of a range along a detour.
        detour_max_m: greatest error of a range along a detour.
        bias_anchors_m: constant error of each anchor's ranges; empty for none.
        anchors_silent: indices of the anchors that send no ranges.
        anchors_shifted: number of places by which the anchors are swapped: anchor *i* stands where anchor
            *i* + `anchors_shifted` should.
    """

    rate_hz: Rate = 20.0
    delay_s: Delay = 0.02
    std_m: NonNegative = 0.01
    std_bias_m: NonNegative = 0.003
    tau_bias_s: Positive = 600.0
    slot_s: Delay = 0.002
    share_blocked: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    detour_min_m: NonNegative = 0.5
    detour_max_m: NonNegative = 3.0
    bias_anchors_m: Annotated[tuple[Annotated[float, Meta(ge=-10.0, le=10.0)], ...], Meta(max_length=64)] = ()
    anchors_silent: Annotated[tuple[Annotated[int, Meta(ge=0, le=63)], ...], Meta(max_length=64)] = ()
    anchors_shifted: Annotated[int, Meta(ge=0, le=63)] = 0


class RoverOdometryConfig(Config, frozen=True, kw_only=True):
    """Errors of the rover's wheel odometry and compass, with which the rover does its dead reckoning, and of its IMU.

    Attributes:
        rate_hz: readings per second.
        delay_s: time until a reading arrives.
        bias_yaw_rad: constant error of the compass.
        std_yaw_rad: standard deviation of the white noise of the compass.
        std_bias_yaw_rad: standard deviation of the slowly varying error of the compass.
        tau_bias_s: time constant of the compass' slowly varying error.
        std_speed_mps: standard deviation of the white noise of the speed while the rover moves.
        std_yaw_rate_rps: standard deviation of the white noise of the yaw rate.
        std_scale: standard deviation of the relative error of the wheels' radius, constant during a run.
        std_slip: standard deviation of the slip of the wheels, relative to the speed.
        tau_slip_s: time constant of the slip.
        std_tilt_rad: standard deviation of the white noise of the platform's roll and pitch.
        std_bias_tilt_rad: standard deviation of their slowly varying error, with the time constant of the compass'.
    """

    rate_hz: Rate = 25.0
    delay_s: Delay = 0.02
    bias_yaw_rad: Angle = 0.0
    std_yaw_rad: NonNegative = 0.0131
    std_bias_yaw_rad: NonNegative = 0.005
    tau_bias_s: Positive = 600.0
    std_speed_mps: NonNegative = 0.02
    std_yaw_rate_rps: NonNegative = 0.005
    std_scale: NonNegative = 0.01
    std_slip: NonNegative = 0.02
    tau_slip_s: Positive = 2.0
    std_tilt_rad: NonNegative = 0.002
    std_bias_tilt_rad: NonNegative = 0.003


class SimulatorConfig(Config, frozen=True, kw_only=True):
    """Tables of `simulator.toml`.

    Attributes:
        pace: seconds of vehicle time in one of real time. The clocks of a real vehicle differ by some 1e-5 from this
            computer's.
        time_from_boot: whether the autopilot's time is 0 when it connects, as that of a flight controller that boots. A
            stack that gets its time from the simulator needs `false`.
        rover_host: IPv4 address, or name of this computer, at which the rover's computer reaches the simulator. Another
            one than this machine's own 127.0.0.1 needs `JEZERO_INSECURE=1`, as the link has no TLS.
        origin: geodetic position of the map's origin.
        terrain: shape of the ground.
        wind: mean wind and gusts.
        uav: start and dynamics of the vehicle.
        rover: start and dynamics of the rover.
        imu: errors of the IMU.
        gnss: errors of the GNSS receiver.
        barometer: errors of the barometer.
        magnetometer: errors of the magnetometer.
        altimeter: errors of the laser altimeter.
        uwb: errors of the UWB ranges.
        rover_odometry: errors of the rover's odometry.
    """

    pace: Annotated[float, Meta(ge=0.1, le=2.0)] = 1.0
    time_from_boot: bool = False
    rover_host: str = "127.0.0.1"
    origin: OriginConfig = OriginConfig()
    terrain: TerrainConfig = TerrainConfig()
    wind: WindConfig = WindConfig()
    uav: UavConfig = UavConfig()
    rover: RoverConfig = RoverConfig()
    imu: ImuConfig = ImuConfig()
    gnss: GnssConfig = GnssConfig()
    barometer: BarometerConfig = BarometerConfig()
    magnetometer: MagnetometerConfig = MagnetometerConfig()
    altimeter: AltimeterConfig = AltimeterConfig()
    uwb: UwbConfig = UwbConfig()
    rover_odometry: RoverOdometryConfig = RoverOdometryConfig()

    def __post_init__(self) -> None:
        waves_m, depth_m = self.rover.sea.wave_height_m, self.terrain.water_depth_m
        if waves_m > depth_m:
            raise ValueError(
                f"waves of {waves_m:g} m (wave_height_m in [rover.sea]) need water as deep, and it is {depth_m:g} m "
                "deep: set water_depth_m in [terrain]"
            )
