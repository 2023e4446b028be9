"""Missions that the command line and the tests fly: those of the files, as goals each with a time to hover after it."""

from typing import Any

import msgspec

from jezero.mission_files import shipped_mission
from jezero.schemas.mission import Mission as ListedMission
from jezero.schemas.mission import WaitStep
from jezero.schemas.rows import Action
from jezero.schemas.topics import ACTIONS

Mission = tuple[tuple[Action[Any], Any, float], ...]


def with_hovers(mission: ListedMission) -> Mission:
    """A mission's goals, each with the time in seconds to hover after it."""
    goals: list[tuple[Action[Any], Any, float]] = []
    for step in mission.steps:
        if isinstance(step, WaitStep):
            action, goal, hover_s = goals.pop()
            goals.append((action, goal, hover_s + step.duration_s))
        else:
            action = ACTIONS[step.action]
            goals.append((action, msgspec.convert(step.goal, action.goal_type), 0.0))
    return tuple(goals)


FLIGHT = with_hovers(shipped_mission("flight"))
"""The mission of `jezero fly`."""

DEMONSTRATION = with_hovers(shipped_mission("demonstration"))
"""The mission of `jezero demo`."""
