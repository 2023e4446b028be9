"""The way home, in virtual time with the whole stack."""

from jezero.frames import distance, horizontal, subtract
from jezero.schemas import topics
from jezero.schemas.goals import ReturnHomeGoal
from tests.scenario.rig import Flight, go_to


def test_a_vehicle_far_out_of_sight_of_the_rover_returns_over_a_safe_height_and_lands_on_it() -> None:
    flight = Flight(1)
    flight.take_off(3.0)
    flight.do(topics.GO_TO, go_to(40.0, 10.0, -4.0))
    before = len(flight.truths)
    result = flight.do(topics.RETURN_HOME, ReturnHomeGoal()).result
    assert result is not None
    assert result.place == "rover"
    assert "by its odometry" in result.reason or "in sight" in result.reason
    away = [truth for truth in flight.truths[before:] if horizontal(subtract(truth.pos_uav_ned_m, (40, 10, 0))) > 5.0]
    assert min(truth.pos_uav_ned_m[2] for truth in away) < -9.0
    assert distance(flight.truth.pos_uav_ned_m, flight.truth.pos_rover_ned_m) < 0.15
