"""GNSS jumps by 1.5 m while the vehicle hovers: the autopilot resets its position, and the vehicle stays in place."""

from math import degrees

import pytest

from jezero.base.frames import EARTH_RADIUS_M, horizontal, subtract
from jezero.base.mavlink import MavMessage, dialect
from jezero.schemas import topics
from tests.scenario.rig import Flight, go_to, land_at

STEP_NORTH_M = 1.5


def shift_north(message: MavMessage) -> bool:
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_GPS:
        message.lat += round(degrees(STEP_NORTH_M / EARTH_RADIUS_M) * 1e7)
    return True


@pytest.mark.long
def test_a_gnss_step_while_hovering_does_not_make_the_vehicle_jump() -> None:
    flight, simulator = Flight.with_tampered_simulator(shift_north, seed=3)
    flight.take_off(3.0)
    flight.bus.run_for(3.0)
    before = flight.truth
    simulator.active = True
    start = len(flight.truths)
    flight.bus.run_for(15.0)
    after = flight.truths[start:]
    odometry = flight.status.odometry
    assert odometry is not None
    assert odometry.reset_counter > 0
    assert 1.0 < odometry.reset_offset_ned_m[0] < 2.0
    assert max(horizontal(subtract(t.pos_uav_ned_m, before.pos_uav_ned_m)) for t in after) < 0.5
    assert max(horizontal(t.vel_uav_ned_mps) for t in after) < 0.5
    flight.do(topics.GO_TO, go_to(0.0, 0.0, -3.0))
    flight.do(topics.LAND_ON_SPOT, land_at(0.0, 0.0))
