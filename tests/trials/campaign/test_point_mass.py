"""The point mass: how it moves, what it believes, and which faults it has."""

from math import atan, degrees

import pytest

from jezero.base.frames import Vec3, geodetic_from_ned, tilt_from_quat, yaw_from_quat
from jezero.base.vehicle_config import PlanetConfig
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.control import ControlSetpoint
from jezero.trials.campaign.faults import HIL, MAVLINK, Fault, Kind, draw_faults
from jezero.trials.campaign.mission import named_random
from jezero.trials.campaign.point_mass import Point, PointEstimate, PointPilot, point_mass_fault

G = 9.81
DT = 0.05
ORIGIN = (47.4, 8.5, 488.0)
NEVER_HERE = ("simulator", "autopilot", "imu", "uwb", "rover_odometry")


class Bench:
    """A point with its estimate and pilot, armed."""

    def __init__(self) -> None:
        config = AutopilotConfig()
        self.point = Point(G)
        self.estimate = PointEstimate(config.estimator, self.point, ORIGIN)
        self.pilot = PointPilot(config, self.point, self.estimate, PlanetConfig())
        self.t_us = 0

    def fly(self, seconds: float, setpoint: ControlSetpoint) -> None:
        for _ in range(round(seconds / DT)):
            self.t_us += round(DT * 1e6)
            self.estimate.tick(self.t_us)
            self.pilot.step(DT, setpoint, allow_takeoff=True)
            self.point.step(DT, self.pilot.wanted_ned_mps2, self.pilot.yaw_rate_rps)

    def fixes(self, seconds: float, error_ned_m: Vec3) -> None:
        for _ in range(round(seconds / 0.2)):
            self.t_us += 200_000
            self.estimate.tick(self.t_us)
            north, east, down = (p + e for p, e in zip(self.point.pos_ned_m, error_ned_m, strict=True))
            position_deg = geodetic_from_ned((north, east, down), ORIGIN)
            self.estimate.on_fix(Fix(self.t_us, position_deg, (0.0, 0.0, 0.0), True))
            self.estimate.on_baro(-down)


def test_it_takes_off_to_a_point_and_stays_there() -> None:
    bench = Bench()
    bench.fly(12.0, ControlSetpoint((3.0, -2.0, -4.0), yaw_rad=1.0))
    assert bench.point.pos_ned_m == pytest.approx((3.0, -2.0, -4.0), abs=0.05)
    assert bench.point.vel_ned_mps == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    assert bench.point.yaw_rad == pytest.approx(1.0, abs=0.01)
    assert not bench.pilot.detector.landed


def test_pressed_onto_the_ground_it_is_landed_within_two_seconds() -> None:
    bench = Bench()
    bench.fly(6.0, ControlSetpoint((0.0, 0.0, -1.0)))
    bench.fly(1.0 / 0.5 + 2.0, ControlSetpoint(vel_ned_mps=(0.0, 0.0, 0.5)))
    assert bench.pilot.detector.landed and bench.point.stands


def test_without_thrust_it_falls_and_stands_still_on_the_ground() -> None:
    bench = Bench()
    bench.fly(8.0, ControlSetpoint((0.0, 0.0, -4.0)))
    bench.pilot.stop()
    for _ in range(10):
        bench.point.step(DT, bench.pilot.wanted_ned_mps2, 0.0)
    assert bench.point.vel_ned_mps[2] == pytest.approx(G * 0.5, rel=0.25)
    for _ in range(20):
        bench.point.step(DT, bench.pilot.wanted_ned_mps2, 0.0)
    assert bench.point.stands and bench.point.vel_ned_mps == (0.0, 0.0, 0.0)


def test_its_attitude_is_the_one_that_pushes_it() -> None:
    point = Point(G)
    for _ in range(40):
        point.step(DT, (G / 2.0, 0.0, -0.001), 0.0)
    q = point.attitude(0.3)
    assert degrees(tilt_from_quat(q)) == pytest.approx(degrees(atan(0.5)), abs=0.1)
    assert point.tilt_rad == pytest.approx(tilt_from_quat(q), abs=1e-3)
    assert yaw_from_quat(q) == pytest.approx(0.3)


def test_sensors_that_insist_on_an_error_reset_the_estimate_and_small_errors_pull_it() -> None:
    bench = Bench()
    bench.fixes(4.0, (0.5, 0.0, 0.5))
    assert bench.estimate.reset_counter == 0
    assert bench.estimate.pos_ned_m == pytest.approx((0.5, 0.0, 0.5), abs=0.1)
    bench.fixes(2.0, (6.0, 0.0, 0.5))
    assert bench.estimate.reset_counter == 0 and "GNSS is" in bench.estimate.invalid_reason
    bench.fixes(2.0, (6.0, 0.0, 0.5))
    assert bench.estimate.reset_counter == 1 and bench.estimate.invalid_reason == ""
    assert bench.estimate.pos_ned_m[0] == pytest.approx(6.0, abs=0.2)
    assert bench.estimate.reset_offset_ned_m[0] == pytest.approx(5.5, abs=0.2)
    bench.fixes(4.0, (6.0, 0.0, -6.0))
    assert bench.estimate.reset_counter == 2
    assert bench.estimate.pos_ned_m[2] == pytest.approx(-6.0, abs=0.2)


def test_faults_of_what_the_point_mass_lacks_hit_what_it_has() -> None:
    faults = [point_mass_fault(f) for seed in range(200) for f in draw_faults(named_random(seed, "faults"), 42.0)]
    assert not any(name in fault.where.split(">") for fault in faults for name in NEVER_HERE)
    on_hil = Fault(Kind.BIT_FLIPS, "simulator>autopilot", HIL, 1.0, 2.0, 0.01)
    assert point_mass_fault(on_hil).where == "vehicle_bridge>point_mass"
    assert point_mass_fault(on_hil).path == MAVLINK
