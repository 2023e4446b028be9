"""Readings of each sensor for a true state: noise, bias and limits. The service adds rates and delays.

Each sensor draws from a stream of its own, so that switching one off leaves the others' errors as they were.
"""

from math import ceil, cos, exp, log, sin
from typing import NamedTuple

from msgspec import UNSET

from jezero.base.frames import (
    Vec3,
    add,
    distance,
    euler_from_quat,
    geodetic_from_ned,
    quat_conjugate,
    quat_rotate,
    rotate_yaw,
    scale,
    subtract,
    wrap_pi,
    yaw_from_quat,
)
from jezero.base.vehicle_config import AltimeterMountConfig, HeadingSource, PlanetConfig, UwbLayoutConfig
from jezero.schemas import sensors as messages
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.body import BodyState, RoverState
from jezero.services.simulator.config import (
    AltimeterConfig,
    BarometerConfig,
    GnssConfig,
    ImuConfig,
    MagnetometerConfig,
    OriginConfig,
    RoverOdometryConfig,
    UwbConfig,
)
from jezero.services.simulator.noise import Normals, Wander, generator, normals_of

TEMPERATURE_SEA_K = 288.15
LAPSE_KPM = 0.0065
PRESSURE_EXPONENT = 5.25588
BIAS_STEPS = 25
"""The IMU's bias advances once in this number of samples: it hardly changes between two of them."""


def pressure_pa(altitude_m: float, planet: PlanetConfig) -> float:
    """Static pressure of the planet's air; that of the Earth's standard atmosphere below 11 km."""
    if planet.scale_height_m is not None:
        return planet.pressure_datum_pa * exp(-altitude_m / planet.scale_height_m)
    return float(planet.pressure_datum_pa * (1.0 - LAPSE_KPM * altitude_m / TEMPERATURE_SEA_K) ** PRESSURE_EXPONENT)


def altitude_pressure_m(static_pressure_pa: float, planet: PlanetConfig) -> float:
    """Inverse of `pressure_pa`."""
    ratio = max(static_pressure_pa, 1.0) / planet.pressure_datum_pa
    if planet.scale_height_m is not None:
        return -planet.scale_height_m * log(ratio)
    return float(TEMPERATURE_SEA_K / LAPSE_KPM * (1.0 - ratio ** (1.0 / PRESSURE_EXPONENT)))


class _Bias:
    """Three independent wandering errors."""

    def __init__(self, stds: Vec3, tau_s: float, dt_s: float, normals: Normals) -> None:
        self._axes = tuple(Wander(std, tau_s, dt_s, normals) for std in stds)
        self.value: Vec3 = (self._axes[0].value, self._axes[1].value, self._axes[2].value)

    def step(self) -> Vec3:
        x, y, z = self._axes
        self.value = (x.step(), y.step(), z.step())
        return self.value


class ImuModel:
    """Accelerometer and gyroscope at the centre of mass, one sample per physics step."""

    def __init__(self, config: ImuConfig, seed: int, dt_s: float) -> None:
        self._normals = normals_of(generator(seed, "imu"))
        acc, gyro, dt_bias_s = config.std_bias_acc_mps2, config.std_bias_gyro_rps, BIAS_STEPS * dt_s
        self._bias_acc = _Bias((acc, acc, acc), config.tau_bias_s, dt_bias_s, self._normals)
        self._bias_gyro = _Bias((gyro, gyro, gyro), config.tau_bias_s, dt_bias_s, self._normals)
        self._config = config
        self._count = 0

    def measure(self, state: BodyState) -> tuple[Vec3, Vec3]:
        """Specific force in m/s^2 and angular rate in rad/s, body FRD, cut off at the sensor's limits."""
        self._count += 1
        if self._count % BIAS_STEPS == 0:
            self._bias_acc.step()
            self._bias_gyro.step()
        n, config = self._normals, self._config
        std, limit = config.std_acc_mps2, config.limit_acc_mps2
        ax, ay, az = state.acc_frd_mps2
        bx, by, bz = self._bias_acc.value
        acc = (
            min(max(ax + bx + std * n(), -limit), limit),
            min(max(ay + by + std * n(), -limit), limit),
            min(max(az + bz + std * n(), -limit), limit),
        )
        std, limit = config.std_gyro_rps, config.limit_gyro_rps
        gx, gy, gz = state.rates_frd_rps
        bx, by, bz = self._bias_gyro.value
        gyro = (
            min(max(gx + bx + std * n(), -limit), limit),
            min(max(gy + by + std * n(), -limit), limit),
            min(max(gz + bz + std * n(), -limit), limit),
        )
        return acc, gyro


