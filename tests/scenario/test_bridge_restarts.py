"""The vehicle bridge dies in every phase of a flight and is started again; tests/system/test_px4.py repeats it on PX4.

The embedded autopilot sends its origin once, as PX4 does, so a bridge that starts later gets it on request only.
"""

from collections.abc import Callable

import pytest

from tests.scenario.bridge_restarts import RESTARTS, BridgeFlight

LIKE_GO_TO = ("orbit", "coverage")
"""Phases of other goals than go_to, in which the bridge does the same: `pytest -m slow` flies them."""
CASES = [pytest.param(*each, marks=pytest.mark.slow if each[1] in LIKE_GO_TO else ()) for each in RESTARTS]


@pytest.mark.long
@pytest.mark.parametrize(("restart", "phase"), CASES)
def test_a_bridge_restarted_in_any_phase_takes_off_again(
    restart: Callable[[BridgeFlight, str], None], phase: str
) -> None:
    restart(BridgeFlight(), phase)
