"""Each sensor is true on average over many vehicles and scatters as its settings say."""

from collections.abc import Callable
from math import atan2, degrees, radians

import msgspec
import numpy as np
import pytest

from jezero.base.frames import Vec3, ned_from_geodetic, quat_from_euler
from jezero.base.vehicle_config import PlanetConfig, VehicleConfig
from jezero.services.simulator.body import BodyState, RoverState
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.sensors import (
    AltimeterModel,
    BarometerModel,
    GnssModel,
    ImuModel,
    MagnetometerModel,
    RoverOdometryModel,
    UwbModel,
    altitude_pressure_m,
    pressure_pa,
)

CONFIG = SimulatorConfig()
VEHICLE = VehicleConfig()
ORIGIN = CONFIG.origin
DT_S = 0.004
ZERO: Vec3 = (0.0, 0.0, 0.0)
BODY = BodyState(
    (10.0, -20.0, -5.0), (1.0, -2.0, 0.5), quat_from_euler(0.1, -0.2, 0.7), (0.1, 0.2, -0.3), (0.5, 0.3, -9.7)
)
ROVER = RoverState((12.0, -18.0, -0.5), ZERO, quat_from_euler(0.0, 0.0, 0.5), ZERO, 0.5, 0.0, 0.0)
VEHICLES = 60


def imu(seed: int) -> Callable[[], tuple[float, ...]]:
    sensor = ImuModel(CONFIG.imu, seed, DT_S)
    return lambda: sum(sensor.measure(BODY), ())


def gnss(seed: int) -> Callable[[], tuple[float, ...]]:
    sensor = GnssModel(CONFIG.gnss, ORIGIN, seed, "magnetometer")

    def measure() -> tuple[float, ...]:
        fix = sensor.measure(0, BODY)
        return ned_from_geodetic(fix.position_deg, ORIGIN.origin_deg) + fix.vel_uav_ned_mps

    return measure


def barometer(seed: int) -> Callable[[], tuple[float, ...]]:
    sensor = BarometerModel(CONFIG.barometer, ORIGIN, PlanetConfig(), seed)
    return lambda: (sensor.measure(0, BODY).pressure_pa,)


def magnetometer(seed: int) -> Callable[[], tuple[float, ...]]:
    sensor = MagnetometerModel(CONFIG.magnetometer, ORIGIN, seed)
    return lambda: sensor.measure(0, BODY._replace(q_ned_from_frd=(1.0, 0.0, 0.0, 0.0))).field_frd_gauss


def altimeter(seed: int) -> Callable[[], tuple[float, ...]]:
    sensor = AltimeterModel(CONFIG.altimeter, VEHICLE.altimeter, seed)

    def measure() -> tuple[float, ...]:
        range_m = sensor.measure(0, 4.0).range_m
        assert range_m is not None
        return (range_m,)

    return measure


def uwb(seed: int) -> Callable[[], tuple[float, ...]]:
    sensor = UwbModel(CONFIG.uwb, VEHICLE.uwb, seed)
    hovering = BODY._replace(pos_ned_m=(12.0, -18.0, -6.55), vel_ned_mps=ZERO, q_ned_from_frd=(1.0, 0.0, 0.0, 0.0))
    return lambda: tuple(r.range_m for r in sensor.measure(0, hovering, ROVER).ranges)


def odometry(seed: int) -> Callable[[], tuple[float, ...]]:
    sensor = RoverOdometryModel(CONFIG.rover_odometry, seed)

    def measure() -> tuple[float, ...]:
        reading = sensor.measure(0, ROVER)
        return (reading.yaw_rover_rad, reading.yaw_rate_rover_rps)

    return measure


C = CONFIG
SENSORS = {
    "imu": (
        imu,
        BODY.acc_frd_mps2 + BODY.rates_frd_rps,
        [C.imu.std_acc_mps2] * 3 + [C.imu.std_gyro_rps] * 3,
        [C.imu.std_bias_acc_mps2] * 3 + [C.imu.std_bias_gyro_rps] * 3,
    ),
    "gnss": (
        gnss,
        BODY.pos_ned_m + BODY.vel_ned_mps,
        [C.gnss.std_horizontal_m] * 2 + [C.gnss.std_vertical_m] + [C.gnss.std_velocity_mps] * 3,
        [C.gnss.std_bias_horizontal_m] * 2 + [C.gnss.std_bias_vertical_m] + [0.0] * 3,
    ),
    # 493 m in the standard atmosphere: 101325 * (1 - 0.0065 * 493 / 288.15)^5.25588
    "barometer": (barometer, (95_540.0,), [C.barometer.std_pressure_pa], [C.barometer.std_bias_pa]),
    "magnetometer": (
        magnetometer,
        ORIGIN.field_ned_gauss,
        [C.magnetometer.std_gauss] * 3,
        [C.magnetometer.std_bias_gauss] * 3,
    ),
    "altimeter": (altimeter, (4.0,), [C.altimeter.std_m], [C.altimeter.std_bias_m]),
    # tag 6 m above the middle of the platform: sqrt(36 + 2 * 0.45^2)
    "uwb": (uwb, (6.03366,) * 4, [C.uwb.std_m] * 4, [C.uwb.std_bias_m] * 4),
    "odometry": (
        odometry,
        (0.5, 0.0),
        [C.rover_odometry.std_yaw_rad, C.rover_odometry.std_yaw_rate_rps],
        [C.rover_odometry.std_bias_yaw_rad, 0.0],
    ),
}


