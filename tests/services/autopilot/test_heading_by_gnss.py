"""A vehicle without a magnetometer: two antennas of the GNSS receiver give the heading, over the HIL link."""

from math import pi, radians

import pytest
from msgspec import UNSET

from jezero.base.frames import Quat, Vec3, geodetic_from_ned, wrap_pi, yaw_from_quat
from jezero.schemas.sensors import Gnss
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import StateEstimatorConfig
from jezero.services.autopilot.estimator import StateEstimator
from jezero.services.autopilot.hil import HilLink
from jezero.services.simulator.hil import HilPort
from tests.services.autopilot.made_up_flight import DT_US, ORIGIN, G, World, pose, velocity

YAW_RAD = 2.6
FIELD_FROM_THE_SIDE: Vec3 = (0.0, 0.216, 0.432)


class Standing:
    """A vehicle that stands still for as long as it is run."""

    def __init__(self) -> None:
        self.estimator = StateEstimator(StateEstimatorConfig(), G, "gnss")
        self._step = 0

    def run(self, seconds: float, yaw_rad: float | None, rate_rps: float = 0.0) -> None:
        for _ in range(round(seconds * 1e6 / DT_US)):
            self._step += 1
            self.estimator.on_imu(self._step * DT_US, (0.0, 0.0, -G), (0.0, 0.0, rate_rps))
            if self._step % 25 == 0:
                self.estimator.on_fix(Fix(self._step * DT_US, ORIGIN, (0.0, 0.0, 0.0), valid=True, yaw_rad=yaw_rad))
                self.estimator.on_baro(100.0)
                self.estimator.on_mag(FIELD_FROM_THE_SIDE)


def test_the_heading_is_that_of_the_receiver_and_no_magnetometer_matters() -> None:
    standing = Standing()
    standing.run(5.0, YAW_RAD)
    assert standing.estimator.running
    assert yaw_from_quat(standing.estimator.q_ned_from_frd) == pytest.approx(YAW_RAD, abs=0.01)
    standing.run(20.0, YAW_RAD + 0.1)
    assert standing.estimator.yaw_rad == pytest.approx(YAW_RAD + 0.1, abs=0.04)


def test_the_filter_waits_for_a_heading() -> None:
    standing = Standing()
    standing.run(5.0, None)
    assert not standing.estimator.running
    assert standing.estimator.invalid_reason == "the GNSS receiver measures no heading yet"


def test_a_heading_that_contradicts_the_estimate_is_named() -> None:
    standing = Standing()
    standing.run(5.0, YAW_RAD)
    standing.estimator.on_landed(landed=False)
    standing.run(1.0, wrap_pi(YAW_RAD + 1.5))
    assert "the GNSS receiver's heading is 86 degrees off" in standing.estimator.invalid_reason
    assert standing.estimator.yaw_rad == pytest.approx(YAW_RAD, abs=0.02)


def test_a_heading_counts_at_the_time_of_its_fix() -> None:
    """A late heading of a vehicle that turns would otherwise pull the estimate back."""

    class Turning(World):
        def _slow(self, pos: Vec3, q: Quat) -> None:
            then_s = self.t_s - 0.3
            then_ned_m, q_then = pose(then_s)
            place, t_us = geodetic_from_ned(then_ned_m, ORIGIN), round(then_s * 1e6)
            fix = Fix(t_us, place, velocity(then_s), valid=True, yaw_rad=yaw_from_quat(q_then))
            self.estimator.on_fix(fix)
            self.estimator.on_baro(100.0 - pos[2])

    world = Turning()
    world.estimator = StateEstimator(StateEstimatorConfig(), G, "gnss")
    world.run(30.0)
    assert world.estimator.running
    assert abs(world.error()[2]) < 0.015


@pytest.mark.parametrize("yaw_rad", [0.0, 0.5, -0.5, pi, -3.1, 1e-5])
def test_a_heading_survives_the_link(yaw_rad: float) -> None:
    fix = Gnss(
        t_ns=1_000_000_000,
        position_deg=ORIGIN,
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        std_horizontal_m=0.4,
        std_vertical_m=0.5,
        satellites=8,
        yaw_uav_rad=yaw_rad,
    )
    (received,) = HilLink(1).receive(HilPort().gps(fix))
    assert isinstance(received, Fix)
    assert received.yaw_rad is not None
    assert wrap_pi(received.yaw_rad - yaw_rad) == pytest.approx(0.0, abs=radians(0.006))


def test_a_receiver_with_one_antenna_gives_no_heading() -> None:
    fix = Gnss(
        t_ns=0,
        position_deg=ORIGIN,
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        std_horizontal_m=0.4,
        std_vertical_m=0.5,
        satellites=8,
    )
    assert fix.yaw_uav_rad is UNSET
    (received,) = HilLink(1).receive(HilPort().gps(fix))
    assert isinstance(received, Fix)
    assert received.yaw_rad is None
