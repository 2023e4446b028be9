"""Missions of the command line: goals, each with the time in seconds to hover after it."""

from typing import Any

from jezero.schemas import topics
from jezero.schemas.actions import AreaCoverageGoal, GetImagesGoal, GoToGoal, LandOnSpotGoal, TakeoffGoal

Mission = tuple[tuple[topics.Action[Any], Any, float], ...]

FLIGHT: Mission = (
    (topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 1.0),
    (topics.GO_TO, GoToGoal(target_ned_m=(-1.0, -2.0, -3.0)), 3.0),
    (topics.GO_TO, GoToGoal(target_ned_m=(0.0, -2.0, -6.0)), 0.0),
    (topics.LAND_ON_SPOT, LandOnSpotGoal(), 0.0),
)
"""The mission of `jezero fly`: two points, then a landing on the rover (thesis Figs 3.5, 3.6, 4.8 to 4.15)."""

DEMONSTRATION: Mission = (
    (topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 1.0),
    (
        topics.GET_IMAGES,
        GetImagesGoal(center_ned_m=(0.0, 0.0, -3.0), radius_m=3.0, num_images=4, frame="rover"),
        0.0,
    ),
    (
        topics.AREA_COVERAGE,
        AreaCoverageGoal(
            polygon_ned_m=((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)),
            z_ned_m=-5.0,
            resolution_m=1.0,
            frame="rover",
        ),
        0.0,
    ),
    (topics.LAND_ON_SPOT, LandOnSpotGoal(), 0.0),
)
"""The mission of `jezero demo`: images of the rover from all sides, a survey of its surroundings, a landing on it."""
