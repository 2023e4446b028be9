"""Reads a mission file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from jezero.base.files import NOT_UTF8
from jezero.base.mistakes import mistake, unknown
from jezero.base.plugins import all_actions
from jezero.mission_files.goals import Places, height_m
from jezero.mission_files.nodes import FileNode, UnreadableError, parse
from jezero.mission_files.problems import MissionFileError, Problem, Problems, listed
from jezero.mission_files.steps import Steps, failure_policy
from jezero.schemas.mission import FailurePolicy, Mission
from jezero.schemas.rows import Action

if TYPE_CHECKING:
    from jezero.area_files import Area

BYTES_MAX = 1_000_000
FOREIGN, FOREIGN_BEGIN = (".plan", ".mission", ".waypoints", ".kml", ".kmz"), b"QGC WPL"
"""Endings of files of other programs, and the begin of those that end in .txt: a mission is made of them first."""
PARTS = ("mission", "points", "areas", "rally_points", "on_failure", "steps")
AREA_PARTS = ("file", "feature", "metres")
DEGREES_PARTS = ("degrees", "holes")
UNKNOWN_ORIGIN = "is in degrees, and the world's origin is not known yet"
CORNERS_MIN = 3
RALLY_POINTS_MAX = 100


@dataclass(frozen=True)
class MissionFile:
    """A mission with the places of its steps in the file.

    Attributes:
        mission: the mission.
        lines: line of each step, counted from 1.
    """

    mission: Mission
    lines: tuple[int, ...]


def read_mission(
    file: Path | str,
    origin_deg: Sequence[float] | None = None,
    actions: Mapping[str, Action[Any]] | None = None,
) -> MissionFile:
    """Read a mission from a file in YAML or JSON.

    Args:
        file: the file; files of areas that it names are relative to its folder.
        origin_deg: latitude and longitude of the world's origin in degrees and its altitude above sea level, such as
            `Odometry.origin_deg`. Heights above sea level need the altitude. None if everything is in metres around the
            origin.
        actions: every action by name; None takes those that are installed.

    Raises:
        MissionFileError: the file can't be read, or is no mission; it names every mistake with its line.
    """
    return _Reader(Path(file), origin_deg, all_actions() if actions is None else actions).read()


class _Reader:
    def __init__(self, file: Path, origin_deg: Sequence[float] | None, actions: Mapping[str, Action[Any]]) -> None:
        self._file = file
        self._origin_deg = origin_deg
        self._actions = actions
        self._problems = Problems()
        self._places = Places(None if origin_deg is None or len(origin_deg) < 3 else origin_deg[2])

    def read(self) -> MissionFile:
        """The mission, or `MissionFileError`."""
        root = self._parse()
        fields: dict[str, FileNode] = root.value
        for name, node in fields.items():
            if name not in PARTS:
                self._problems.add(node.line, unknown("part of a mission", name, PARTS))
        for name, node in self._named(fields, "points").items():
            self._add_point(name, node)
        for name, node in self._named(fields, "areas").items():
            self._add_area(name, node)
        self._places.rally_points_m = self._rally_points(fields["rally_points"]) if "rally_points" in fields else []
        policy = failure_policy(fields["on_failure"], self._problems) if "on_failure" in fields else FailurePolicy()
        steps = Steps(self._actions, self._places, policy, self._problems)
        if "steps" in fields:
            steps.read(fields["steps"])
        else:
            self._problems.add(root.line, "the mission has no steps: write them in a list under `steps:`")
        mission = self._mission(fields, steps)
        if self._problems.found or mission is None:
            raise MissionFileError(self._file, self._problems.found)
        return MissionFile(mission, tuple(steps.lines))

    def _parse(self) -> FileNode:
        try:
            if self._file.is_file() and self._is_foreign():
                made = self._file.with_suffix(".yaml").name
                hint = f"jezero mission import {self._file} -o {made} makes one"
                raise self._error(0, f"is no mission of jezero yet: {hint}")
            size = self._file.stat().st_size
            if size > BYTES_MAX:
                raise self._error(0, f"has {size / 1e6:.0f} MB, and a mission has {BYTES_MAX / 1e6:.0f} at most")
            root = parse(self._file.read_text(encoding="utf-8"), self._problems)
        except OSError as error:
            raise self._error(0, f"can't be read: {error.strerror or error}") from None
        except UnicodeDecodeError:
            raise self._error(1, NOT_UTF8) from None
        except UnreadableError as error:
            raise MissionFileError(self._file, [error.problem]) from None
        if root is None:
            raise self._error(1, "is empty: a mission has a list of steps under `steps:`")
        if not isinstance(root.value, dict):
            raise self._error(root.line, f"is {root.in_words}: a mission has a list of steps under `steps:`")
        return root

    def _is_foreign(self) -> bool:
        """Whether another program has written the file."""
        if self._file.suffix.lower() in FOREIGN:
            return True
        with self._file.open("rb") as file:
            return file.read(len(FOREIGN_BEGIN)) == FOREIGN_BEGIN

    def _error(self, line: int, text: str) -> MissionFileError:
        return MissionFileError(self._file, [Problem(line, text)])

    def _mission(self, fields: dict[str, FileNode], steps: Steps) -> Mission | None:
        name = fields["mission"].plain if "mission" in fields else self._file.stem.replace(" ", "-")
        try:
            fields_of_mission = {
                "name": name,
                "steps": msgspec.to_builtins(steps.steps),
                "rally_points_ned_m": self._places.rally_points_m,
            }
            return msgspec.convert(fields_of_mission, Mission)
        except msgspec.ValidationError as error:
            if "`$.name`" in str(error):
                line = fields["mission"].line if "mission" in fields else 1
                self._problems.add(line, "the mission's name has letters, digits, `_`, `-` and `.`, 64 at most")
            elif not self._problems.found:
                self._problems.add(1, mistake(error, Mission))
        return None

    # -- places --

    def _named(self, fields: dict[str, FileNode], part: str) -> dict[str, FileNode]:
        node = fields.get(part)
        if node is None or node.value is None:
            return {}
        if not isinstance(node.value, dict):
            self._problems.add(node.line, f"{part} are written as `name: value`, not as {node.in_words}")
            return {}
        return node.value

    def _add_point(self, name: str, node: FileNode) -> None:
        point_m = self._point_in_degrees(name, node) if isinstance(node.value, dict) else _numbers(node, 3)
        if point_m is None:
            self._problems.add(
                node.line,
                f"the point {name!r} needs [north, east, down] in metres, 3 m up is -3; or {{degrees: [latitude, "
                "longitude], altitude_m: 3}",
            )
        self._places.points[name] = point_m or [0.0, 0.0, 0.0]

    def _point_in_degrees(self, name: str, node: FileNode) -> list[float] | None:
        """The point in metres; None for a malformed one."""
        parts: dict[str, FileNode] = node.value
        place_deg = _numbers(parts.get("degrees", node), 2)
        up = parts.get("altitude_m", node)
        if len(parts) != 2 or place_deg is None or not (_is_number(up.value) or (up is not node and _is_fields(up))):
            return None
        if self._origin_deg is None:
            self._problems.add(node.line, f"the point {name!r} {UNKNOWN_ORIGIN}")
            return [0.0, 0.0, 0.0]
        from jezero.area_files.area import DISTANCE_MAX_M, project  # most missions don't need it

        north_m, east_m = project(((place_deg[0], place_deg[1]),), self._origin_deg)[0]
        if abs(place_deg[0]) > 90.0 or abs(place_deg[1]) > 180.0 or not hypot(north_m, east_m) <= DISTANCE_MAX_M:
            self._problems.add(
                node.line,
                f"the point {name!r} is {hypot(north_m, east_m) / 1000.0:.0f} km from the world's origin, which is at "
                f"{self._origin_deg[0]:.6f}, {self._origin_deg[1]:.6f}: start the vehicle near the point, or give the "
                "point as [latitude, longitude] in degrees",
            )
        at = f"the altitude_m of the point {name!r}"
        altitude_m = height_m(at, up, self._places, self._problems) if _is_fields(up) else float(up.value)
        return [north_m, east_m, -altitude_m]

    def _rally_points(self, node: FileNode) -> list[list[float]]:
        """North and east of each rally point."""
        found = []
        for part in _list_in(node):
            known = self._places.points.get(part.value) if isinstance(part.value, str) else _numbers(part, 2)
            if known is not None:
                found.append(known[:2])
        if not isinstance(node.value, list) or len(found) < len(node.value):
            self._problems.add(node.line, "rally_points are a list with names of points, or [north, east] in metres")
        if len(found) > RALLY_POINTS_MAX:
            self._problems.add(node.line, f"a mission has {RALLY_POINTS_MAX} rally points at most, not {len(found)}")
        return found

    def _add_area(self, name: str, node: FileNode) -> None:
        self._places.areas[name] = {"polygon_ned_m": [], "holes_ned_m": []}
        if name in self._places.points:
            self._problems.add(node.line, f"{name!r} is a point already: give the area another name")
        elif isinstance(node.value, list):
            corners = [_numbers(corner, 2) for corner in node.value]
            if len(corners) < CORNERS_MIN or None in corners:
                self._problems.add(
                    node.line, f"the area {name!r} needs three corners or more, each [north, east] in metres"
                )
            else:
                self._places.areas[name] = {"polygon_ned_m": corners}
        elif isinstance(node.value, dict) and "degrees" in node.value:
            self._add_area_in_degrees(name, node)
        elif isinstance(node.value, str | dict):
            self._add_area_of_file(name, node)
        else:
            self._problems.add(
                node.line, f"the area {name!r} is a list of corners [north, east], or the name of a file"
            )

    def _add_area_in_degrees(self, name: str, node: FileNode) -> None:
        from jezero.area_files import AreaFileError, FilePolygon, place
        from jezero.area_files.polygon import ring_from

        rings = [node.value["degrees"], *_list_in(node.value.get("holes"))]
        corners = [[_numbers(corner, 2) for corner in _list_in(ring)] for ring in rings]
        if set(node.value) - set(DEGREES_PARTS) or any(None in ring for ring in corners):
            wanted = "{degrees: [[latitude, longitude], ...], holes: [[[latitude, longitude], ...], ...]}"
            self._problems.add(node.line, f"the area {name!r} needs {wanted}, its holes may be left out")
            return
        try:
            outlines = tuple(ring_from([(c[0], c[1]) for c in ring if c], "it") for ring in corners)
            area = place(FilePolygon(name, "it", outlines), self._origin_deg)
        except AreaFileError as error:
            self._problems.add(node.line, f"the area {name!r}: {error}")
            return
        self._places.areas[name] = _fields_of(area)

    def _add_area_of_file(self, name: str, node: FileNode) -> None:
        options: dict[str, Any] = {"file": node.value} if isinstance(node.value, str) else node.plain
        unknown = [option for option in options if option not in AREA_PARTS]
        if unknown or not isinstance(options.get("file"), str):
            self._problems.add(node.line, f"the area {name!r} needs {{file: NAME}}; {listed(AREA_PARTS)} are known")
            return
        from jezero.area_files import AreaFileError, read_area  # with its formats, which most missions don't need

        metres = options.get("metres", False)
        try:
            area = read_area(
                self._file.parent / options["file"], self._origin_deg, feature=options.get("feature"), metres=metres
            )
        except AreaFileError as error:
            text = str(error).replace("add --metres", "add `metres: true` here")
            self._problems.add(node.line, f"the area {name!r}: {text}")
            return
        self._places.areas[name] = _fields_of(area)


def _fields_of(area: "Area") -> dict[str, Any]:
    """Fields of a coverage's goal."""
    fields: dict[str, Any] = {"polygon_ned_m": area.polygon_ned_m, "holes_ned_m": area.holes_ned_m}
    return fields | ({} if area.origin_deg is None else {"origin_deg": area.origin_deg})


def _list_in(node: FileNode | None) -> list[FileNode]:
    """The nodes of a list; an empty list for any other value."""
    return node.value if node is not None and isinstance(node.value, list) else []


def _numbers(node: FileNode, count: int) -> list[float] | None:
    """The numbers of a list with `count` numbers; None for any other value."""
    values = node.plain
    if not isinstance(values, list) or len(values) != count:
        return None
    return [float(value) for value in values] if all(map(_is_number, values)) else None


def _is_fields(node: FileNode) -> bool:
    return isinstance(node.value, dict)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
