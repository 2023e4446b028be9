"""Landings on the rover that the wind forbids, or makes slide off an icy platform."""

from math import degrees

import pytest
from msgspec.structs import replace

from jezero.base.config import load_config
from jezero.base.frames import horizontal, subtract, tilt_from_quat
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.service import Service
from jezero.schemas import topics
from jezero.schemas.actions import Accepted
from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.state import StatusCode
from jezero.services.simulator.config import SimulatorConfig, WindConfig
from jezero.services.simulator.service import Simulator
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight

FRICTION_ICE = 0.05


def test_a_landing_in_more_wind_than_the_limit_is_refused_with_the_wind_and_accepted_with_force() -> None:
    simulators: list[Simulator] = []

    def keep(service: Service) -> Service:
        assert isinstance(service, Simulator)
        simulators.append(service)
        return service

    flight = Flight(1, lambda seed: build_stack(seed, wrap_simulator=keep))
    flight.take_off(4.0)
    simulators[0].change_wind(14.0, 40.0)

    def is_windy() -> bool:
        wind_ned_mps = flight.status.wind_ned_mps
        return wind_ned_mps is not None and horizontal(wind_ned_mps) > 12.5

    flight.wait(is_windy, 30.0, "an estimated wind above the limit")
    reason = flight.refusal(topics.LAND_ON_SPOT, LandOnSpotGoal())
    assert "the wind is 12." in reason
    assert "a landing is limited to 12 m/s (wind_max_mps): wait for less wind, or use force" in reason
    assert flight.status.code == StatusCode.HOVER
    assert isinstance(flight.send(topics.LAND_ON_SPOT, LandOnSpotGoal(force=True)).replies[0], Accepted)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_vehicle_that_slides_on_the_platform_four_times_ends_in_a_hover_whose_reason_names_the_wind(
    seed: int,
) -> None:
    def icy(seed: int) -> MemoryBus:
        shipped = load_config(SimulatorConfig, "simulator")
        wind = WindConfig(mean_mps=8.0, from_deg=77.0 * seed, std_gust_mps=1.0)
        rover = replace(shipped.rover, friction_platform=FRICTION_ICE)
        return build_stack(seed, simulator=replace(shipped, wind=wind, rover=rover))

    flight = Flight(seed, icy)
    flight.take_off(4.0)
    start = len(flight.truths)
    result = flight.finish(flight.send(topics.LAND_ON_SPOT, LandOnSpotGoal()))
    assert result.outcome == "aborted"
    assert "the vehicle slid on what it touched, in spite of 3 go-arounds: the wind is" in result.reason
    assert "wait for less wind, or land elsewhere" in result.reason
    flight.wait_code(StatusCode.HOVER, 8.0)
    flight.bus.run_for(3.0)
    assert flight.status.armed
    assert flight.truth.contact_force_n == 0.0
    offset_m = [horizontal(subtract(t.pos_uav_ned_m, t.pos_rover_ned_m)) for t in flight.truths[-100:]]
    assert max(offset_m) < 2.0
    assert max(degrees(tilt_from_quat(truth.q_ned_from_frd)) for truth in flight.truths[start:]) < 60.0
