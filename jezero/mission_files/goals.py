"""The goals of a mission file: fields by name, with named points and areas in their places."""

import re
from collections.abc import Mapping
from typing import Any

import msgspec

from jezero.base.mistakes import mistake, own_fields, unknown
from jezero.mission_files.nodes import FileNode
from jezero.mission_files.problems import Problems
from jezero.schemas.rows import Action

CHOSEN = ("goal_id", "issued_t_ns", "plan_id", "plan_from_ned_m", "on_client_loss")
"""Fields of a goal that the mission service chooses."""
RALLY_POINTS = "rally_points_ned_m"
"""Field of a return, which gets the mission's rally points unless the step has its own."""
PLACE = "_ned_m"
"""Fields whose names end so take the name of a point or of an area."""
HEIGHTS = {"altitude_m": 1.0, "z_ned_m": -1.0}
"""Fields that also take `{amsl_m: metres above sea level}`, and the sign of a height in them."""


class Places:
    """Points and areas by name.

    Args:
        origin_altitude_m: altitude of the world's origin above sea level; None where it is not known.

    Attributes:
        points: (3,) north, east and down by name.
        areas: fields of a coverage goal by name: polygon, holes, and origin.
        rally_points_m: (n, 2) north and east of the mission's rally points, for its returns.
        shown: what people read for a name of a loop: the name or the coordinates of its present point.
    """

    def __init__(self, origin_altitude_m: float | None = None) -> None:
        self.origin_altitude_m = origin_altitude_m
        self.points: dict[str, list[float]] = {}
        self.areas: dict[str, dict[str, Any]] = {}
        self.rally_points_m: list[list[float]] = []
        self.shown: dict[str, str] = {}

    def in_loop(self, name: str, point_m: list[float], shown: str) -> "Places":
        """A copy that also has the name of a loop, for the loop's present point."""
        places = Places(self.origin_altitude_m)
        places.points, places.areas = {**self.points, name: point_m}, self.areas
        places.rally_points_m = self.rally_points_m
        places.shown = {**self.shown, name: shown}
        return places

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self.points or name in self.areas)

    @property
    def names(self) -> list[str]:
        """Names of all points and areas."""
        return [*self.points, *self.areas]


def goal_fields(
    action: Action[Any], fields: Mapping[str, FileNode], line: int, places: Places, problems: Problems
) -> Any:
    """Fields of a goal, checked against the action's own goal type.

    Args:
        line: of the step.
    """
    own = [name for name in own_fields(action.goal_type) if name not in CHOSEN]
    goal: dict[str, Any] = {}
    if RALLY_POINTS in own and places.rally_points_m:
        goal[RALLY_POINTS] = places.rally_points_m
    before = len(problems.found)
    for name, node in fields.items():
        if name in CHOSEN:
            problems.add(node.line, f"{name} is chosen when the mission is flown: leave it out")
        elif name not in own:
            problems.add(node.line, f"{action.name}: {unknown('field', name, own)}")
        elif isinstance(node.value, dict) and name in HEIGHTS:
            goal[name] = HEIGHTS[name] * height_m(name, node, places, problems)
        elif isinstance(node.value, str) and name.endswith(PLACE):
            goal.update(_place(name, node, places, problems))
        else:
            goal[name] = node.plain
    if len(problems.found) == before:
        _check(action, goal, fields, line, problems)
    return goal


def height_m(name: str, node: FileNode, places: Places, problems: Problems) -> float:
    """Height above the world's origin of `{amsl_m: metres above sea level}`; 0 with a problem."""
    amsl_m = node.plain.get("amsl_m")
    if len(node.value) != 1 or not isinstance(amsl_m, int | float) or isinstance(amsl_m, bool):
        problems.add(node.line, f"{name} needs a number, or {{amsl_m: NUMBER}} for metres above sea level")
    elif places.origin_altitude_m is None:
        problems.add(
            node.line,
            f"{name} is {amsl_m:g} m above sea level, and the altitude of the world's origin is not known: ask a "
            "running stack, whose origin has one, or give the height above the origin",
        )
    elif amsl_m < places.origin_altitude_m:
        problems.add(
            node.line,
            f"{name}: {amsl_m:g} m above sea level is {places.origin_altitude_m - amsl_m:.1f} m below the world's "
            f"origin, which is {places.origin_altitude_m:g} m above sea level: correct one of the two",
        )
    else:
        return round(amsl_m - places.origin_altitude_m, 3)
    return 0.0


def _place(field: str, node: FileNode, places: Places, problems: Problems) -> dict[str, Any]:
    """The field, and for an area those that belong to it, from the name of a place."""
    name = node.value
    if name in places.areas and field == "polygon_ned_m":
        return places.areas[name]
    if name in places.points:
        point_m = places.points[name]
        return {field: point_m[:2] if field == "start_ned_m" else point_m}
    if name in places.areas:
        problems.add(node.line, f"{name!r} is an area, and {field} is a point")
        return {}
    problems.add(node.line, f"{field}: {unknown('point or area', name, places.names)}")
    return {}


def _check(
    action: Action[Any], goal: dict[str, Any], fields: Mapping[str, FileNode], line: int, problems: Problems
) -> None:
    try:
        msgspec.convert(goal, action.goal_type)
    except msgspec.ValidationError as error:
        text = mistake(error, action.goal_type)
        problems.add(line_of(text, fields, line), f"{action.name}: {text}")


def line_of(mistake: str, fields: Mapping[str, FileNode], line: int) -> int:
    """The line of the field that a mistake is about, as it begins with the field's path; else `line`."""
    found = re.match(r"\w+", mistake)
    return fields[found[0]].line if found and found[0] in fields else line
