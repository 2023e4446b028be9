"""The items of plans of other programs, of every version that is read, and the altitudes that they mean."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jezero.area_files.polygon import AreaFileError, excerpt, number_from, number_in
from jezero.area_files.qgc_plan import MISSION_VERSION, PLAN_VERSION, SAVE_AGAIN
from jezero.mission_files.imported import DECIMALS_DEG

WAYPOINT = 16
"""MAV_CMD_NAV_WAYPOINT."""
MISSION_FRAME = 2
"""MAV_FRAME_MISSION: the item has no place."""
ABSOLUTE_FRAMES, RELATIVE_FRAMES, TERRAIN_FRAMES = (0, 5), (3, 6), (10, 11)
"""Numbers of MAV_FRAME: altitudes above sea level, above the home position, and above the terrain."""
RELATIVE, ABSOLUTE, CALCULATED, TERRAIN = 1, 2, 3, 4
"""QGroundControl's own numbers for altitudes: above the home position, above sea level, above sea level as it has
calculated them over its terrain, and above the terrain that the vehicle knows."""
MODE_WORDS = {RELATIVE: "the home position", ABSOLUTE: "sea level", CALCULATED: "the terrain", TERRAIN: "the terrain"}
SAME_M = 0.05
"""Altitudes of one item that differ by more are two altitudes."""
PARAMS = 7
WPL, WPL_WITH_HOME, WPL_WITHOUT_HOME = "QGC WPL", "110", "120"
WPL_COLUMNS = 12

Height = float | dict[str, float]
"""A height as a mission file has it: metres above the world's origin, or `{amsl_m: metres above sea level}`."""


@dataclass(frozen=True)
class PlanItem:
    """A simple item: one command of MAVLink.

    Attributes:
        where: the item, for messages.
        command: number of MAV_CMD; None for no number.
        frame: number of MAV_FRAME; None without one.
        params: the seven parameters of the command; None for one that is not set.
        mode: QGroundControl's own number for the altitude; None without one.
        altitude_m: altitude that the editor shows, by its mode; None without one.
        calculated: the editor knew the terrain's height when it saved the item.
        waits: the vehicle waits after the item for a person.
    """

    where: str
    command: int | None
    frame: int | None
    params: tuple[float | None, ...]
    mode: int | None = None
    altitude_m: float | None = None
    calculated: bool = False
    waits: bool = False

    def place_deg(self) -> list[float] | None:
        """Latitude and longitude; None without them, which the programs write as 0 or null.

        Raises:
            AreaFileError: they are not on Earth, or the item's frame has none.
        """
        if self.frame not in (None, MISSION_FRAME, *ABSOLUTE_FRAMES, *RELATIVE_FRAMES, *TERRAIN_FRAMES):
            raise AreaFileError(
                f"{self.where} is in MAV_FRAME {self.frame}, and places are read in frames of latitude and longitude "
                "only (0, 3, 5 and 6): choose one of them"
            )
        return place_deg(self.params[4], self.params[5], self.where)


def place_deg(latitude_deg: float | None, longitude_deg: float | None, where: str) -> list[float] | None:
    """Latitude and longitude for a mission file; None without them, which the programs write as 0 or null.

    Raises:
        AreaFileError: they are not on Earth.
    """
    if latitude_deg is None or longitude_deg is None or (latitude_deg == 0.0 and longitude_deg == 0.0):
        return None
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
        raise AreaFileError(f"{where}: {latitude_deg:g}, {longitude_deg:g} is no latitude and longitude in degrees")
    return [round(latitude_deg, DECIMALS_DEG), round(longitude_deg, DECIMALS_DEG)]