class GnssModel:
    """Fixes with white noise on a wandering error, which the velocity doesn't show."""

    def __init__(self, config: GnssConfig, origin: OriginConfig, seed: int, heading_by: HeadingSource) -> None:
        self._normals = normals_of(generator(seed, "gnss"))
        horizontal_m, vertical_m = config.std_bias_horizontal_m, config.std_bias_vertical_m
        stds_m = (horizontal_m, horizontal_m, vertical_m)
        self._bias_m = _Bias(stds_m, config.tau_bias_s, 1.0 / config.rate_hz, self._normals)
        self._normals_yaw = normals_of(generator(seed, "gnss yaw"))
        self._bias_yaw_rad = Wander(config.std_bias_yaw_rad, config.tau_bias_s, 1.0 / config.rate_hz, self._normals_yaw)
        self._has_yaw = heading_by == "gnss"
        self._origin_deg = origin.origin_deg
        self._config = config
        self._claim_horizontal_m = _round_up(config.std_horizontal_m + horizontal_m)
        self._claim_vertical_m = _round_up(config.std_vertical_m + vertical_m)

    def measure(self, t_ns: int, state: BodyState) -> messages.Gnss:
        n, config = self._normals, self._config
        north_m, east_m, down_m = add(state.pos_ned_m, self._bias_m.step())
        noisy_ned_m = (
            north_m + config.std_horizontal_m * n(),
            east_m + config.std_horizontal_m * n(),
            down_m + config.std_vertical_m * n(),
        )
        std_mps = config.std_velocity_mps
        vx, vy, vz = state.vel_ned_mps
        return messages.Gnss(
            t_ns=t_ns,
            position_deg=geodetic_from_ned(noisy_ned_m, self._origin_deg),
            vel_uav_ned_mps=(vx + std_mps * n(), vy + std_mps * n(), vz + std_mps * n()),
            std_horizontal_m=self._claim_horizontal_m,
            std_vertical_m=self._claim_vertical_m,
            satellites=config.satellites,
            yaw_uav_rad=self._yaw_rad(state) if self._has_yaw else UNSET,
        )

    def _yaw_rad(self, state: BodyState) -> float:
        error_rad = self._bias_yaw_rad.step() + self._config.std_yaw_rad * self._normals_yaw()
        return wrap_pi(yaw_from_quat(state.q_ned_from_frd) + error_rad)


class BarometerModel:
    """Static pressure of the planet's air with a wandering error."""

    def __init__(self, config: BarometerConfig, origin: OriginConfig, planet: PlanetConfig, seed: int) -> None:
        self._normals = normals_of(generator(seed, "barometer"))
        self._bias_pa = Wander(config.std_bias_pa, config.tau_bias_s, 1.0 / config.rate_hil_hz, self._normals)
        self._altitude_origin_m = origin.altitude_m
        self._planet = planet
        self._config = config

    def measure(self, t_ns: int, state: BodyState) -> messages.Barometer:
        true_pa = pressure_pa(self._altitude_origin_m - state.pos_ned_m[2], self._planet)
        measured_pa = true_pa + self._bias_pa.step() + self._config.std_pressure_pa * self._normals()
        return messages.Barometer(
            t_ns=t_ns,
            pressure_pa=measured_pa,
            altitude_pressure_m=altitude_pressure_m(measured_pa, self._planet),
            temperature_degc=self._config.temperature_degc,
        )


