"""The rover drives; the vehicle rides on it, and takes off from it when it stands."""

from functools import partial
from math import hypot

import pytest

from jezero.base.config import load_config
from jezero.base.frames import subtract, wrap_pi
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.state import StatusCode
from jezero.services.simulator.config import SimulatorConfig, UavConfig
from jezero.trials.platform import on_platform_m
from jezero.trials.stack import RoverDriver, build_stack
from tests.scenario.rig import Flight

SHIPPED = load_config(SimulatorConfig, "simulator")
ON_THE_PLATFORM = SimulatorConfig(
    terrain=SHIPPED.terrain, wind=SHIPPED.wind, rover=SHIPPED.rover, uav=UavConfig(start="platform")
)


def riding() -> tuple[Flight, RoverDriver]:
    """A vehicle that is ready on the platform, and the driver of the rover."""
    flight = Flight(make_bus=partial(build_stack, simulator=ON_THE_PLATFORM))
    driver = RoverDriver()
    flight.bus.add(driver)
    flight.wait_ready()
    return flight, driver


@pytest.mark.long
def test_a_disarmed_vehicle_rides_along_and_takes_off_when_the_rover_stands() -> None:
    flight, driver = riding()
    before = flight.truth
    driver.speed_mps, driver.yaw_rate_rps = 1.0, 0.2
    flight.bus.run_for(30.0)
    after = flight.truth
    assert hypot(*subtract(after.pos_rover_ned_m, before.pos_rover_ned_m)[:2]) > 1.0
    assert hypot(after.vel_rover_ned_mps[0], after.vel_rover_ned_mps[1]) == pytest.approx(1.0, abs=0.01)
    slip_m = subtract(on_platform_m(after), on_platform_m(before))
    assert hypot(*slip_m) < 0.02
    assert all(status.landed and not status.armed for status in flight.statuses)
    refusal = flight.refusal(topics.TAKEOFF, TakeoffGoal(altitude_m=3.0))
    assert "moves at" in refusal
    assert "0.3 m/s is the limit" in refusal
    speed_mps = float(refusal.split("moves at ")[1].split(" m/s")[0])
    assert speed_mps == pytest.approx(1.0, abs=0.3)

    driver.speed_mps, driver.yaw_rate_rps = None, 0.0
    flight.bus.run_for(4.0)
    platform_ned_z_m = flight.truth.pos_rover_ned_m[2]
    assert flight.truth.vel_rover_ned_mps == (0.0, 0.0, 0.0)
    flight.do(topics.TAKEOFF, TakeoffGoal(altitude_m=3.0))
    assert flight.codes[-1] is StatusCode.HOVER
    assert platform_ned_z_m - flight.truth.pos_uav_ned_m[2] == pytest.approx(3.0, abs=0.4)


def test_a_rover_that_nobody_commands_stops_within_its_braking_distance() -> None:
    flight, driver = riding()
    yaw_rad = flight.truth.yaw_rover_rad
    driver.speed_mps, driver.yaw_rate_rps = -0.5, -0.3
    flight.bus.run_for(3.0)
    moving = flight.truth
    assert wrap_pi(moving.yaw_rover_rad - yaw_rad) < -0.5
    driver.speed_mps = None
    flight.bus.run_for(2.0)
    stopped = flight.truth
    assert stopped.vel_rover_ned_mps == (0.0, 0.0, 0.0)
    way_m = hypot(*subtract(stopped.pos_rover_ned_m, moving.pos_rover_ned_m)[:2])
    assert 0.5 * 0.5 < way_m < 0.5 * 0.6 + 0.5 * 0.5**2 / 0.5 + 0.05
