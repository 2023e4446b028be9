"""Missions from plans of QGroundControl, with a sentence for each part that is flown in another way, or is lost."""

from collections.abc import Callable, Mapping
from math import hypot, radians
from typing import Any

from jezero.area_files.polygon import AreaFileError, excerpt, number_from
from jezero.area_files.qgc_plan import SAVE_AGAIN, checked_plan, read_surveys
from jezero.base.fence import fence_refusal
from jezero.base.frames import ned_from_geodetic
from jezero.mission_files.fence_file import fence_of_plan
from jezero.mission_files.imported import ImportedMission
from jezero.mission_files.plan_items import Height, PlanItem, item_height, place_deg, simple_item
from jezero.mission_files.qgc_surveys import CAMERA_COMMANDS, survey_coverages, takes_pictures

TAKEOFF, VTOL_TAKEOFF, WAYPOINT, SPLINE = 22, 84, 16, 82
LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, LOITER_TO_ALTITUDE = 17, 18, 19, 31
RETURN, LAND, VTOL_LAND, DELAY_NAV, DELAY, CHANGE_SPEED = 20, 21, 85, 93, 112, 178
"""Numbers of MAV_CMD."""
PLACES = {
    SPLINE: "spline waypoint", LOITER_UNLIMITED: "loiter unlimited", LOITER_TURNS: "loiter turns",
    LOITER_TO_ALTITUDE: "loiter to an altitude",
}  # fmt: skip
"""Commands that are flown as waypoints, with a note."""
WORDS = {
    177: "do jump", 115: "condition yaw", 183: "set servo", 187: "set actuator", 189: "landing start",
    195: "region of interest", 197: "end of the region of interest", 201: "region of interest",
    203: "trigger the camera", 205: "gimbal", 206: "camera trigger distance", 530: "camera mode", 531: "camera zoom",
    532: "camera focus", 1000: "gimbal", 2000: "take images", 2001: "stop images", 2500: "start video",
    2501: "stop video",
}  # fmt: skip
SCANS = {"CorridorScan": "corridor scan", "StructureScan": "structure scan"}
RALLY_VERSIONS = (1, 2)
VERTICAL_SPEEDS = (2.0, 3.0)
"""First parameter of a change of speed: that of climbs, and that of descents."""
AT_HOME_M = 1.0


def import_plan(content: Any, name: str) -> ImportedMission:
    """Make a mission of a plan; points and areas stay in degrees, and the vehicle places them when it flies.

    Args:
        content: the plan, decoded from JSON, or made of another file by `plan_items`.
        name: name of the mission.

    Raises:
        AreaFileError: it is no plan, has nothing that a mission can have, or an altitude that the vehicle can't fly.
    """
    return _Importer(checked_plan(content), name).run()


