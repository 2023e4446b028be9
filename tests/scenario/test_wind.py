"""Flights in winds of 8 and 10 m/s with gusts: what is "reached" there."""

from math import hypot

import pytest
from msgspec.structs import replace

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.goals import GetImagesGoal, TakeoffGoal
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.config import SimulatorConfig, WindConfig
from jezero.trials.stack import BlankCamera, build_stack
from tests.scenario.rig import Flight, go_to

LIMIT_S = 20.0
"""A goal that a wait for calmer wind keeps from its end ends later, or not at all."""


def windy(seed: int, mean_mps: float = 8.0, std_gust_mps: float = 1.5) -> MemoryBus:
    wind = WindConfig(mean_mps=mean_mps, from_deg=77.0 * seed, std_gust_mps=std_gust_mps)
    simulator = replace(load_config(SimulatorConfig, "simulator"), wind=wind)
    bus = build_stack(seed, simulator=simulator)
    camera, mount = load_config(CameraConfig, "camera"), load_config(VehicleConfig, "vehicle").camera
    bus.add(BlankCamera(camera, mount, publishes_info=False))
    return bus


@pytest.mark.parametrize("seed", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_a_takeoff_and_a_flight_in_wind_end_while_the_vehicle_sways_about_their_ends(seed: int) -> None:
    flight = Flight(seed, windy)
    flight.wait_ready()
    for action, goal in (
        (topics.TAKEOFF, TakeoffGoal(altitude_m=2.0)),
        (topics.GO_TO, go_to(8.0, 0.0, -4.0)),
    ):
        start_ns = flight.bus.t_ns
        flight.do(action, goal)
        assert (flight.bus.t_ns - start_ns) * 1e-9 < LIMIT_S
    odometry = flight.status.odometry
    assert odometry is not None
    north_m, east_m, down_m = odometry.pos_uav_ned_m
    assert hypot(north_m - 8.0, east_m, down_m + 4.0) < 1.0


@pytest.mark.parametrize("seed", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_a_takeoff_whose_vehicle_is_carried_off_by_gusts_succeeds_when_it_has_come_back(seed: int) -> None:
    """The gusts are stronger than the vehicle: they carry it more than 10 m away, for up to 20 s."""
    flight = Flight(seed, lambda seed: windy(seed, 10.0, 2.0))
    flight.take_off(6.0)
    odometry = flight.status.odometry
    assert odometry is not None
    assert hypot(*odometry.pos_uav_ned_m[:2]) < 2.5
    assert abs(odometry.pos_uav_ned_m[2] + 6.0) < 0.5


def test_an_orbit_in_wind_begins_and_ends() -> None:
    flight = Flight(1, windy)
    flight.take_off(3.0)
    flight.do(topics.GET_IMAGES, GetImagesGoal(center_ned_m=(6.0, 0.0, -3.0), radius_m=3.0, num_images=4))