def simple_item(item: Mapping[str, Any], where: str) -> PlanItem:
    """Read an item of a plan: with seven parameters; with four and a coordinate, as until 2017; or as until 2016.

    Raises:
        AreaFileError: its parameters are not understood.
    """
    params = item.get("params")
    if params is None and "param1" in item:
        params = [item.get(f"param{number}") for number in range(1, 5)]
    numbers = [number_from(value) for value in params] if isinstance(params, list) else []
    coordinate = item.get("coordinate")
    if len(numbers) < PARAMS and isinstance(coordinate, list):
        numbers = [*numbers[:4], *[None] * (4 - len(numbers)), *map(number_from, coordinate)]
    if numbers and len(numbers) != PARAMS:
        raise AreaFileError(f"{where} has {len(numbers)} parameters, and a command of MAVLink has {PARAMS}")
    return PlanItem(
        where,
        _whole(item.get("command")),
        _whole(item.get("frame")),
        tuple(numbers or [None] * PARAMS),
        _whole(item.get("AltitudeMode")),
        number_from(item.get("Altitude")),
        number_from(item.get("AMSLAltAboveTerrain")) is not None,
        item.get("autoContinue") is False,
    )


def _whole(value: Any) -> int | None:
    """A whole number of a JSON file, also one that is written as 16.0; None for everything else."""
    number = number_from(value)
    return int(number) if number is not None and number.is_integer() else None


# -- altitudes --


def item_height(item: PlanItem, plan_mode: Any, notes: list[str]) -> Height:
    """The height that an item means, by its frame; by QGroundControl's number for it, if it has no frame with a place.

    Args:
        item: in a frame of latitude and longitude, see `PlanItem.place_deg`.
        plan_mode: QGroundControl's number for the whole plan, for items with neither.
        notes: gets a sentence for a height that the file gives in two ways.

    Raises:
        AreaFileError: it is above the terrain, or the file doesn't say above what it is.
    """
    sent_m, mode = item.params[6], _mode(item.mode)
    if item.frame in (None, MISSION_FRAME):
        meant = mode or _mode(plan_mode) or RELATIVE
        sent_m = item.altitude_m if sent_m is None else sent_m
    elif item.frame in (*ABSOLUTE_FRAMES, *RELATIVE_FRAMES):
        meant = ABSOLUTE if item.frame in ABSOLUTE_FRAMES else RELATIVE
        sent_m = item.altitude_m if sent_m is None and mode == meant else sent_m
    else:
        meant = TERRAIN
    if sent_m is None:
        raise AreaFileError(f"{item.where} has no altitude")
    calculated = CALCULATED in (meant, mode)
    if TERRAIN in (meant, mode) or (calculated and (meant == RELATIVE or not item.calculated)):
        raise AreaFileError(_over_terrain(item.where, item.altitude_m if item.altitude_m is not None else sent_m))
    if mode in (RELATIVE, ABSOLUTE) and item.altitude_m is not None and abs(item.altitude_m - sent_m) > SAME_M:
        raise AreaFileError(
            f"{item.where} has two altitudes, {item.altitude_m:g} m and {sent_m:g} m: open the plan in QGroundControl, "
            "set the altitude, and save it again"
        )
    if calculated:
        notes.append(f"{item.where}: the height over the terrain is flown as {sent_m:g} m above sea level, as planned")
        return {"amsl_m": sent_m}
    if mode is not None and mode != meant:
        notes.append(
            f"{item.where}: its frame counts {sent_m:g} m from {MODE_WORDS[meant]}, its AltitudeMode from "
            f"{MODE_WORDS[mode]}; it is flown by its frame, as a vehicle would get it"
        )
    return sent_m if meant == RELATIVE else {"amsl_m": sent_m}


