"""Takeoffs beside a rover whose platform reaches over the vehicle's rotors, and holds the vehicle down."""

from math import degrees

import pytest
from msgspec.structs import replace

from jezero.base.config import load_config
from jezero.base.frames import altitude_m, tilt_from_quat
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.state import StatusCode
from jezero.services.simulator.config import SimulatorConfig
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight

ROVER_SENSING = ("estimator", "camera", "tag_detector")


def flight_beside_rover(north_m: float, east_m: float, yaw_rad: float) -> Flight:
    """A vehicle that stands at the map's origin, and a rover so near that its platform is above two rotors."""

    def make_bus(seed: int) -> MemoryBus:
        shipped = load_config(SimulatorConfig, "simulator")
        rover = replace(shipped.rover, start_north_m=north_m, start_east_m=east_m, start_yaw_rad=yaw_rad)
        return build_stack(seed, simulator=replace(shipped, rover=rover), without=ROVER_SENSING)

    return Flight(1, make_bus)


@pytest.mark.parametrize(
    ("north_m", "east_m", "yaw_rad"), [(0.0, 0.74, 0.0), (0.0, 0.78, 0.0), (0.2, 0.83, 0.3), (0.85, 0.0, 0.8)]
)
def test_the_motors_of_a_vehicle_that_the_platform_holds_down_are_cut_within_seconds(
    north_m: float, east_m: float, yaw_rad: float
) -> None:
    """The vehicle hangs nearly level beside the wheels: a limit of the tilt alone would let it push for ever."""
    flight = flight_beside_rover(north_m, east_m, yaw_rad)
    flight.wait_ready()
    request = flight.send(topics.TAKEOFF, TakeoffGoal(altitude_m=3.0))
    flight.wait(lambda: altitude_m(flight.truth.pos_uav_ned_m[2]) > 0.2, 10.0, "the vehicle under the platform")
    result = flight.finish(request, 8.0)
    assert "the vehicle is wedged near the ground" in result.reason
    assert "free it from what holds it" in result.reason
    flight.wait_code(StatusCode.IDLE, 3.0)
    assert not flight.truth.armed_motors
    assert degrees(tilt_from_quat(flight.truth.q_ned_from_frd)) < 20.0
