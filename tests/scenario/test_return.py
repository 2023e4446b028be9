"""The way home, in virtual time with the whole stack."""

import pytest

from jezero.base.frames import distance, horizontal, subtract
from jezero.schemas import topics
from jezero.schemas.fence import Fence, SetFence, Zone
from jezero.schemas.goals import ReturnHomeGoal
from tests.scenario.rig import Flight, go_to

pytestmark = pytest.mark.long


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


def zone(name: str, north_m: float, east_m: float, half_m: float) -> Zone:
    """A square around a point."""
    sides = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return Zone(name=name, corners_ned_m=tuple((north_m + a * half_m, east_m + b * half_m) for a, b in sides))


def test_a_return_whose_way_to_the_rover_and_the_takeoff_point_crosses_a_zone_lands_here_and_says_why() -> None:
    flight = Flight(1)
    flight.wait_ready()
    fence = Fence(keep_out=(zone("crater", 8.0, 0.0, 2.0),))
    assert flight.request(topics.SET_FENCE, SetFence(fence=fence)).accepted
    flight.bus.run_for(1.5)
    flight.take_off(3.0)
    for north_m, east_m in ((0.0, 8.0), (16.0, 8.0), (16.0, 0.0)):
        flight.do(topics.GO_TO, go_to(north_m, east_m, -3.0))
    result = flight.do(topics.RETURN_HOME, ReturnHomeGoal()).result
    assert result is not None
    assert result.place == "here"
    for place in ("rover", "takeoff point"):
        assert f"the {place} is left out: the way leaves the fence 'fence'" in result.reason
    assert "the zone 'crater' to stay out of" in result.reason
    assert horizontal(subtract(flight.truth.pos_uav_ned_m, (16.0, 0.0, 0.0))) < 1.0
    assert not flight.status.armed