@pytest.mark.parametrize("name", SENSORS)
def test_white_noise_has_the_standard_deviation_of_the_settings(name: str) -> None:
    """From the differences of readings, which the slow bias doesn't touch; 4000 of them are good to 3 %."""
    make, _, stds, _ = SENSORS[name]
    measure = make(7)
    readings = np.array([measure() for _ in range(4000)])
    assert np.diff(readings, axis=0).std(axis=0) / np.sqrt(2.0) == pytest.approx(stds, rel=0.07)


@pytest.mark.parametrize("name", SENSORS)
def test_the_bias_differs_between_vehicles_and_is_zero_on_average(name: str) -> None:
    make, truth, stds, biases = SENSORS[name]
    means = []
    for seed in range(VEHICLES):
        measure = make(seed)
        means.append(np.mean([measure() for _ in range(20)], axis=0))
    spread = np.sqrt(np.square(biases) + np.square(stds) / 20.0)
    errors = np.array(means) - np.array(truth)
    assert np.abs(errors.mean(axis=0)) == pytest.approx(0.0 * spread, abs=4.0 * float(max(spread)) / np.sqrt(VEHICLES))
    # chi-square with 60 degrees of freedom: 0.1 % and 99.9 % are 0.53 and 1.66 of the mean
    ratio = np.square(errors / spread).mean(axis=0)
    assert (ratio > 0.5).all()
    assert (ratio < 1.7).all()


def test_the_imu_saturates_at_its_limits() -> None:
    sensor = ImuModel(CONFIG.imu, 1, DT_S)
    hit = BODY._replace(acc_frd_mps2=(900.0, -900.0, 0.0), rates_frd_rps=(99.0, -99.0, 0.0))
    acc, gyro = sensor.measure(hit)
    assert acc[:2] == (156.9, -156.9)
    assert gyro[:2] == (34.9, -34.9)


def test_the_imu_at_rest_shows_minus_g() -> None:
    sensor = ImuModel(CONFIG.imu, 1, DT_S)
    rest = BODY._replace(acc_frd_mps2=(0.0, 0.0, -9.81), rates_frd_rps=ZERO)
    acc = np.mean([sensor.measure(rest)[0] for _ in range(2000)], axis=0)
    assert acc == pytest.approx((0.0, 0.0, -9.81), abs=4.0 * CONFIG.imu.std_bias_acc_mps2)


def test_the_field_turns_with_the_body() -> None:
    """Heading east, the north component is on the left: (east, -north, down)."""
    sensor = MagnetometerModel(CONFIG.magnetometer, ORIGIN, 1)
    east = BODY._replace(q_ned_from_frd=quat_from_euler(0.0, 0.0, radians(90.0)))
    field = np.mean([sensor.measure(0, east).field_frd_gauss for _ in range(300)], axis=0)
    north, easterly, down = ORIGIN.field_ned_gauss
    assert field == pytest.approx((easterly, -north, down), abs=0.02)
    assert atan2(easterly, north) == pytest.approx(radians(3.2), abs=radians(0.2))


def test_pressure_is_that_of_the_standard_atmosphere() -> None:
    assert pressure_pa(0.0, PlanetConfig()) == 101_325.0
    assert pressure_pa(1000.0, PlanetConfig()) == pytest.approx(89_875.0, abs=5.0)
    assert altitude_pressure_m(pressure_pa(488.0, PlanetConfig()), PlanetConfig()) == pytest.approx(488.0)


@pytest.mark.parametrize("true_range_m", [None, 0.02, 10.5])
def test_the_altimeter_reports_nothing_beyond_its_limits(true_range_m: float | None) -> None:
    assert AltimeterModel(CONFIG.altimeter, VEHICLE.altimeter, 1).measure(5, true_range_m).range_m is None


def test_uwb_is_silent_beyond_its_range() -> None:
    sensor = UwbModel(CONFIG.uwb, VEHICLE.uwb, 1)
    assert sensor.measure(0, BODY._replace(pos_ned_m=(12.0, -18.0, -16.0)), ROVER).ranges == ()


def test_uwb_sees_the_anchors_where_the_rovers_heading_puts_them() -> None:
    """Rover heads east: its forward anchors are to the east, its right ones to the south."""
    sensor = UwbModel(CONFIG.uwb, VEHICLE.uwb, 1)
    rover = RoverState(ZERO, ZERO, quat_from_euler(0.0, 0.0, radians(90.0)), ZERO, radians(90.0), 0.0, 0.0)
    at = BODY._replace(pos_ned_m=(-0.45, 0.45, -0.05), vel_ned_mps=ZERO, q_ned_from_frd=(1.0, 0.0, 0.0, 0.0))
    ranges = {r.anchor: r.range_m for r in sensor.measure(0, at, rover).ranges}
    expected = {}
    for i, (forward_m, right_m, _) in enumerate(VEHICLE.uwb.pos_anchors_rover_body_m):
        expected[i] = np.hypot(-right_m + 0.45, forward_m - 0.45)
    assert ranges == pytest.approx(expected, abs=0.05)
    assert min(ranges, key=lambda i: ranges[i]) == 0


