"""The wind from the balance of forces: in a hover the rotors' horizontal pull equals the drag."""

from math import cos, sin, sqrt, tan

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from jezero.base.frames import Quat, Vec3
from jezero.base.vehicle_config import AirframeConfig, VehicleConfig
from jezero.schemas.state import Odometry
from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot
from jezero.services.vehicle_bridge.wind_estimator import WindEstimator, wind_ned_mps

ROBOT = VehicleConfig(airframe=AirframeConfig(mass_kg=1.5, drag_rotors_nspm=0.45, drag_area_side_m2=0.06))
STILL: Vec3 = (0.0, 0.0, 0.0)


def pitched(angle_rad: float) -> Quat:
    return (cos(angle_rad / 2.0), 0.0, sin(angle_rad / 2.0), 0.0)


def test_a_level_hover_has_no_wind() -> None:
    assert wind_ned_mps(STILL, STILL, pitched(0.0), ROBOT) == pytest.approx(STILL, abs=1e-9)


def test_a_level_flight_at_constant_speed_has_the_wind_with_it() -> None:
    assert wind_ned_mps(STILL, (3.0, 0.0, 0.0), pitched(0.0), ROBOT) == pytest.approx((3.0, 0.0, 0.0))


@pytest.mark.parametrize("pitch_rad", [-0.3, -0.1, 0.1])
def test_a_hover_that_leans_into_the_wind_has_the_airspeed_of_its_drag(pitch_rad: float) -> None:
    """In the plane of the rotors: 0.45 v + 0.5 · 1.2 · 0.06 v² = 1.5 · 9.81 · sin(pitch)."""
    wind = wind_ned_mps(STILL, STILL, pitched(pitch_rad), ROBOT)
    assert wind is not None
    drag_n = 1.5 * 9.81 * sin(abs(pitch_rad))
    in_plane_mps = (sqrt(0.45**2 + 4.0 * 0.036 * drag_n) - 0.45) / (2.0 * 0.036)
    horizontal_mps = in_plane_mps * (cos(pitch_rad) + sin(abs(pitch_rad)) * tan(abs(pitch_rad)))
    # Nose down (negative pitch) pulls north, so the wind comes from the north, towards the south.
    assert wind[0] == pytest.approx(horizontal_mps * (1.0 if pitch_rad > 0.0 else -1.0))
    assert wind[1:] == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_wind_of_a_simulated_drag_is_found(seed: int) -> None:
    """The drag acts in the plane of the rotors, against the motion through the air: 0.45 v + 0.5 · 1.2 · 0.06 v²."""
    rng = np.random.default_rng(seed)
    vel_ned_mps, wind = rng.normal(0.0, 3.0, 3), np.array((*rng.normal(0.0, 4.0, 2), 0.0))
    attitude = Rotation.from_euler("ZYX", (rng.uniform(-3.0, 3.0), *rng.uniform(-0.4, 0.4, 2)))
    in_plane = attitude.inv().apply(vel_ned_mps - wind) * (1.0, 1.0, 0.0)
    speed = float(np.linalg.norm(in_plane))
    drag_n = -(0.45 + 0.036 * speed) * in_plane
    down = np.array((0.0, 0.0, 1.0))
    acc_ned_mps2 = attitude.apply((drag_n - rng.uniform(5.0, 25.0) * down) / 1.5) + 9.81 * down
    w, x, y, z = attitude.as_quat(scalar_first=True).tolist()
    found = wind_ned_mps(tuple(acc_ned_mps2.tolist()), tuple(vel_ned_mps.tolist()), (w, x, y, z), ROBOT)
    assert found == pytest.approx(tuple(wind), abs=0.02)


def test_a_vehicle_on_its_side_tells_nothing_of_the_wind() -> None:
    assert wind_ned_mps(STILL, STILL, pitched(1.3), ROBOT) is None


@pytest.mark.parametrize(("drag_rotors_nspm", "known"), [(0.45, True), (0.0, False)])
def test_without_drag_in_the_settings_the_wind_is_unknown(drag_rotors_nspm: float, known: bool) -> None:
    estimator = WindEstimator(
        VehicleConfig(airframe=AirframeConfig(drag_rotors_nspm=drag_rotors_nspm, drag_area_side_m2=0.0))
    )
    flying = VehicleSnapshot(t_ns=0, timer_ns=0, armed=True, landed=False, height_m=3.0)
    for step in range(200):
        odometry = Odometry(
            t_ns=1 + step * 20_000_000,
            epoch_id=1,
            pos_uav_ned_m=(0.0, 0.0, -3.0),
            vel_uav_ned_mps=STILL,
            q_ned_from_frd=pitched(0.0),
            rates_uav_frd_rps=STILL,
        )
        estimator.update(odometry, flying)
    assert (estimator.wind is not None) is known


