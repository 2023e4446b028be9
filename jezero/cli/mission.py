"""The demonstration flight: take off, fly to (-1, -2, -3), hover, climb, land on the rover (thesis Figs 3.5, 3.6, 4.8
to 4.15)."""

from typing import Any

from jezero.schemas import topics
from jezero.schemas.actions import GoToGoal, LandOnSpotGoal, TakeoffGoal

MISSION: tuple[tuple[topics.Action[Any], Any, float], ...] = (
    (topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 1.0),
    (topics.GO_TO, GoToGoal(target_ned_m=(-1.0, -2.0, -3.0)), 3.0),
    (topics.GO_TO, GoToGoal(target_ned_m=(0.0, -2.0, -6.0)), 0.0),
    (topics.LAND_ON_SPOT, LandOnSpotGoal(), 0.0),
)
"""Each goal with the seconds to hover after it."""
