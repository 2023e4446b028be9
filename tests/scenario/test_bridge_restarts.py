"""The vehicle bridge dies in every phase of a flight and is started again; tests/system/test_px4.py repeats it on PX4.

The embedded autopilot sends its origin once, as PX4 does, so a bridge that starts later gets it on request only.
"""

from collections.abc import Callable

import pytest

from tests.scenario.bridge_restarts import RESTARTS, BridgeFlight


@pytest.mark.long
@pytest.mark.parametrize(("restart", "phase"), RESTARTS)
def test_a_bridge_restarted_in_any_phase_takes_off_again(
    restart: Callable[[BridgeFlight, str], None], phase: str
) -> None:
    restart(BridgeFlight(), phase)
