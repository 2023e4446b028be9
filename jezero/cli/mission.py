"""The demonstration flight: take off, fly to (-1, -2, -3), hover, come back, land (thesis Figs 3.5 and 3.6)."""

from typing import Any

from jezero.schemas import topics
from jezero.schemas.actions import GoToGoal, LandOnSpotGoal, TakeoffGoal

HOVER_S = 3.0
LANDING_SPOT_NED_M = (0.0, 0.0, 0.0)
TITLE = "Take off, fly to (−1, −2, −3), hover, come back, land"

MISSION: tuple[tuple[topics.Action[Any], Any, float], ...] = (
    (topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 1.0),
    (topics.GO_TO, GoToGoal(target_ned_m=(-1.0, -2.0, -3.0)), HOVER_S),
    (topics.GO_TO, GoToGoal(target_ned_m=(0.0, 0.0, -3.0)), 0.0),
    (topics.LAND_ON_SPOT, LandOnSpotGoal(landing_spot_ned_m=LANDING_SPOT_NED_M, use_uwb=False, use_marker=False), 0.0),
)
"""Each goal with the seconds to hover after it."""
