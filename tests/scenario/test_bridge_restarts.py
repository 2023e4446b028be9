"""The vehicle bridge dies in every phase of a flight and is started again; tests/system/test_px4.py repeats it on PX4.

The embedded autopilot sends its origin once, as PX4 does, so a bridge that starts later gets it on request only.
"""

import pytest

from tests.scenario.bridge_restarts import (
    AIR,
    GROUND,
    BridgeFlight,
    restart_after_the_failsafe_has_landed,
    restart_at_once,
    restart_on_the_ground,
    take_back_with_a_hover,
)


@pytest.mark.parametrize("phase", GROUND)
def test_a_bridge_restarted_on_the_ground_takes_off(phase: str) -> None:
    restart_on_the_ground(BridgeFlight(), phase)


@pytest.mark.parametrize("phase", AIR)
def test_a_bridge_restarted_in_flight_leaves_the_landing_to_the_autopilot_and_takes_off_again(phase: str) -> None:
    restart_at_once(BridgeFlight(), phase)


@pytest.mark.parametrize("phase", AIR)
def test_a_bridge_started_after_the_failsafe_has_landed_takes_off_again(phase: str) -> None:
    restart_after_the_failsafe_has_landed(BridgeFlight(), phase)


@pytest.mark.parametrize("phase", AIR)
def test_a_hover_requested_of_a_restarted_bridge_takes_the_vehicle_back(phase: str) -> None:
    take_back_with_a_hover(BridgeFlight(), phase)
