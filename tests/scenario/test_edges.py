"""Landings and hovers at the edge of the rover's platform, half of the vehicle beside it.

The vehicle must stay upright, whether the autopilot lands by itself, without a position, or a goal lands.
"""

from math import cos, degrees, pi, sin

import pytest

from benchmarks.quality.autopilot import READY_S, Target, fly, windy
from jezero.base.config import load_config
from jezero.base.frames import tilt_from_quat
from jezero.base.mavlink import dialect
from jezero.schemas import topics
from jezero.schemas.commands import Hover
from jezero.schemas.state import StatusCode, Truth
from jezero.services.autopilot.config import AutopilotConfig, FailsafeConfig
from jezero.services.simulator.config import SimulatorConfig
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight, go_to, land_at

pytestmark = pytest.mark.long

PLACES = 12
QUICK = (0, 9)  # 0.54 m north and 0.60 m west of the middle
CASES = [pytest.param(place, marks=() if place in QUICK else pytest.mark.slow) for place in range(PLACES)]
FALLEN_TILT_DEG = 60.0
SETPOINTS_END_S = READY_S + 16.0
HOVER_REQUEST_DELAY_S = 0.4
"""Time from the first contact to the request of a hover; by then the autopilot has reduced its thrust."""
ROVER_SENSING = ("estimator", "camera", "tag_detector")


def edge_ned_m(place: int) -> tuple[float, float]:
    """North and east of a point about the edge of the platform."""
    rover = load_config(SimulatorConfig, "simulator").rover
    away_m, direction_rad = 0.54 + 0.02 * (place % 6), 2.0 * pi * place / PLACES
    return rover.start_north_m + away_m * cos(direction_rad), rover.start_east_m + away_m * sin(direction_rad)


def tilt_deg(truth: Truth) -> float:
    return degrees(tilt_from_quat(truth.q_ned_from_frd))


def flying(place: int, altitude_m: float) -> Flight:
    """A stack without the services that detect the rover, in the air."""
    flight = Flight(place, lambda seed: build_stack(seed, without=ROVER_SENSING))
    flight.take_off(altitude_m)
    return flight


def assert_upright(truths: list[Truth], end_deg: float = 15.0) -> None:
    """Assert that the vehicle never falls over, and stands or hovers level at the end."""
    assert max(tilt_deg(truth) for truth in truths) < FALLEN_TILT_DEG
    assert tilt_deg(truths[-1]) < end_deg


@pytest.mark.parametrize("place", CASES)
def test_the_autopilot_steps_aside(place: int) -> None:
    """The setpoints stop above the edge, and the failsafe lands there."""
    north_m, east_m = edge_ned_m(place)

    def target(t_s: float) -> Target:
        if t_s > SETPOINTS_END_S:
            return None, None
        return ((0.0, 0.0, -3.0) if t_s < READY_S + 6.0 else (north_m, east_m, -3.0)), None

    flight = fly(target, place, SETPOINTS_END_S + 18.0, windy(1.5, 0.3))
    landing = [truth for truth in flight.truth if truth.t_ns > SETPOINTS_END_S * 1e9]
    assert_upright(landing, 5.0)
    assert not landing[-1].armed_motors


@pytest.mark.parametrize("place", CASES)
def test_the_autopilot_steps_aside_without_a_position(place: int) -> None:
    """GNSS fails 1 m above the edge."""
    config = AutopilotConfig(failsafe=FailsafeConfig(ekf2_noaid_tout_s=0.5))
    flight, simulator = Flight.with_tampered_simulator(
        lambda m: m.get_msgId() != dialect.MAVLINK_MSG_ID_HIL_GPS, place, autopilot=config, without=ROVER_SENSING
    )
    flight.take_off(3.0)
    flight.do(topics.GO_TO, go_to(*edge_ned_m(place), -1.0))
    start = len(flight.truths)
    simulator.active = True
    flight.wait(lambda: not flight.status.armed, 40.0, "disarmed")
    assert flight.codes[-2:] == [StatusCode.EXTERNAL, StatusCode.IDLE]
    assert_upright(flight.truths[start:], 10.0)


@pytest.mark.parametrize("place", CASES)
def test_a_hover_begins_right_after_contact(place: int) -> None:
    """The bridge is frozen, so the autopilot lands. After contact a hover is requested."""
    flight = flying(place, 2.0)
    flight.do(topics.GO_TO, go_to(*edge_ned_m(place), -1.5))
    flight.bus.freeze("vehicle_bridge", 2.0)
    flight.wait(lambda: flight.truth.contact_force_n > 0.0, 6.0, "touchdown")
    start = len(flight.truths)
    flight.bus.run_for(HOVER_REQUEST_DELAY_S)
    assert flight.request(topics.HOVER, Hover()).hover_mode
    flight.bus.run_for(5.0)
    assert_upright(flight.truths[start:])


@pytest.mark.parametrize("place", CASES)
def test_a_landing_stays_upright_when_the_bridge_freezes_at_contact(place: int) -> None:
    """The last setpoint pushes down, and the autopilot follows it for a second."""
    flight = flying(place, 2.0)
    flight.bus.send_request(topics.LAND_ON_SPOT.endpoint, land_at(*edge_ned_m(place)))
    flight.wait(lambda: flight.truth.contact_force_n > 0.0 and flight.status.code == StatusCode.LANDING, 30.0, "touch")
    start = len(flight.truths)
    flight.bus.freeze("vehicle_bridge", 4.0)
    flight.bus.run_for(12.0)
    assert_upright(flight.truths[start:])


@pytest.mark.parametrize("place", CASES)
def test_a_goal_ends_in_a_hover_or_on_the_platform(place: int) -> None:
    flight = flying(place, 3.0)
    start = len(flight.truths)
    result = flight.finish(flight.send(topics.LAND_ON_SPOT, land_at(*edge_ned_m(place))))
    flight.bus.run_for(3.0)
    assert max(tilt_deg(truth) for truth in flight.truths[start:]) < FALLEN_TILT_DEG
    if result.outcome == "succeeded":
        assert not flight.status.armed
    else:
        assert "an edge or a rock at the landing spot" in result.reason
        assert flight.status.code == StatusCode.HOVER
        assert tilt_deg(flight.truth) < 10.0