class MagnetometerModel:
    """The place's field in the body's axes; the bias is the rest of the hard-iron error after calibration.

    Attributes:
        error_yaw_rad: angle by which the field is turned about the vertical, as by iron or a current nearby.
    """

    def __init__(self, config: MagnetometerConfig, origin: OriginConfig, seed: int) -> None:
        self._normals = normals_of(generator(seed, "magnetometer"))
        std = config.std_bias_gauss
        self._bias_gauss = _Bias((std, std, std), config.tau_bias_s, 1.0 / config.rate_hil_hz, self._normals)
        self._field_ned_gauss = origin.field_ned_gauss
        self._std_gauss = config.std_gauss
        self.error_yaw_rad = 0.0

    def measure(self, t_ns: int, state: BodyState) -> messages.Magnetometer:
        n, std = self._normals, self._std_gauss
        field_ned_gauss = rotate_yaw(self._field_ned_gauss, -self.error_yaw_rad)
        field = quat_rotate(quat_conjugate(state.q_ned_from_frd), field_ned_gauss)
        x, y, z = add(field, self._bias_gauss.step())
        return messages.Magnetometer(t_ns=t_ns, field_frd_gauss=(x + std * n(), y + std * n(), z + std * n()))


class AltimeterModel:
    """Laser range; nothing between its limits is None."""

    def __init__(self, config: AltimeterConfig, mount: AltimeterMountConfig, seed: int) -> None:
        self._normals = normals_of(generator(seed, "altimeter"))
        self._bias_m = Wander(config.std_bias_m, config.tau_bias_s, 1.0 / config.rate_hz, self._normals)
        self._mount = mount
        self._std_m = config.std_m

    def measure(self, t_ns: int, true_range_m: float | None) -> messages.Altimeter:
        """Noise is drawn whether or not the beam met anything, so that the stream stays in step."""
        mount = self._mount
        error_m = self._bias_m.step() + self._std_m * self._normals()
        if true_range_m is None or not mount.range_min_m <= true_range_m + error_m <= mount.range_max_m:
            return messages.Altimeter(t_ns=t_ns, range_m=None)
        return messages.Altimeter(t_ns=t_ns, range_m=true_range_m + error_m)


class _Anchor(NamedTuple):
    """One UWB anchor in `rover_body`: where it is reported to be, where it is, and its constant and varying errors."""

    pos_m: Vec3
    pos_true_m: Vec3
    bias_m: float
    wander_m: Wander


class UwbModel:
    """Ranges from the vehicle's tag to the platform's anchors, each with its own wandering bias."""

    def __init__(self, config: UwbConfig, layout: UwbLayoutConfig, seed: int) -> None:
        self._normals = normals_of(generator(seed, "uwb"))
        dt_s = 1.0 / config.rate_hz
        places_m = layout.pos_anchors_rover_body_m
        self._anchors = tuple(
            _Anchor(
                pos_m,
                places_m[(i + config.anchors_shifted) % len(places_m)],
                config.bias_anchors_m[i] if i < len(config.bias_anchors_m) else 0.0,
                Wander(config.std_bias_m, config.tau_bias_s, dt_s, self._normals),
            )
            for i, pos_m in enumerate(places_m)
        )
        self._blocking = generator(seed, "uwb blocked")
        self._config = config
        self._layout = layout

    def measure(self, t_ns: int, state: BodyState, rover: RoverState) -> messages.Uwb:
        """One round that ends at `t_ns`: the anchors take turns, the first one's range is the oldest."""
        config, layout = self._config, self._layout
        tag_ned_m = add(state.pos_ned_m, quat_rotate(state.q_ned_from_frd, layout.pos_tag_frd_m))
        q_rover_body_from_ned = quat_conjugate(rover.q_ned_from_rover_body)
        tag_rover_body_m = quat_rotate(q_rover_body_from_ned, subtract(tag_ned_m, rover.pos_ned_m))
        vel_rover_body_mps = quat_rotate(q_rover_body_from_ned, subtract(state.vel_ned_mps, rover.vel_ned_mps))
        ranges = []
        for i, anchor in enumerate(self._anchors):
            age_s = (len(self._anchors) - 1 - i) * config.slot_s
            error_m = anchor.bias_m + anchor.wander_m.step() + config.std_m * self._normals() + self._detour_m()
            then_m = subtract(tag_rover_body_m, scale(vel_rover_body_mps, age_s))
            range_m = max(0.0, distance(then_m, anchor.pos_true_m) + error_m)
            if range_m <= layout.range_max_m and i not in config.anchors_silent:
                then_ns = max(0, t_ns - round(age_s * NS_PER_S))
                ranges.append(
                    messages.UwbRange(t_ns=then_ns, anchor=i, pos_anchor_rover_body_m=anchor.pos_m, range_m=range_m)
                )
        return messages.Uwb(t_ns=t_ns, ranges=tuple(ranges))

    def _detour_m(self) -> float:
        """Error of one range along a detour; 0 with line of sight."""
        config = self._config
        if config.share_blocked == 0.0 or self._blocking.random() >= config.share_blocked:
            return 0.0
        return float(self._blocking.uniform(config.detour_min_m, config.detour_max_m))


