"""The barometer is 9 m wrong for good: the autopilot believes it after some seconds, and the ground comes too early."""

from jezero.base.frames import altitude_m
from jezero.base.mavlink import MavMessage, dialect
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from tests.scenario.rig import Flight, go_to

ERROR_M = 9.0


def raise_barometer(message: MavMessage) -> bool:
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_SENSOR:
        message.pressure_alt += ERROR_M
    return True


def test_a_goal_that_would_fly_into_the_ground_ends_with_a_hover_above_it() -> None:
    flight, simulator = Flight.with_tampered_simulator(raise_barometer, seed=3)
    flight.take_off(3.0)
    simulator.active = True
    flight.wait(lambda: altitude_m((flight.status.odometry or flight.truth).pos_uav_ned_m[2]) > 8.0, 10.0, "a reset")
    start = len(flight.truths)
    result = flight.finish(flight.send(topics.GO_TO, go_to(3.0, 0.0, -3.0)))
    assert result.outcome == "aborted"
    assert "the altimeter measures only" in result.reason
    flight.wait_code(StatusCode.HOVER, 5.0)
    flight.bus.run_for(3.0)
    assert min(altitude_m(t.pos_uav_ned_m[2]) for t in flight.truths[start:]) > 0.15