class _Importer:
    def __init__(self, content: Mapping[str, Any], name: str) -> None:
        self._content = content
        self._mission = _member(content, "mission")
        self._mode = self._mission.get("globalPlanAltitudeMode")
        home = self._mission.get("plannedHomePosition")
        numbers = [number_from(value) for value in home] if isinstance(home, list) else []
        self._home_deg = place_deg(numbers[0], numbers[1], "the planned home position") if len(numbers) >= 2 else None
        self._speed_mps: float | None = None
        self._last_place: str | None = None
        self._surveys = iter(read_surveys(content))
        self._made = ImportedMission(name, home_altitude_m=numbers[2] if len(numbers) > 2 else None)

    def run(self) -> ImportedMission:
        """The mission with its notes."""
        items = self._mission.get("items")
        for number, item in enumerate(items if isinstance(items, list) else [], 1):
            self._item(item, f"item {number}", str(number))
        self._rally_points()
        self._fence()
        if not self._made.steps:
            cause = f": {'; '.join(self._made.lost)}" if self._made.lost else ""
            raise AreaFileError(f"has nothing to fly, no takeoff, waypoint, survey or landing{cause}")
        if next(iter(self._made.steps[0])) != "takeoff":
            self._note("the plan has no takeoff at its begin: fly it from a hover, or add the step takeoff")
        self._note_sea_level()
        return self._made

    def _note(self, text: str) -> None:
        self._made.notes.append(text)

    def _lose(self, text: str) -> None:
        self._made.lost.append(text)

    def _note_sea_level(self) -> None:
        if not self._made.has_heights_above_sea_level:
            return
        home_m = self._made.home_altitude_m
        planned = "" if home_m is None else f"; the planned home position is at {home_m:g} m, which is not used"
        self._note(f"heights above sea level are counted from the altitude of the vehicle's origin{planned}")

    def _item(self, item: Any, where: str, number: str) -> None:
        if not isinstance(item, dict):
            raise AreaFileError(f'{where}: "{excerpt(item)}" is no item of a mission')
        if "complexItemType" in item:
            self._complex(item, where, number)
        else:
            self._simple(simple_item(item, where), number)

    # -- simple items --

    def _simple(self, item: PlanItem, number: str) -> None:
        makers: dict[int | None, Callable[[PlanItem, str], None]] = {
            TAKEOFF: self._takeoff, VTOL_TAKEOFF: self._takeoff, LAND: self._land, VTOL_LAND: self._land,
            RETURN: self._return, WAYPOINT: self._waypoint, LOITER_TIME: self._waypoint, DELAY: self._delay,
            DELAY_NAV: self._delay, CHANGE_SPEED: self._change_speed, **dict.fromkeys(PLACES, self._waypoint),
        }  # fmt: skip
        maker = makers.get(item.command)
        if maker is None:
            what = WORDS.get(item.command or 0, f"MAVLink command {excerpt(item.command)}")
            self._lose(f"{item.where} ({what}): no action does it")
            return
        maker(item, number)
        if item.waits:
            self._lose(f"{item.where} waits for a person before the next one (autoContinue is false)")

    def _height(self, item: PlanItem) -> Height:
        return item_height(item, self._mode, self._made.notes)

    def _takeoff(self, item: PlanItem, number: str) -> None:
        place, height = item.place_deg(), self._height(item)
        self._made.steps.append({"takeoff": {"altitude_m": height}})
        if place is not None and (self._home_deg is None or _apart_m(place, self._home_deg) > AT_HOME_M):
            self._go_to(f"takeoff_{number}", place, height, None)

    def _waypoint(self, item: PlanItem, number: str) -> None:
        place = item.place_deg()
        if place is None:
            self._lose(f"{item.where} has no latitude and longitude")
            return
        yaw_deg = item.params[3] if item.command == WAYPOINT else None
        self._go_to(f"waypoint_{number}", place, self._height(item), yaw_deg)
        if item.command in PLACES:
            self._note(f"{item.where} ({PLACES[item.command]}) is a waypoint, to which the vehicle flies straight")
        if item.command in (WAYPOINT, SPLINE, LOITER_TIME) and (item.params[0] or 0.0) > 0.0:
            self._made.steps.append({"wait": item.params[0]})

    def _go_to(self, name: str, place: list[float], height: Height, yaw_deg: float | None) -> None:
        self._made.points[name] = {"degrees": place, "altitude_m": height}
        self._last_place = name
        fields: dict[str, Any] = {"target_ned_m": name}
        if yaw_deg is not None:
            fields["yaw_rad"] = round(radians(yaw_deg), 6)
        self._made.steps.append({"go_to": self._with_speed(fields)})

    def _land(self, item: PlanItem, number: str) -> None:
        place = item.place_deg()
        if place is not None:
            self._made.points[f"landing_{number}"] = {"degrees": place, "altitude_m": 0.0}
            self._land_on(f"landing_{number}")
        elif self._last_place is not None:
            self._land_on(self._last_place)
        else:
            self._lose(f"{item.where} (land) has no latitude and longitude, and nothing was flown before it")

    def _return(self, item: PlanItem, number: str) -> None:
        self._made.steps.append({"return_home": {}})
        self._note(f"{item.where} (return) goes to the rover if its position is known, else to the take-off point")

    def _land_on(self, name: str) -> None:
        self._made.steps.append({"land_on_spot": {"landing_spot_ned_m": name, "use_uwb": False, "use_tag": False}})

    def _delay(self, item: PlanItem, number: str) -> None:
        if item.params[0] is None or item.params[0] < 0.0:
            self._lose(f"{item.where} is a delay until a time of day")
        else:
            self._made.steps.append({"wait": item.params[0]})

    def _change_speed(self, item: PlanItem, number: str) -> None:
        speed_mps = item.params[1]
        if item.params[0] in VERTICAL_SPEEDS:
            self._lose(f"{item.where} (change of the vertical speed): no action does it")
        elif speed_mps is not None and speed_mps > 0.0:
            self._speed_mps = speed_mps
        elif speed_mps == -2.0:
            self._speed_mps = None

    def _with_speed(self, fields: dict[str, Any]) -> dict[str, Any]:
        return fields if self._speed_mps is None else fields | {"speed_mps": self._speed_mps}

    # -- complex items --

    def _complex(self, item: Mapping[str, Any], where: str, number: str) -> None:
        kind = item.get("complexItemType")
        if kind == "survey":
            self._survey(item, f"{where} (survey)")
        elif isinstance(kind, str) and kind in SCANS:
            self._scan(item, f"{where} ({SCANS[kind]})", number)
        else:
            self._lose(f"{where} ({excerpt(kind)}): no action does it")

    def _survey(self, item: Mapping[str, Any], where: str) -> None:
        polygon = next(self._surveys)
        name = polygon.name.replace(" ", "_")
        outline, *holes = ([list(corner) for corner in ring] for ring in polygon.rings)
        self._made.areas[name] = {"degrees": outline} | ({"holes": holes} if holes else {})
        for fields in survey_coverages(item, self._mode, where, self._made):
            self._made.steps.append({"area_coverage": self._with_speed({"polygon_ned_m": name, **fields})})

    def _scan(self, item: Mapping[str, Any], where: str, number: str) -> None:
        """Fly the waypoints that a scan has; what its camera does is lost."""
        items = _member(item, "TransectStyleComplexItem").get("Items")
        if not isinstance(items, list) or not items:
            raise AreaFileError(f"{where} has no waypoints of its own: {SAVE_AGAIN}, or plan its waypoints one by one")
        if takes_pictures(item):
            self._lose(f"{where} takes images along its way, and only surveys become coverages; its way is flown")
        for index, below in enumerate(items, 1):
            command = below.get("command") if isinstance(below, dict) else None
            if command not in CAMERA_COMMANDS:
                self._item(below, f"{where}, item {index}", f"{number}_{index}")

    # -- what belongs to no item --

    def _rally_points(self) -> None:
        rally = _member(self._content, "rallyPoints")
        points = rally.get("points")
        if points and rally.get("version", RALLY_VERSIONS[-1]) not in RALLY_VERSIONS:
            raise AreaFileError(f'has rally points of version "{excerpt(rally["version"])}": {SAVE_AGAIN}')
        for number, point in enumerate(points if isinstance(points, list) else [], 1):
            numbers = [number_from(value) for value in point[:2]] if isinstance(point, list) else []
            place = place_deg(numbers[0], numbers[1], f"rally point {number}") if len(numbers) == 2 else None
            if place is None:
                raise AreaFileError(f'rally point {number}: "{excerpt(point)}" is not [latitude, longitude, altitude]')
            self._made.points[f"rally_{number}"] = {"degrees": place, "altitude_m": 0.0}
            self._made.rally_points.append(f"rally_{number}")

    def _fence(self) -> None:
        geofence = _member(self._content, "geoFence")
        if geofence.get("breachReturn"):
            self._lose("the geofence: its point to return to, which no fence of jezero has")
        if geofence.get("polygon") and _member(geofence, "circle").get("radius"):
            self._note("the geofence's circle was a setting of the vehicle, and is no part of the fence")
        try:
            fence = fence_of_plan(self._content, self._made.name)
            if fence is not None and (reason := fence_refusal(fence)):
                raise AreaFileError(reason)
        except AreaFileError as error:
            self._lose(f"the geofence: {error}")
        else:
            self._made.fence = fence


def _apart_m(a_deg: list[float], b_deg: list[float]) -> float:
    north_m, east_m, _ = ned_from_geodetic((a_deg[0], a_deg[1], 0.0), (b_deg[0], b_deg[1], 0.0))
    return hypot(north_m, east_m)


def _member(content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    member = content.get(name)
    return member if isinstance(member, dict) else {}
