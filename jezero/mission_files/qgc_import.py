"""Missions from plans of QGroundControl, with a sentence for each part that is lost."""

from collections.abc import Callable, Iterator, Mapping
from math import hypot, isfinite, radians
from typing import Any

from jezero.area_files.polygon import AreaFileError, excerpt, number_from
from jezero.area_files.qgc_plan import is_plan, read_surveys
from jezero.frames import ned_from_geodetic
from jezero.mission_files.imported import ImportedMission

TAKEOFF, VTOL_TAKEOFF, WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME = 22, 84, 16, 17, 18, 19
RETURN, LAND, VTOL_LAND, DELAY_NAV, DELAY, CHANGE_SPEED = 20, 21, 85, 93, 112, 178
"""Numbers of MAV_CMD."""
WORDS = {
    LOITER_TURNS: "loiter turns", 177: "do jump", 115: "condition yaw", 183: "set servo", 187: "set actuator",
    189: "landing start", 195: "region of interest", 197: "end of the region of interest", 201: "region of interest",
    203: "trigger the camera", 205: "gimbal", 206: "camera trigger distance", 530: "camera mode", 531: "camera zoom",
    532: "camera focus", 1000: "gimbal", 2000: "take images", 2001: "stop images", 2500: "start video",
    2501: "stop video",
}  # fmt: skip
ABSOLUTE_FRAMES, RELATIVE_FRAMES, TERRAIN_FRAMES = (0, 5), (3, 6), (10, 11)
"""Numbers of MAV_FRAME: altitudes above sea level, above the home position, and above the terrain."""
ABSOLUTE_MODE, TERRAIN_MODES = 2, (3, 4)
"""QGroundControl's own numbers for the altitudes of a survey."""
MANUAL_CAMERA = "Manual (no camera specs)"
OVERLAP_MAX = 0.95
AT_HOME_M = 1.0
DECIMALS_DEG = 8


def import_plan(content: Any, name: str) -> ImportedMission:
    """Make a mission of a plan; points and areas stay in degrees, and the vehicle places them when it flies.

    Args:
        content: the plan, decoded from JSON.
        name: name of the mission.

    Raises:
        AreaFileError: it is no plan, or has nothing that a mission can have.
    """
    if not is_plan(content):
        raise AreaFileError('is not a plan of QGroundControl: it has no "fileType": "Plan"')
    return _Importer(content, name).run()