def survey_height(camera: Mapping[str, Any], plan_mode: Any, where: str) -> Height:
    """The height that a survey means.

    Args:
        camera: the `CameraCalc` of the survey.
        plan_mode: as in `item_height`.

    Raises:
        AreaFileError: as `item_height`.
    """
    altitude_m = number_from(camera.get("DistanceToSurface"))
    if altitude_m is None:
        raise AreaFileError(f"{where} has no altitude: save it with QGroundControl 3.5 or later")
    relative = camera.get("DistanceToSurfaceRelative")
    older = None if not isinstance(relative, bool) else RELATIVE if relative else ABSOLUTE
    meant = _mode(camera.get("DistanceMode")) or older or _mode(plan_mode) or RELATIVE
    if meant in (CALCULATED, TERRAIN):
        raise AreaFileError(_over_terrain(where, altitude_m))
    return {"amsl_m": altitude_m} if meant == ABSOLUTE else altitude_m


def _mode(value: Any) -> int | None:
    """QGroundControl's number for altitudes; None for none, and for "mixed", which says nothing of one item."""
    mode = _whole(value)
    return mode if mode in MODE_WORDS else None


def _over_terrain(where: str, altitude_m: float) -> str:
    return (
        f"{where} is at {altitude_m:g} m over the terrain, whose heights the vehicle doesn't know: choose altitudes "
        "relative to launch in QGroundControl"
    )


# -- older files --


def plan_of_mission(content: Mapping[str, Any]) -> dict[str, Any]:
    """The plan that a .mission file of QGroundControl, from before 2017, has become.

    Raises:
        AreaFileError: its version is not read, or it has items of a kind that is not.
    """
    version = content.get("version")
    if version not in ("1.0", 1, 2) or isinstance(version, bool):
        raise AreaFileError(f'is a mission of version "{excerpt(version)}", and 1 and 2 are read: {SAVE_AGAIN}')
    if content.get("complexItems"):
        raise AreaFileError(f"has surveys of a version that is too old: {SAVE_AGAIN}")
    home = content.get("plannedHomePosition")
    mission = {
        "version": MISSION_VERSION,
        "items": content.get("items"),
        "plannedHomePosition": home.get("coordinate") if isinstance(home, dict) else home,
    }
    return {"fileType": "Plan", "version": PLAN_VERSION, "mission": mission}


def plan_of_waypoints(text: str) -> dict[str, Any]:
    """The plan that a text of waypoints has become: `QGC WPL 110`, whose first line is home, or 120.

    Raises:
        AreaFileError: it is no such text; names the line.
    """
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    heading = lines[0][1].split() if lines else []
    if " ".join(heading[:2]) != WPL:
        raise AreaFileError(f'has no waypoints: their first line is "{WPL} {WPL_WITH_HOME}"')
    version = " ".join(heading[2:])
    if version not in (WPL_WITH_HOME, WPL_WITHOUT_HOME):
        known = f"{WPL_WITH_HOME} and {WPL_WITHOUT_HOME} are read"
        raise AreaFileError(f'has waypoints of version "{excerpt(version)}", and {known}: save it again')
    items = [_waypoint(line.split(), f'line {number}: "{excerpt(line)}"') for number, line in lines[1:]]
    mission: dict[str, Any] = {"version": MISSION_VERSION, "items": items}
    if version == WPL_WITH_HOME and items and items[0]["command"] == WAYPOINT:
        mission["plannedHomePosition"] = items.pop(0)["params"][4:]
    return {"fileType": "Plan", "version": PLAN_VERSION, "mission": mission}


def _waypoint(words: list[str], where: str) -> dict[str, Any]:
    """An item of a plan from a line: index, current, frame, command, seven parameters, autocontinue."""
    numbers = [number_in(word) for word in words]
    whole = [number is not None and number == int(number) for number in numbers[:4]]
    if len(words) != WPL_COLUMNS or not all(whole) or any(number is None for number in numbers[8:11]):
        raise AreaFileError(f"{where} is no waypoint: it needs {WPL_COLUMNS} numbers with blanks between them")
    params = numbers[4:11]
    params[3] = params[3] or None  # these programs write 0 for a heading that is not set
    return {
        "type": "SimpleItem", "frame": int(numbers[2] or 0), "command": int(numbers[3] or 0), "params": params,
        "autoContinue": numbers[11] != 0.0,
    }  # fmt: skip