class RoverOdometryModel:
    """Wheels, compass and IMU of the rover, and the path that is dead reckoned from where it started."""

    def __init__(self, config: RoverOdometryConfig, seed: int) -> None:
        self._normals = normals_of(generator(seed, "rover_odometry"))
        self._dt_s = 1.0 / config.rate_hz
        self._bias_yaw_rad = Wander(config.std_bias_yaw_rad, config.tau_bias_s, self._dt_s, self._normals)
        self._scale = 1.0 + config.std_scale * self._normals()
        self._slip = Wander(config.std_slip, config.tau_slip_s, self._dt_s, self._normals)
        self._normals_tilt = normals_of(generator(seed, "rover_tilt"))
        self._bias_roll_rad, self._bias_pitch_rad = (
            Wander(config.std_bias_tilt_rad, config.tau_bias_s, self._dt_s, self._normals_tilt) for _ in range(2)
        )
        self._pos_odom_m = (0.0, 0.0)
        self._config = config

    def restart(self) -> None:
        """Restart the path at the rover's start."""
        self._pos_odom_m = (0.0, 0.0)

    def measure(self, t_ns: int, rover: RoverState) -> messages.RoverOdometry:
        n, config = self._normals, self._config
        yaw_rad = wrap_pi(rover.yaw_rad + config.bias_yaw_rad + self._bias_yaw_rad.step() + config.std_yaw_rad * n())
        moved = rover.speed_mps != 0.0 or rover.yaw_rate_rps != 0.0
        turned = self._scale + self._slip.step()  # wheels that slip turn faster than the rover moves
        speed_mps = turned * rover.speed_mps + (config.std_speed_mps * n() if moved else 0.0)
        step_m = speed_mps * self._dt_s
        north_m, east_m = self._pos_odom_m
        self._pos_odom_m = (north_m + step_m * cos(yaw_rad), east_m + step_m * sin(yaw_rad))
        roll_rad, pitch_rad, _ = euler_from_quat(rover.q_ned_from_rover_body)
        tilt = self._normals_tilt
        return messages.RoverOdometry(
            t_ns=t_ns,
            pos_odom_m=self._pos_odom_m,
            yaw_rover_rad=yaw_rad,
            speed_rover_body_mps=speed_mps,
            yaw_rate_rover_rps=rover.yaw_rate_rps + config.std_yaw_rate_rps * n(),
            roll_rover_rad=wrap_pi(roll_rad + self._bias_roll_rad.step() + config.std_tilt_rad * tilt()),
            pitch_rover_rad=wrap_pi(pitch_rad + self._bias_pitch_rad.step() + config.std_tilt_rad * tilt()),
        )


def _round_up(std_m: float) -> float:
    """Standard deviation rounded up to the next 0.1 m, as receivers report their accuracy."""
    return ceil(10.0 * std_m - 1e-9) / 10.0
