"""How much odometry the actions need: flights whose autopilot sends it more rarely, as over a slow line."""

import pytest

from jezero.base.frames import distance
from jezero.base.mavlink import dialect
from jezero.schemas.topics import GO_TO, LAND_ON_SPOT
from jezero.services.vehicle_bridge import autopilot_link
from jezero.trials.landing.flight import Landing, fly_landing
from jezero.trials.landing.trial import Conditions
from tests.scenario.rig import Flight, go_to

ON_ROVER_M = 0.15
DRIVING = Conditions(case="uwb+tag", rover="zigzag")


def send_odometry(monkeypatch: pytest.MonkeyPatch, hz: float) -> None:
    """Let the bridge request odometry at another rate."""
    monkeypatch.setitem(autopilot_link.INTERVALS_US, dialect.MAVLINK_MSG_ID_ODOMETRY, int(1e6 / hz))


def land(monkeypatch: pytest.MonkeyPatch, hz: float) -> Landing:
    send_odometry(monkeypatch, hz)
    return fly_landing(1, DRIVING)


def test_a_landing_on_a_driving_rover_succeeds_with_half_of_the_odometry_that_it_declares(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    landing = land(monkeypatch, LAND_ON_SPOT.odometry_min_hz / 2.0)
    assert landing.failure == ""
    assert landing.error_m < ON_ROVER_M


def test_with_a_third_of_it_no_rover_is_found_and_nothing_crashes(monkeypatch: pytest.MonkeyPatch) -> None:
    landing = land(monkeypatch, LAND_ON_SPOT.odometry_min_hz / 3.0)
    assert "TARGET_LOST" in landing.failure
    assert not landing.crashed


def test_a_flight_to_a_point_succeeds_with_half_of_the_odometry_that_it_declares(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    send_odometry(monkeypatch, GO_TO.odometry_min_hz / 2.0)
    flight = Flight(5)
    flight.take_off(3.0)
    flight.do(GO_TO, go_to(8.0, 4.0, -4.0))
    odometry = flight.status.odometry
    assert odometry is not None
    assert distance(odometry.pos_uav_ned_m, (8.0, 4.0, -4.0)) < 0.3