def fly_level(estimator: WindEstimator, begin_s: float, end_s: float, wind_ned_mps: Vec3) -> None:
    """A level flight that the wind carries along."""
    flying = VehicleSnapshot(t_ns=0, timer_ns=0, armed=True, landed=False, height_m=3.0)
    for step in range(round(begin_s * 50), round(end_s * 50) + 1):
        odometry = Odometry(
            t_ns=1 + step * 20_000_000,
            epoch_id=1,
            pos_uav_ned_m=(0.0, 0.0, -3.0),
            vel_uav_ned_mps=wind_ned_mps,
            q_ned_from_frd=pitched(0.0),
            rates_uav_frd_rps=STILL,
        )
        estimator.update(odometry, flying)


@pytest.mark.parametrize(("armed", "landed"), [(True, True), (False, False), (False, True)])
def test_the_wind_is_forgotten_on_the_ground_and_when_the_motors_stand(armed: bool, landed: bool) -> None:
    estimator = WindEstimator(ROBOT)
    fly_level(estimator, 0.0, 3.0, (3.0, 0.0, 0.0))
    assert estimator.wind is not None
    odometry = Odometry(
        t_ns=4_000_000_000,
        epoch_id=1,
        pos_uav_ned_m=STILL,
        vel_uav_ned_mps=STILL,
        q_ned_from_frd=pitched(0.0),
        rates_uav_frd_rps=STILL,
    )
    estimator.update(odometry, VehicleSnapshot(t_ns=0, timer_ns=0, armed=armed, landed=landed, height_m=3.0))
    assert estimator.wind is None


@pytest.mark.parametrize(("north_mps", "east_mps"), [(3.0, 0.0), (0.0, -3.0)])
def test_the_mean_begins_with_the_first_samples_and_follows_a_wind_that_rises_later(
    north_mps: float, east_mps: float
) -> None:
    """A sample of 0.4 s has 0.08 of the weight: after twelve, 0.92 to the power of 12 is 0.368 of the wind before."""
    estimator = WindEstimator(ROBOT)
    fly_level(estimator, 0.0, 2.2, (north_mps, east_mps, 0.0))
    assert estimator.wind is not None
    assert estimator.wind.mean_ned_mps == pytest.approx((north_mps, east_mps, 0.0))
    assert estimator.wind.std_gust_mps == pytest.approx(0.0, abs=1e-6)
    estimator = WindEstimator(ROBOT)
    fly_level(estimator, 0.0, 40.0, STILL)
    fly_level(estimator, 41.0, 46.0, (north_mps, east_mps, 0.0))  # the gap keeps the jump of the velocity out
    assert estimator.wind is not None
    assert estimator.wind.mean_ned_mps == pytest.approx((0.632 * north_mps, 0.632 * east_mps, 0.0), abs=0.01)
    # 0.632 of the weight is on 3 m/s and the rest on 0; a component has half of the variance.
    assert estimator.wind.std_gust_mps == pytest.approx(3.0 * sqrt(0.5 * 0.632 * 0.368), abs=0.01)


def leveled(t_s: float, vel_ned_mps: Vec3 = (3.0, 0.0, 0.0)) -> Odometry:
    """Odometry of a level vehicle that the wind carries along."""
    return Odometry(
        t_ns=1 + round(t_s * 1e9),
        epoch_id=1,
        pos_uav_ned_m=(0.0, 0.0, -3.0),
        vel_uav_ned_mps=vel_ned_mps,
        q_ned_from_frd=pitched(0.0),
        rates_uav_frd_rps=STILL,
    )


def aloft(height_m: float | None = 3.0) -> VehicleSnapshot:
    return VehicleSnapshot(t_ns=0, timer_ns=0, armed=True, landed=False, height_m=height_m)


@pytest.mark.parametrize(("height_m", "known"), [(0.7, True), (0.3, False), (None, False)])
def test_near_the_ground_and_without_a_height_the_wind_is_not_estimated(height_m: float | None, known: bool) -> None:
    estimator = WindEstimator(ROBOT)
    for step in range(200):
        estimator.update(leveled(0.02 * step), aloft(height_m))
    assert (estimator.wind is not None) is known


def test_the_wind_stays_as_it_is_while_the_vehicle_is_near_the_ground() -> None:
    estimator = WindEstimator(ROBOT)
    fly_level(estimator, 0.0, 3.0, (3.0, 0.0, 0.0))
    before = estimator.wind
    for step in range(200):
        estimator.update(leveled(4.0 + 0.02 * step, (-3.0, 0.0, 0.0)), aloft(0.2))
    assert before is not None and estimator.wind == before


