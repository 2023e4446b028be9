"""What a mission may do next, from its present state and the vehicle's."""

from typing import Any

from jezero.schemas.mission import GoalStep, Step
from jezero.schemas.state import Status
from jezero.schemas.struct import RallyPoints
from jezero.schemas.topics import LAND_ON_SPOT, RETURN_HOME
from jezero.services.mission.record import MissionRecord

SWAPPED_MIN = 0.5
"""Least charge, as a fraction of the capacity, that a new battery must have."""


def somebody_else(status: Status, mission_id: str) -> str:
    """Who else than the mission has control, or ""."""
    if status.in_charge in ("external", "failsafe"):
        return f"somebody else has control: {status.text}"
    if status.in_charge == "goal" and not flies_goal_of(status, mission_id):
        return f"the goal {status.action.replace('_', ' ')} of another client is in charge"
    return ""


def flies_goal_of(status: Status, mission_id: str) -> bool:
    """Whether a goal of the mission is in charge: it flies on while this service is restarted."""
    return status.goal_id.startswith(f"{mission_id}.")


def landing_step(step: Step) -> bool:
    """Whether a step ends on the ground, by landing."""
    return isinstance(step, GoalStep) and step.action in (LAND_ON_SPOT.name, RETURN_HOME.name)


def swap_refusal(record: MissionRecord, status: Status | None) -> str:
    """Reason why a mission can't go on with another battery, or ""."""
    if record.state != "interrupted":
        return f"the mission is {record.state}, no battery is waited for: jezero mission resume"
    if status is None or not status.landed or status.armed:
        return "the vehicle flies: land it first (jezero return), then change the battery"
    remaining = None if status.battery is None else status.battery.remaining
    if remaining is not None and remaining < SWAPPED_MIN:
        return f"the battery has {remaining:.0%}: put in one with at least {SWAPPED_MIN:.0%}, then send this again"
    return ""


def last_goal(then: str, status: Status, rally_points_ned_m: RallyPoints) -> GoalStep:
    """The goal that ends a mission after a failure.

    Args:
        rally_points_ned_m: of the mission.
    """
    if then == "return":
        goal: dict[str, Any] = {"rally_points_ned_m": rally_points_ned_m} if rally_points_ned_m else {}
        return GoalStep(label="return home", action=RETURN_HOME.name, goal=goal)
    assert status.odometry is not None
    north_m, east_m, _ = status.odometry.pos_uav_ned_m
    goal = {"landing_spot_ned_m": [north_m, east_m, 0.0], "use_uwb": False, "use_tag": False}
    return GoalStep(label="land here", action=LAND_ON_SPOT.name, goal=goal)