def test_uwb_ranges_have_times_of_their_own() -> None:
    """The tag approaches at 1 m/s; the first anchor was asked 6 ms before the last."""
    sensor = UwbModel(CONFIG.uwb, VEHICLE.uwb, 1)
    ranges = sensor.measure(1_000_000_000, BODY, ROVER).ranges
    assert [1_000_000_000 - r.t_ns for r in ranges] == [6_000_000, 4_000_000, 2_000_000, 0]


def test_odometry_adds_up_the_way_driven() -> None:
    sensor = RoverOdometryModel(CONFIG.rover_odometry, 1)
    driving = ROVER._replace(yaw_rad=0.0, speed_mps=1.0, vel_ned_mps=(1.0, 0.0, 0.0))
    for _ in range(250):
        reading = sensor.measure(0, driving)
    assert reading.pos_odom_m == pytest.approx((10.0, 0.0), abs=0.4)
    standing = RoverOdometryModel(CONFIG.rover_odometry, 1)
    for _ in range(250):
        reading = standing.measure(0, ROVER)
    assert reading.pos_odom_m == (0.0, 0.0)
    assert reading.speed_rover_body_mps == 0.0


def test_a_share_of_the_uwb_ranges_is_too_long_without_line_of_sight() -> None:
    config = msgspec.structs.replace(CONFIG.uwb, share_blocked=0.2)
    clear = UwbModel(CONFIG.uwb, VEHICLE.uwb, 1)
    blocked = UwbModel(config, VEHICLE.uwb, 1)
    detours_m = []
    for _ in range(500):
        for a, b in zip(clear.measure(0, BODY, ROVER).ranges, blocked.measure(0, BODY, ROVER).ranges, strict=True):
            detours_m.append(b.range_m - a.range_m)
    longer = [detour_m for detour_m in detours_m if detour_m != 0.0]
    assert len(longer) / len(detours_m) == pytest.approx(0.2, abs=0.03)
    assert 0.5 <= min(longer) < 0.55
    assert 2.9 < max(longer) <= 3.0


def test_a_silent_anchor_sends_no_ranges() -> None:
    sensor = UwbModel(msgspec.structs.replace(CONFIG.uwb, anchors_silent=(1, 3)), VEHICLE.uwb, seed=1)
    assert [one.anchor for one in sensor.measure(0, BODY, ROVER).ranges] == [0, 2]


def test_a_biased_anchor_measures_too_much() -> None:
    right = UwbModel(CONFIG.uwb, VEHICLE.uwb, seed=1).measure(0, BODY, ROVER).ranges
    wrong = UwbModel(msgspec.structs.replace(CONFIG.uwb, bias_anchors_m=(0.3,)), VEHICLE.uwb, seed=1)
    errors_m = [b.range_m - a.range_m for a, b in zip(right, wrong.measure(0, BODY, ROVER).ranges, strict=True)]
    assert errors_m == pytest.approx([0.3, 0.0, 0.0, 0.0])


def test_swapped_anchors_report_the_places_where_they_should_be() -> None:
    swapped = UwbModel(msgspec.structs.replace(CONFIG.uwb, anchors_shifted=1), VEHICLE.uwb, seed=1)
    right = UwbModel(CONFIG.uwb, VEHICLE.uwb, seed=1).measure(0, BODY, ROVER).ranges
    wrong = swapped.measure(0, BODY, ROVER).ranges
    assert [one.pos_anchor_rover_body_m for one in wrong] == [one.pos_anchor_rover_body_m for one in right]
    assert wrong[0].range_m == pytest.approx(right[1].range_m, abs=0.1)


def test_a_turned_compass_reads_a_turned_field() -> None:
    sensor = MagnetometerModel(
        msgspec.structs.replace(CONFIG.magnetometer, std_gauss=0.0, std_bias_gauss=0.0), ORIGIN, 1
    )
    level = BODY._replace(q_ned_from_frd=(1.0, 0.0, 0.0, 0.0))
    north, east, _ = sensor.measure(0, level).field_frd_gauss
    sensor.error_yaw_rad = radians(45.0)
    turned_north, turned_east, _ = sensor.measure(0, level).field_frd_gauss
    assert degrees(atan2(turned_east, turned_north) - atan2(east, north)) == pytest.approx(-45.0)


def test_a_compass_with_a_constant_error_reads_the_heading_turned_by_it() -> None:
    config = msgspec.structs.replace(CONFIG.rover_odometry, bias_yaw_rad=1.0, std_yaw_rad=0.0, std_bias_yaw_rad=0.0)
    assert RoverOdometryModel(config, 1).measure(0, ROVER).yaw_rover_rad == pytest.approx(ROVER.yaw_rad + 1.0)
