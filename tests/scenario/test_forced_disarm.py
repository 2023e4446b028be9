"""Landing on the rover with an autopilot that never detects the ground: the goal's own conditions decide."""

import msgspec
import pytest

from jezero.base.config import load_config
from jezero.base.frames import altitude_m
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.state import StatusCode as Code
from jezero.services.actions.land_on_spot.rover_landing import CONTACT_TIMEOUT_S
from jezero.services.autopilot.config import AutopilotConfig
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight, go_to


def blind_to_the_ground(seed: int) -> MemoryBus:
    shipped = load_config(AutopilotConfig, "autopilot")
    detector = msgspec.structs.replace(shipped.land_detector, landed_s=1e3)
    return build_stack(seed, autopilot=msgspec.structs.replace(shipped, land_detector=detector))


def over_the_rover(seed: int) -> Flight:
    flight = Flight(seed, blind_to_the_ground)
    flight.take_off()
    north_m, east_m, _ = flight.truth.pos_rover_ned_m
    flight.do(topics.GO_TO, go_to(north_m, east_m, -3.5))
    return flight


def height_m(flight: Flight) -> float:
    return altitude_m(flight.truth.pos_uav_ned_m[2] - flight.truth.pos_rover_ned_m[2])


def test_it_is_disarmed_by_force_after_it_has_stood_on_the_platform_for_more_than_two_seconds() -> None:
    flight = over_the_rover(1)
    result = flight.do(topics.LAND_ON_SPOT, LandOnSpotGoal())
    assert result.outcome == "succeeded"
    assert not flight.status.armed
    assert flight.codes[-3:] == [Code.LANDING, Code.LANDING_DONE, Code.IDLE]
    off_ns = max(status.t_ns for status in flight.statuses if status.armed)
    stood = [t for t in flight.truths if off_ns - 2_000_000_000 < t.t_ns <= off_ns]
    assert len(stood) > 90
    assert all(altitude_m(t.pos_uav_ned_m[2] - t.pos_rover_ned_m[2]) < 0.1 for t in stood)
    assert any("by force" in status.text for status in flight.statuses)


@pytest.mark.long
def test_without_an_estimate_it_is_not_disarmed_and_climbs_away() -> None:
    flight = over_the_rover(2)
    begun = len(flight.statuses)
    request = flight.send(topics.LAND_ON_SPOT, LandOnSpotGoal())
    flight.wait(lambda: flight.truth.contact_force_n > 1.0 and height_m(flight) < 0.05, 40.0, "contact")
    flight.bus.remove("estimator")
    result = flight.finish(request, CONTACT_TIMEOUT_S + 10.0)
    assert result.outcome == "aborted"
    flight.wait_code(Code.HOVER, 8.0)
    assert all(status.armed and not status.landed for status in flight.statuses[begun:])
    flight.bus.run_for(2.0)
    assert height_m(flight) > 0.8
