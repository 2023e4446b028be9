"""A goal with a target in the rover's frame follows a driving rover, and ends without a valid estimate."""

from math import hypot

import pytest

from jezero.base.frames import subtract
from jezero.schemas import topics
from jezero.schemas.actions import Accepted
from jezero.schemas.state import StatusCode
from jezero.trials.stack import RoverDriver
from tests.scenario.rig import Flight, go_to


def off_target_m(flight: Flight, target_ned_m: tuple[float, float, float]) -> float:
    """True horizontal distance of the vehicle from a target in the rover's frame."""
    truth = flight.truth
    north, east, _ = subtract(subtract(truth.pos_uav_ned_m, truth.pos_rover_ned_m), target_ned_m)
    return hypot(north, east)


@pytest.mark.long
def test_a_goal_in_the_rovers_frame_follows_a_driving_rover_and_ends_with_the_estimate() -> None:
    flight = Flight(seed=3)
    driver = RoverDriver()
    flight.bus.add(driver)
    flight.take_off(2.0)
    driver.speed_mps = 0.5
    target_ned_m = (-1.0, 0.5, -3.0)
    request = flight.send(topics.GO_TO, go_to(*target_ned_m, frame="rover"))
    moved = flight.finish(request).result
    assert moved is not None and moved.completed
    feedback = request.replies[-2].feedback
    assert feedback.frame == "rover"
    assert feedback.pos_uav_ned_m == pytest.approx(target_ned_m, abs=0.3)
    assert off_target_m(flight, target_ned_m) < 0.3
    assert hypot(*flight.truth.vel_rover_ned_mps[:2]) > 0.4

    flying = flight.send(topics.GO_TO, go_to(3.0, 0.0, -3.0, frame="rover", speed_mps=0.5))
    assert isinstance(flying.replies[0], Accepted)
    flight.bus.run_for(2.0)
    flight.bus.remove("estimator")
    aborted = flight.finish(flying, timeout_s=5.0)
    assert aborted.outcome == "aborted"
    assert "the estimator is silent" in aborted.reason
    flight.wait_code(StatusCode.HOVER, timeout_s=2.0)

    assert "the estimator is silent" in flight.refusal(topics.GO_TO, go_to(0.0, 0.0, -3.0, frame="rover"))
    assert flight.codes[-1] is StatusCode.HOVER