class _Importer:
    def __init__(self, content: Mapping[str, Any], name: str) -> None:
        self._content = content
        self._mission = _member(content, "mission")
        home = self._mission.get("plannedHomePosition")
        numbers = [number_from(value) for value in home] if isinstance(home, list) else []
        self._home_deg = [value for value in numbers[:3] if value is not None]
        self._speed_mps: float | None = None
        self._last_place: str | None = None
        self._surveys = iter(read_surveys(content))
        self._made = ImportedMission(name)

    def run(self) -> ImportedMission:
        """The mission with its notes."""
        items = self._mission.get("items")
        for number, item in enumerate(items if isinstance(items, list) else [], 1):
            where = f"item {number}"
            if not isinstance(item, dict):
                raise AreaFileError(f'{where}: "{excerpt(item)}" is no item of a mission')
            if "complexItemType" in item:
                self._complex(item, where)
            else:
                self._simple(item, number, where)
        self._rally_points()
        self._fence()
        if not self._made.steps:
            raise AreaFileError("has nothing to fly: no takeoff, waypoint, survey or landing")
        if next(iter(self._made.steps[0])) != "takeoff":
            self._note("the plan has no takeoff at its begin: fly it from a hover, or add the step takeoff")
        return self._made

    def _note(self, text: str) -> None:
        self._made.notes.append(text)

    # -- simple items --

    def _simple(self, item: Mapping[str, Any], number: int, where: str) -> None:
        command = item.get("command")
        params = item.get("params")
        numbers = [number_from(value) for value in params] if isinstance(params, list) else []
        numbers += [None] * (7 - len(numbers))
        makers: dict[Any, Callable[[Mapping[str, Any], list[float | None], int, str], None]] = {
            TAKEOFF: self._takeoff, VTOL_TAKEOFF: self._takeoff, LAND: self._land, VTOL_LAND: self._land,
            RETURN: self._return, WAYPOINT: self._waypoint, LOITER_TIME: self._waypoint,
            LOITER_UNLIMITED: self._waypoint, DELAY: self._delay, DELAY_NAV: self._delay,
            CHANGE_SPEED: self._change_speed,
        }  # fmt: skip
        maker = makers.get(command) if isinstance(command, int) else None
        if maker is None:
            what = WORDS.get(command, "") if isinstance(command, int) else ""
            self._note(f"{where} ({what or f'MAVLink command {excerpt(command)}'}) is left out: no action does it")
            return
        maker(item, numbers, number, where)

    def _takeoff(self, item: Mapping[str, Any], numbers: list[float | None], number: int, where: str) -> None:
        altitude_m = self._altitude_m(item.get("frame"), numbers[6], where)
        self._made.steps.append({"takeoff": {"altitude_m": altitude_m}})
        place_deg = _place(numbers)
        if place_deg is not None and self._home_deg and self._from_home_m(place_deg) > AT_HOME_M:
            self._go_to(f"takeoff_{number}", place_deg, altitude_m, None)

    def _waypoint(self, item: Mapping[str, Any], numbers: list[float | None], number: int, where: str) -> None:
        place_deg = _place(numbers)
        if place_deg is None:
            self._note(f"{where} is left out: it has no latitude and longitude")
            return
        command = item.get("command")
        yaw_deg = numbers[3] if command == WAYPOINT else None
        self._go_to(f"waypoint_{number}", place_deg, self._altitude_m(item.get("frame"), numbers[6], where), yaw_deg)
        if command == LOITER_UNLIMITED:
            self._note(f"{where} (loiter unlimited) is a waypoint: the next step follows at once")
        elif numbers[0]:
            self._made.steps.append({"wait": numbers[0]})

    def _go_to(self, name: str, place_deg: list[float], altitude_m: float, yaw_deg: float | None) -> None:
        self._made.points[name] = {"degrees": place_deg, "altitude_m": altitude_m}
        self._last_place = name
        fields: dict[str, Any] = {"target_ned_m": name}
        if yaw_deg is not None:
            fields["yaw_rad"] = round(radians(yaw_deg), 6)
        self._made.steps.append({"go_to": self._with_speed(fields)})

    def _land(self, item: Mapping[str, Any], numbers: list[float | None], number: int, where: str) -> None:
        place_deg = _place(numbers)
        if place_deg is not None:
            self._made.points[f"landing_{number}"] = {"degrees": place_deg, "altitude_m": 0.0}
            self._land_on(f"landing_{number}")
        elif self._last_place is not None:
            self._land_on(self._last_place)
        else:
            self._note(f"{where} (land) is left out: it has no latitude and longitude, and nothing was flown before it")

    def _return(self, item: Mapping[str, Any], numbers: list[float | None], number: int, where: str) -> None:
        self._made.steps.append({"return_home": {}})
        self._note(f"{where} (return) goes to the rover if its position is known, else to the take-off point")

    def _land_on(self, name: str) -> None:
        self._made.steps.append({"land_on_spot": {"landing_spot_ned_m": name, "use_uwb": False, "use_tag": False}})

    def _delay(self, item: Mapping[str, Any], numbers: list[float | None], number: int, where: str) -> None:
        if numbers[0] is None or numbers[0] < 0.0:
            self._note(f"{where} (delay until a time of day) is left out")
        else:
            self._made.steps.append({"wait": numbers[0]})

    def _change_speed(self, item: Mapping[str, Any], numbers: list[float | None], number: int, where: str) -> None:
        if numbers[1] is not None and numbers[1] > 0.0:
            self._speed_mps = numbers[1]
        elif numbers[1] == -2.0:
            self._speed_mps = None

    def _with_speed(self, fields: dict[str, Any]) -> dict[str, Any]:
        return fields if self._speed_mps is None else fields | {"speed_mps": self._speed_mps}

    # -- altitudes --

    def _altitude_m(self, frame: Any, altitude_m: float | None, where: str) -> float:
        """Altitude above the place where the vehicle starts."""
        if altitude_m is None:
            raise AreaFileError(f"{where} has no altitude")
        if frame in ABSOLUTE_FRAMES:
            return self._over_home_m(altitude_m, where)
        if frame in TERRAIN_FRAMES:
            self._note(f"{where}: its {altitude_m:g} m over the terrain are flown over the take-off point")
        return altitude_m

    def _over_home_m(self, altitude_m: float, where: str) -> float:
        if len(self._home_deg) < 3:
            raise AreaFileError(
                f"{where} is at {altitude_m:g} m above sea level, and the plan has no planned home position: choose "
                "altitudes relative to launch in QGroundControl"
            )
        return round(altitude_m - self._home_deg[2], 3)

    def _from_home_m(self, place_deg: list[float]) -> float:
        north_m, east_m, _ = ned_from_geodetic(
            (place_deg[0], place_deg[1], 0.0), (self._home_deg[0], self._home_deg[1], 0.0)
        )
        return hypot(north_m, east_m)

    # -- complex items --

    def _complex(self, item: Mapping[str, Any], where: str) -> None:
        kind = item.get("complexItemType")
        if kind != "survey":
            self._note(f"{where} ({excerpt(kind)}) is left out: only surveys become a coverage")
            return
        polygon = next(self._surveys)
        name = polygon.name.replace(" ", "_")
        outline, *holes = ([list(corner) for corner in ring] for ring in polygon.rings)
        self._made.areas[name] = {"degrees": outline} | ({"holes": holes} if holes else {})
        style = _member(item, "TransectStyleComplexItem")
        camera = _member(style, "CameraCalc")
        fields: dict[str, Any] = {"polygon_ned_m": name, "z_ned_m": -self._survey_altitude_m(camera, where)}
        fields |= self._spacing(camera, where)
        self._made.steps.append({"area_coverage": self._with_speed(fields)})
        if lost := list(_lost_of_survey(item, style)):
            self._note(f"{where} (survey): the coverage plans its own lines, without {', '.join(lost)}")

    def _survey_altitude_m(self, camera: Mapping[str, Any], where: str) -> float:
        altitude_m = number_from(camera.get("DistanceToSurface"))
        if altitude_m is None:
            raise AreaFileError(f"{where} (survey) has no altitude: save it with QGroundControl 3.5 or later")
        mode = camera.get("DistanceMode", 1 if camera.get("DistanceToSurfaceRelative", True) else ABSOLUTE_MODE)
        if mode == ABSOLUTE_MODE:
            return self._over_home_m(altitude_m, where)
        if mode in TERRAIN_MODES:
            self._note(f"{where}: its {altitude_m:g} m over the terrain are flown over the take-off point")
        return altitude_m

    def _spacing(self, camera: Mapping[str, Any], where: str) -> dict[str, float]:
        """Overlaps of images; without a known camera, the distance between lines."""
        overlaps = [number_from(camera.get(side)) for side in ("FrontalOverlap", "SideOverlap")]
        name = camera.get("CameraName")
        if name == MANUAL_CAMERA or None in overlaps:
            side_m, front_m = (
                number_from(camera.get(f"AdjustedFootprint{direction}")) for direction in ("Side", "Frontal")
            )
            if not side_m:
                raise AreaFileError(f"{where} (survey) has neither overlaps nor a distance between its lines")
            if front_m and front_m != side_m:
                self._note(f"{where} (survey): images are {side_m:g} m apart as the lines are, and not {front_m:g} m")
            return {"resolution_m": side_m}
        fractions = [min(max(each or 0.0, 0.0) / 100.0, OVERLAP_MAX) for each in overlaps]
        if any((each or 0.0) > 100.0 * OVERLAP_MAX for each in overlaps):
            self._note(f"{where} (survey): overlaps above {100 * OVERLAP_MAX:g} % become {100 * OVERLAP_MAX:g} %")
        if isinstance(name, str) and name and name != "Custom Camera":
            self._note(f"{where} (survey): its overlaps hold for the vehicle's own camera, and not for {excerpt(name)}")
        return {"overlap": round(fractions[0], 4), "sidelap": round(fractions[1], 4)}

    # -- what belongs to no item --

    def _rally_points(self) -> None:
        points = _member(self._content, "rallyPoints").get("points")
        count = 0
        for number, point in enumerate(points if isinstance(points, list) else [], 1):
            numbers = [number_from(value) for value in point] if isinstance(point, list) else []
            place_deg = _place([None, None, None, None, *numbers])
            if place_deg is None:
                raise AreaFileError(f'rally point {number}: "{excerpt(point)}" is not [latitude, longitude, altitude]')
            altitude_m = (numbers[2] if len(numbers) > 2 else None) or 0.0
            self._made.points[f"rally_{number}"] = {"degrees": place_deg, "altitude_m": altitude_m}
            count += 1
        if count:
            self._note(
                f"{_counted(count, 'rally point')} of the plan: points of the mission, which no step uses; the return "
                "has its own in rally_points_ned_m of actions.toml"
            )

    def _fence(self) -> None:
        fence = _member(self._content, "geoFence")
        zones = [fence.get(kind) for kind in ("polygons", "circles")]
        shapes = [shape for found in zones if isinstance(found, list) for shape in found]
        if shapes:
            self._note(
                f"the geofence ({_counted(len(shapes), 'zone')}) is not part of a mission: set it in the autopilot; "
                "its exclusion zones in a survey are holes of the area, too"
            )


