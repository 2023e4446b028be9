"""Measurements over a platform with roll and pitch: exact ones fit the exact position."""

import numpy as np
import pytest

from jezero.base.frames import Vec3, quat_from_euler, quat_rotate
from jezero.base.vehicle_config import PlatformConfig
from jezero.schemas.sensors import RoverOdometry
from jezero.services.estimator.config import Tuning
from jezero.services.estimator.kalman import FilterState, Kalman
from jezero.services.estimator.measurements import AltimeterMeasurement, Measurement, UwbMeasurement
from jezero.services.estimator.motion import POS_ROVER, POS_UAV, YAW, MotionModel, initial_state
from jezero.services.estimator.rover_tilt import level_from_rover_body
from jezero.services.estimator.uwb_initialization import ROUNDS_MIN, UwbWindow

ROVER = RoverOdometry(
    t_ns=0,
    pos_odom_m=(0.0, 0.0),
    yaw_rover_rad=0.7,
    speed_rover_body_mps=0.0,
    yaw_rate_rover_rps=0.0,
    roll_rover_rad=0.2,
    pitch_rover_rad=-0.15,
)
Q_NED_FROM_ROVER_BODY = quat_from_euler(ROVER.roll_rover_rad, ROVER.pitch_rover_rad, ROVER.yaw_rover_rad)
ANCHORS_M: tuple[Vec3, ...] = ((0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0), (-0.5, 0.5, 0.0))
POS_REL_M = np.array((0.05, -0.1, -2.0))


def kalman() -> Kalman:
    """A filter that knows the vehicle's position relative to the rover."""
    x, P = initial_state(np.zeros(3), Tuning())
    x[POS_ROVER] = -POS_REL_M
    x[YAW] = ROVER.yaw_rover_rad
    P[POS_UAV, POS_UAV] = P[POS_ROVER, POS_ROVER] = 0.01 * np.eye(3)
    P[YAW, YAW] = 1e-6
    filter_ = Kalman(MotionModel(Tuning()))
    filter_.restore(FilterState(0, x, P))
    return filter_


def uwb(t_ns: int = 0) -> UwbMeasurement:
    anchors_ned_m = np.array([quat_rotate(Q_NED_FROM_ROVER_BODY, anchor_m) for anchor_m in ANCHORS_M])
    ranges_m = np.linalg.norm(POS_REL_M - anchors_ned_m, axis=1)
    level = level_from_rover_body(ROVER)
    return UwbMeasurement(t_ns, np.zeros(3), np.array(ANCHORS_M), ranges_m, np.zeros(4), 0.01, level)


def altimeter() -> AltimeterMeasurement:
    """A beam straight down onto the platform's plane through its centre."""
    normal_ned = np.array(quat_rotate(Q_NED_FROM_ROVER_BODY, (0.0, 0.0, 1.0)))
    range_m = float(-(POS_REL_M @ normal_ned) / normal_ned[2])
    normal_level = level_from_rover_body(ROVER)[:, 2]
    return AltimeterMeasurement(0, range_m, np.zeros(3), np.array((0.0, 0.0, 1.0)), 2.0, 0.01, normal_level)


@pytest.mark.parametrize("measurement", [uwb(), altimeter()])
def test_an_exact_measurement_over_a_tilted_platform_leaves_the_exact_position(measurement: Measurement) -> None:
    filter_ = kalman()
    result = measurement.fuse(filter_, (9.0, 16.0))
    assert result.used == result.offered > 0
    assert filter_.pos_rel_m == pytest.approx(POS_REL_M, abs=1e-6)


def test_the_first_position_by_uwb_takes_the_tilt_into_account() -> None:
    window = UwbWindow(PlatformConfig())
    for number in range(ROUNDS_MIN):
        window.add(uwb(number * 10_000_000))
    found = window.position(ROUNDS_MIN * 10_000_000, np.zeros(3), ROVER.yaw_rover_rad)
    assert found is not None
    assert found[0] == pytest.approx(POS_REL_M, abs=1e-3)
