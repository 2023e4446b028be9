"""Reads a fence from a file in YAML or JSON, or from the geofence of a QGroundControl plan."""

from pathlib import Path
from typing import Any

import msgspec

from jezero.base.config import ConfigError, config_directory
from jezero.base.fence import JoinError, fence_refusal, joined, zone_refusal
from jezero.base.files import NOT_UTF8
from jezero.base.mistakes import mistake, unknown
from jezero.mission_files.goals import line_of
from jezero.mission_files.nodes import FileNode, UnreadableError, parse
from jezero.mission_files.problems import MissionFileError, Problem, Problems, listed
from jezero.schemas.fence import Fence, Zone

BYTES_MAX = 1_000_000
PARTS = ("fence", "degrees", "keep_in", "keep_out", "ceiling_m", "floor_over_ground_m")
PLAIN = ("ceiling_m", "floor_over_ground_m")
CORNERS = "three corners or more, each [north, east] in metres, or with `degrees: true` [latitude, longitude]"


def read_fence(file: Path | str) -> Fence:
    """Read a fence.

    Raises:
        MissionFileError: the file can't be read, or is no fence; it names every mistake with its line.
    """
    path = Path(file)
    try:
        if path.stat().st_size > BYTES_MAX:
            raise MissionFileError(path, [Problem(0, "has more than a megabyte, which no fence needs")])
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise MissionFileError(path, [Problem(0, f"can't be read: {error.strerror or error}")]) from None
    except UnicodeDecodeError:
        raise MissionFileError(path, [Problem(1, NOT_UTF8)]) from None
    problems = Problems()
    fence = _of_plan(path, text) if path.suffix.lower() == ".plan" else _of_yaml(path, text, problems)
    if fence is not None and not problems.found and (reason := fence_refusal(fence)):
        problems.add(0, f"is no fence: {reason}")
    if problems.found or fence is None:
        raise MissionFileError(path, problems.found)
    return fence


def configured_fence(file: str) -> Fence | None:
    """The fence that a setting names; None for "".

    Args:
        file: absolute, or relative to the folder of the settings.

    Raises:
        ConfigError: the file can't be read, or is no fence.
    """
    if not file:
        return None
    try:
        return read_fence(config_directory() / file)
    except MissionFileError as error:
        raise ConfigError(f"the setting fence of vehicle_bridge.toml: {error}") from None


def fence_of_plan(plan: Any, name: str) -> Fence | None:
    """The geofence of a plan; None without one.

    Args:
        plan: the plan, decoded from JSON.

    Raises:
        AreaFileError: a zone is damaged, or the areas to stay in are not one.
    """
    from jezero.area_files import AreaFileError
    from jezero.area_files.qgc_plan import read_geofence

    zones = [(Zone(name=name, corners_deg=ring), included) for name, ring, included in read_geofence(plan)]
    if not zones:
        return None
    keep_in = [zone for zone, included in zones if included]
    try:
        whole = joined(keep_in) if keep_in else None
    except JoinError as error:
        raise AreaFileError(str(error)) from None
    return Fence(name=name[:64], keep_in=whole, keep_out=tuple(zone for zone, included in zones if not included))


def _of_plan(path: Path, text: str) -> Fence:
    from jezero.area_files import AreaFileError
    from jezero.area_files.geojson import parse_json
    from jezero.area_files.qgc_plan import checked_plan

    try:
        fence = fence_of_plan(checked_plan(parse_json(text.encode())), path.stem)
    except AreaFileError as error:
        raise MissionFileError(path, [Problem(0, str(error))]) from None
    except RecursionError:
        raise MissionFileError(path, [Problem(0, "is nested too deeply")]) from None
    if fence is None:
        raise MissionFileError(path, [Problem(0, "has no geofence: draw one in QGroundControl's Plan view")])
    return fence


