"""Vehicles that run away from their setpoints, and those that only seem to."""

from math import hypot, radians

import pytest

from jezero.base.frames import horizontal
from jezero.runtime.service import Service
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from jezero.services.simulator.service import Simulator
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight, go_to


def flight_with_simulator(seed: int) -> tuple[Flight, Simulator]:
    simulators: list[Simulator] = []

    def keep(service: Service) -> Service:
        assert isinstance(service, Simulator)
        simulators.append(service)
        return service

    return Flight(seed, lambda seed: build_stack(seed, wrap_simulator=keep)), simulators[0]


@pytest.mark.long
def test_a_goal_in_a_storm_that_carries_the_vehicle_off_ends_with_distance_duration_and_what_to_check() -> None:
    flight, simulator = flight_with_simulator(5)
    flight.take_off(5.0)
    request = flight.send(topics.GO_TO, go_to(60.0, 0.0, -8.0))
    flight.bus.run_for(3.0)
    simulator.change_wind(20.0, 0.0)
    result = flight.finish(request, 6.0)
    assert result.outcome == "aborted"
    assert "the vehicle runs away from its setpoint: its position is" in result.reason
    assert "in 2.1 s against the command; check the compass" in result.reason
    simulator.change_wind(3.0, 0.0)
    flight.bus.run_for(15.0)
    assert flight.status.code == StatusCode.HOVER
    assert hypot(*flight.truth.vel_uav_ned_mps) < 1.0


@pytest.mark.long
@pytest.mark.parametrize("error_deg", [45.0, 120.0])
def test_a_compass_that_jumps_in_flight_neither_leads_the_vehicle_away_nor_ends_its_goal(error_deg: float) -> None:
    """The autopilot rejects a compass that contradicts the gyroscope."""
    flight, simulator = flight_with_simulator(5)
    flight.take_off(5.0)
    request = flight.send(topics.GO_TO, go_to(30.0, 0.0, -8.0))
    flight.bus.run_for(3.0)
    simulator.turn_compass(radians(error_deg))
    result = flight.finish(request)
    assert result.outcome == "succeeded", result.reason
    assert horizontal(flight.truth.pos_uav_ned_m) < 32.0
