"""Settings of the simulator; the defaults are those of `deploy/config/simulator.toml`.

Frames: `map` is NED with its origin at the middle of the terrain, at the height the terrain was levelled to there.
Mounts are relative to the vehicle's centre of mass, in body FRD.
"""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.frames import Vec3
from jezero.runtime.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Coordinate = Annotated[float, Meta(ge=-1e4, le=1e4)]
Angle = Annotated[float, Meta(ge=-6.2832, le=6.2832)]
Small = Annotated[float, Meta(ge=-10.0, le=10.0)]
Mount = tuple[Small, Small, Small]
Rate = Annotated[float, Meta(gt=0.0, le=250.0)]
Delay = Annotated[float, Meta(ge=0.0, le=1.0)]


class OriginConfig(Config, frozen=True, kw_only=True):
    """Where on the globe the map's origin is, and the magnetic field there.

    The autopilot compares the field with its own model of the place, so both belong together.
    """

    latitude_deg: Annotated[float, Meta(ge=-85.0, le=85.0)] = 47.397742
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 8.545594
    altitude_m: Annotated[float, Meta(ge=-500.0, le=9000.0)] = 488.0
    field_ned_gauss: Mount = (0.216, 0.012, 0.432)

    @property
    def origin_deg(self) -> Vec3:
        return (self.latitude_deg, self.longitude_deg, self.altitude_m)


class TerrainConfig(Config, frozen=True, kw_only=True):
    """Mars-like ground, a square of 127.5 m; beyond it the ground is level.

    Attributes:
        seed: of the shape; everything that needs to know the ground makes the same one from it.
        std_ground_m: of the fractal part, before the limits on height and slope scale it down.
        rocks: spheres, half buried, none within 8 m of the origin.
        friction: times that of the vehicle's feet is the friction coefficient.
    """

    seed: Annotated[int, Meta(ge=0)] = 1
    std_ground_m: NonNegative = 0.25
    craters: Annotated[int, Meta(ge=0, le=200)] = 14
    radius_crater_min_m: Positive = 3.0
    radius_crater_max_m: Positive = 12.0
    rocks: Annotated[int, Meta(ge=0, le=300)] = 60
    radius_rock_min_m: Positive = 0.1
    radius_rock_max_m: Positive = 0.35
    friction: NonNegative = 0.9


class WindConfig(Config, frozen=True, kw_only=True):
    """Mean wind and Dryden gusts.

    Attributes:
        from_deg: where the mean wind blows from, clockwise from north.
        std_gust_mps: of each horizontal component.
    """

    mean_mps: Annotated[float, Meta(ge=0.0, le=30.0)] = 1.5
    from_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 250.0
    std_gust_mps: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.3


class UavConfig(Config, frozen=True, kw_only=True):
    """A quadrotor like the Iris, with the motors of PX4's airframe 10016.

    Attributes:
        start: "ground": on the map's origin. "platform": on the middle of the rover's platform.
        inertia_kgm2: principal moments about forward, right, down.
        pos_rotors_frd_m: (4, 2) forward and right of each motor in the autopilot's order.
        moment_per_thrust_m: yaw moment of each rotor per newton of its thrust, positive to the right.
        thrust_to_weight: at full command on all motors; thrust is proportional to the command.
        tau_motor_s: first-order lag of a rotor's speed.
        drag_rotors_nspm: drag in the rotors' plane per m/s of airspeed, in hover; grows with the rotors' speed.
        drag_area_side_m2, drag_area_top_m2: of the body, drag coefficient included.
        damping_rates_nms: moment per rad/s against turning.
        height_stand_m: centre of mass above level ground when the feet just touch.
        feet_frd_m: forward and right of the front right foot; the four feet are symmetric.
        stiffness_foot_npm, damping_foot_nspm: spring and damper of each leg.
    """

    start: Literal["ground", "platform"] = "ground"
    start_yaw_rad: Angle = 0.0
    mass_kg: Positive = 1.5
    inertia_kgm2: tuple[Positive, Positive, Positive] = (0.029, 0.029, 0.055)
    pos_rotors_frd_m: tuple[tuple[Small, Small], tuple[Small, Small], tuple[Small, Small], tuple[Small, Small]] = (
        (0.1515, 0.245),
        (-0.1515, -0.1875),
        (0.1515, -0.245),
        (-0.1515, 0.1875),
    )
    moment_per_thrust_m: tuple[Small, Small, Small, Small] = (0.05, 0.05, -0.05, -0.05)
    thrust_to_weight: Positive = 2.0
    tau_motor_s: Positive = 0.02
    radius_rotor_m: Positive = 0.128
    drag_rotors_nspm: NonNegative = 0.45
    drag_area_side_m2: NonNegative = 0.06
    drag_area_top_m2: NonNegative = 0.1
    damping_rates_nms: NonNegative = 0.005
    height_stand_m: Positive = 0.15
    feet_frd_m: tuple[Positive, Positive] = (0.13, 0.16)
    stiffness_foot_npm: Positive = 2000.0
    damping_foot_nspm: Positive = 16.0
    friction_feet: NonNegative = 0.9