def _of_yaml(path: Path, text: str, problems: Problems) -> Fence | None:
    try:
        root = parse(text, problems)
    except UnreadableError as error:
        raise MissionFileError(path, [error.problem]) from None
    if root is None or not isinstance(root.value, dict):
        what = "is empty" if root is None else f"is {root.in_words}"
        raise MissionFileError(path, [Problem(1, f"{what}: a fence has {listed(PARTS)}")])
    parts: dict[str, FileNode] = root.value
    for name, node in parts.items():
        if name not in PARTS:
            problems.add(node.line, unknown("part of a fence", name, PARTS))
    degrees = parts.get("degrees", FileNode(1, False))
    if not isinstance(degrees.value, bool):
        problems.add(degrees.line, "degrees is true or false")
    fields: dict[str, Any] = {name: parts[name].plain for name in PLAIN if name in parts}
    fields["name"] = parts["fence"].plain if "fence" in parts else path.stem[:64]
    reader = _Zones(path, degrees.value is True, problems)
    if "keep_in" in parts:
        fields["keep_in"] = reader.one("keep_in", parts["keep_in"])
    fields["keep_out"] = reader.named(parts["keep_out"]) if "keep_out" in parts else []
    if not any(name in parts for name in PARTS[2:]):
        problems.add(root.line, f"the fence limits nothing: give one of {listed(PARTS[2:])}")
    return None if problems.found else _checked(fields, parts, root.line, problems)


def _checked(fields: dict[str, Any], parts: dict[str, FileNode], line: int, problems: Problems) -> Fence | None:
    try:
        return msgspec.convert(msgspec.to_builtins(fields), Fence)
    except msgspec.ValidationError as error:
        text = mistake(error, Fence)
        named = {**parts, "name": parts["fence"]} if "fence" in parts else parts
        problems.add(line_of(text, named, line), text)
        return None


class _Zones:
    """Reads zones: lists of corners, or the names of area files."""

    def __init__(self, file: Path, degrees: bool, problems: Problems) -> None:
        self._folder = file.parent
        self._degrees = degrees
        self._problems = problems

    def one(self, name: str, node: FileNode) -> Zone | None:
        """One zone, or several of `NAME: corners` that touch as one."""
        if not isinstance(node.value, dict) or "file" in node.value:
            return self.zone(name, node)
        if not node.value:
            self._problems.add(node.line, f"{name} needs {CORNERS}; or the name of an area's file")
        zones = self.named(node)
        if len(zones) < len(node.value):  # what is wrong with the others is noted
            return None
        try:
            return joined(zones) if zones else None
        except JoinError as error:
            self._problems.add(node.line, f"{name}: {error}")
            return None

    def named(self, node: FileNode) -> list[Zone]:
        """All zones of `NAME: corners`."""
        if node.value is None:
            return []
        if not isinstance(node.value, dict):
            self._problems.add(node.line, f"keep_out is written as `NAME: [corners]`, not as {node.in_words}")
            return []
        zones = [self.zone(name, below) for name, below in node.value.items()]
        return [zone for zone in zones if zone is not None]

    def zone(self, name: str, node: FileNode) -> Zone | None:
        """One zone."""
        fields = self._fields(name, node)
        if fields is None:
            return None
        try:
            zone = msgspec.convert(fields, Zone)
        except msgspec.ValidationError as error:
            self._problems.add(node.line, f"{name}: {mistake(error, Zone)}")
            return None
        if reason := zone_refusal(zone):
            self._problems.add(node.line, f"{name}: {reason}")
            return None
        return zone

    def _fields(self, name: str, node: FileNode) -> dict[str, Any] | None:
        if isinstance(node.value, str):
            return self._of_file(name, {"file": node.value}, node.line)
        if isinstance(node.value, dict) and isinstance(node.plain.get("file"), str):
            return self._of_file(name, node.plain, node.line)
        corners = node.plain
        if not isinstance(corners, list) or len(corners) < 3 or not all(_is_corner(corner) for corner in corners):
            self._problems.add(node.line, f"{name} needs {CORNERS}; or the name of an area's file")
            return None
        corners = corners[:-1] if corners[-1] == corners[0] else corners
        return {"name": name, "corners_deg" if self._degrees else "corners_ned_m": corners}

    def _of_file(self, name: str, options: dict[str, Any], line: int) -> dict[str, Any] | None:
        from jezero.area_files import AreaFileError, read_polygon  # with its formats, which most fences don't need

        metres = options.get("metres", False)
        try:
            polygon = read_polygon(self._folder / options["file"], feature=options.get("feature"), metres=metres)
        except AreaFileError as error:
            self._problems.add(line, f"{name}: {str(error).replace('add --metres', 'add `metres: true` here')}")
            return None
        if len(polygon.rings) > 1:
            self._problems.add(line, f"{name}: {polygon.place} has holes: write each as a zone under keep_out")
            return None
        return {"name": name, "corners_ned_m" if polygon.in_metres else "corners_deg": polygon.rings[0]}


def _is_corner(corner: Any) -> bool:
    numbers = isinstance(corner, list) and len(corner) == 2
    return numbers and all(isinstance(part, int | float) and not isinstance(part, bool) for part in corner)