def _lost_of_survey(item: Mapping[str, Any], style: Mapping[str, Any]) -> Iterator[str]:
    """Parts of a survey that a coverage doesn't have."""
    angle_deg = number_from(item.get("angle"))
    if angle_deg:
        yield f"their direction of {angle_deg:g}°"
    turnaround_m = number_from(style.get("TurnAroundDistance"))
    if turnaround_m:
        yield f"the turnarounds of {turnaround_m:g} m"
    for words, part in (
        ("the second pass across", style.get("Refly90Degrees")),
        ("the stop at each image", style.get("HoverAndCapture")),
        ("the terrain's heights", style.get("FollowTerrain")),
        ("the alternate order of lines", item.get("flyAlternateTransects")),
    ):
        if part is True:
            yield words


def _place(numbers: list[float | None]) -> list[float] | None:
    """Latitude and longitude of an item's parameters; None without them, which QGroundControl writes as 0 or null."""
    latitude_deg, longitude_deg = (*numbers, None, None)[4:6]
    if latitude_deg is None or longitude_deg is None or (latitude_deg == 0.0 and longitude_deg == 0.0):
        return None
    if not (isfinite(latitude_deg) and abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
        raise AreaFileError(f"{latitude_deg:g}, {longitude_deg:g} is no latitude and longitude in degrees")
    return [round(latitude_deg, DECIMALS_DEG), round(longitude_deg, DECIMALS_DEG)]


def _member(content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    member = content.get(name)
    return member if isinstance(member, dict) else {}


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