class RoverConfig(Config, frozen=True, kw_only=True):
    """The rover and its landing platform.

    Attributes:
        start_north_m, start_east_m: in the map; the platform's height follows from the ground there.
        height_platform_m: top of the platform above the ground at its middle.
        pos_anchors_rover_body_m: (4, 3) UWB anchors, z down from the platform's top.
        acc_max_mps2, acc_yaw_max_rps2: how fast the wheels change speed and yaw rate.
        command_timeout_s: the rover stops when no command has come for so long.
    """

    start_north_m: Coordinate = 5.0
    start_east_m: Coordinate = -3.0
    start_yaw_rad: Angle = 0.5
    platform_side_m: Positive = 1.0
    height_platform_m: Annotated[float, Meta(ge=0.2, le=5.0)] = 0.5
    friction_platform: NonNegative = 0.9
    pos_anchors_rover_body_m: tuple[Mount, ...] = (
        (0.45, 0.45, 0.0),
        (0.45, -0.45, 0.0),
        (-0.45, -0.45, 0.0),
        (-0.45, 0.45, 0.0),
    )
    acc_max_mps2: Positive = 0.5
    acc_yaw_max_rps2: Positive = 0.5
    command_timeout_s: Positive = 0.5


class ImuConfig(Config, frozen=True, kw_only=True):
    """White noise of each 250 Hz sample, and a bias that is random at the start and wanders with `tau_bias_s`.

    Attributes:
        rate_hz, delay_s: on the bus; the autopilot gets all 250 samples a second, at once.
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
    """White noise of each fix and a wandering error; the receiver claims both, rounded up."""

    rate_hz: Rate = 10.0
    delay_s: Delay = 0.1
    std_horizontal_m: NonNegative = 0.1
    std_vertical_m: NonNegative = 0.15
    std_bias_horizontal_m: NonNegative = 0.25
    std_bias_vertical_m: NonNegative = 0.35
    tau_bias_s: Positive = 120.0
    std_velocity_mps: NonNegative = 0.05
    satellites: Annotated[int, Meta(ge=0, le=255)] = 14


class BarometerConfig(Config, frozen=True, kw_only=True):
    """Attributes: rate_hil_hz: to the autopilot; the bus gets a part of the same readings."""

    rate_hz: Rate = 10.0
    rate_hil_hz: Rate = 50.0
    delay_s: Delay = 0.0
    std_pressure_pa: NonNegative = 2.0
    std_bias_pa: NonNegative = 3.0
    tau_bias_s: Positive = 300.0
    temperature_degc: Annotated[float, Meta(ge=-100.0, le=60.0)] = 20.0


class MagnetometerConfig(Config, frozen=True, kw_only=True):
    """Attributes: rate_hil_hz: as the barometer's; std_bias_gauss: what is left of the hard iron."""

    rate_hz: Rate = 10.0
    rate_hil_hz: Rate = 50.0
    delay_s: Delay = 0.0
    std_gauss: NonNegative = 0.003
    std_bias_gauss: NonNegative = 0.004
    tau_bias_s: Positive = 600.0


class AltimeterConfig(Config, frozen=True, kw_only=True):
    """Narrow laser beam along the body's down axis."""

    rate_hz: Rate = 25.0
    delay_s: Delay = 0.02
    std_m: NonNegative = 0.025
    std_bias_m: NonNegative = 0.005
    tau_bias_s: Positive = 600.0
    range_min_m: NonNegative = 0.15
    range_max_m: Positive = 10.0
    mount_frd_m: Mount = (0.0, 0.0, 0.05)


class UwbConfig(Config, frozen=True, kw_only=True):
    """Ranges from the vehicle's tag to the anchors on the platform; the bias is each anchor's own.

    Attributes:
        slot_s: between the ranges of two anchors.
        share_blocked: of the ranges, measured along a detour as there is no line of sight; 0.1 is a tenth of them.
        detour_min_m, detour_max_m: by how much those are too long.
    """

    rate_hz: Rate = 20.0
    delay_s: Delay = 0.02
    std_m: NonNegative = 0.01
    std_bias_m: NonNegative = 0.003
    tau_bias_s: Positive = 600.0
    range_max_m: Positive = 15.0
    slot_s: Delay = 0.002
    share_blocked: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    detour_min_m: NonNegative = 0.5
    detour_max_m: NonNegative = 3.0
    mount_frd_m: Mount = (0.0, 0.0, 0.05)


class RoverOdometryConfig(Config, frozen=True, kw_only=True):
    """Wheel odometry, dead reckoned with the compass' yaw.

    Attributes:
        std_scale: of the wheels' radius, relative, drawn once.
        std_slip: of the wheels' slip, a share of the speed that changes within `tau_slip_s`.
    """

    rate_hz: Rate = 25.0
    delay_s: Delay = 0.02
    std_yaw_rad: NonNegative = 0.0131
    std_bias_yaw_rad: NonNegative = 0.005
    tau_bias_s: Positive = 600.0
    std_speed_mps: NonNegative = 0.02
    std_yaw_rate_rps: NonNegative = 0.005
    std_scale: NonNegative = 0.01
    std_slip: NonNegative = 0.02
    tau_slip_s: Positive = 2.0


class SimulatorConfig(Config, frozen=True, kw_only=True):
    """Everything of the simulated world.

    Attributes:
        gravity_mps2: PX4 assumes 9.81, and an Iris can't fly in the air of Mars; Mars-like is the ground.
        density_air_kgpm3: at the origin.
    """

    gravity_mps2: Positive = 9.81
    density_air_kgpm3: Positive = 1.2
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