@pytest.mark.parametrize(("period_s", "known"), [(0.02, True), (0.15, True), (0.25, False)])
def test_odometry_with_long_gaps_gives_no_wind(period_s: float, known: bool) -> None:
    estimator = WindEstimator(ROBOT)
    for step in range(round(10.0 / period_s)):
        estimator.update(leveled(period_s * step), aloft())
    assert (estimator.wind is not None) is known


def test_the_wind_is_known_after_about_two_seconds_of_flight() -> None:
    estimator, known_s = WindEstimator(ROBOT), []
    for step in range(200):
        estimator.update(leveled(0.02 * step), aloft())
        known_s += [0.02 * step] if estimator.wind is not None else []
    assert 1.5 < known_s[0] < 2.5


def test_a_sample_is_not_made_across_a_gap_or_a_landing() -> None:
    """The velocity jumps meanwhile, which would be an acceleration that the drag doesn't explain."""
    estimator = WindEstimator(ROBOT)
    fly_level(estimator, 0.0, 3.0, (3.0, 0.0, 0.0))
    for number, height_m in enumerate((3.0, 0.2, 3.0)):
        for step in range(15):
            estimator.update(leveled(5.0 + 0.3 * number + 0.02 * step, (3.0 + number, 0.0, 0.0)), aloft(height_m))
    assert estimator.wind is not None
    assert estimator.wind.mean_ned_mps == pytest.approx((3.0, 0.0, 0.0))


@pytest.mark.parametrize(("roll_rad", "known"), [(0.9, True), (1.2, False)])
def test_a_vehicle_beyond_60_degrees_of_tilt_says_nothing_about_the_wind(roll_rad: float, known: bool) -> None:
    rolled = (cos(roll_rad / 2.0), sin(roll_rad / 2.0), 0.0, 0.0)
    assert (wind_ned_mps(STILL, STILL, rolled, ROBOT) is not None) is known


@pytest.mark.parametrize("down_mps", [0.0, -2.0, 1.0])
def test_a_steady_climb_or_descent_is_no_acceleration(down_mps: float) -> None:
    """Nose down by 0.2 rad, it leans into a wind from the north. In the plane of the rotors the motion through the air
    is that of the wind and of the climb: 0.45 v + 0.036 v² = 1.5 · 9.81 · sin(0.2), v = -wind · cos(0.2) - down ·
    sin(-0.2)."""
    estimator = WindEstimator(ROBOT)
    for step in range(150):
        odometry = replace(leveled(0.02 * step, (0.0, 0.0, down_mps)), q_ned_from_frd=pitched(-0.2))
        estimator.update(odometry, aloft())
    in_plane_mps = (sqrt(0.45**2 + 4.0 * 0.036 * 1.5 * 9.81 * sin(0.2)) - 0.45) / (2.0 * 0.036)
    north_mps = -(in_plane_mps - down_mps * sin(0.2)) / cos(0.2)
    assert estimator.wind is not None
    assert estimator.wind.mean_ned_mps == pytest.approx((north_mps, 0.0, 0.0), abs=1e-3)


def test_a_vehicle_that_spins_upside_down_adds_no_sample() -> None:
    estimator = WindEstimator(ROBOT)
    for step in range(200):
        odometry = replace(leveled(0.02 * step), q_ned_from_frd=pitched(3.0))
        estimator.update(odometry, aloft())
    assert estimator.wind is None


def test_the_wind_is_found_while_it_carries_a_level_vehicle_along() -> None:
    estimator, vel_mps = WindEstimator(ROBOT), 0.0
    flying = VehicleSnapshot(t_ns=0, timer_ns=0, armed=True, landed=False, height_m=3.0)
    for step in range(120):
        odometry = Odometry(
            t_ns=1 + step * 20_000_000,
            epoch_id=1,
            pos_uav_ned_m=(0.0, 0.0, -3.0),
            vel_uav_ned_mps=(vel_mps, 0.0, 0.0),
            q_ned_from_frd=pitched(0.0),
            rates_uav_frd_rps=STILL,
        )
        estimator.update(odometry, flying)
        air_mps = 4.0 - vel_mps
        vel_mps += 0.02 * (0.45 + 0.036 * air_mps) * air_mps / 1.5
    assert estimator.wind is not None
    assert estimator.wind.mean_ned_mps == pytest.approx((4.0, 0.0, 0.0), abs=0.05)
    assert estimator.wind.std_gust_mps < 0.03
