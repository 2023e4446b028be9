"""Plans of QGroundControl from missions, and a sentence for what a plan can't have."""

from collections.abc import Mapping, Sequence
from math import atan2, cos, degrees, pi, sin
from typing import Any

import msgspec

from jezero.area_files.polygon import FilePolygon
from jezero.base.frames import altitude_m, geodetic_from_ned
from jezero.mission_files.qgc_import import CHANGE_SPEED, DELAY_NAV, LAND, TAKEOFF, WAYPOINT
from jezero.mission_files.qgc_surveys import MANUAL_CAMERA
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, Goal, GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.mission import FailurePolicy, Mission, WaitStep
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.area_coverage.planner import plan_or_refuse
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Refusal

RETURN, ROI, ROI_END, TAKE_IMAGES, CAMERA_DISTANCE = 20, 195, 197, 2000, 206
RELATIVE_FRAME, RELATIVE_MODE = 3, 1
PX4, QUADROTOR = 12, 2
DEFAULT_SPEED = -2.0
DECIMALS_DEG = 7
"""A centimetre."""
SENSOR_WIDTH_MM = 6.0
"""Any width: QGroundControl uses its ratio to the focal length only."""


class ExportError(ValueError):
    """The mission has nothing that a plan can have."""


def export_plan(
    mission: Mission, origin_deg: Sequence[float], config: ActionsConfig
) -> tuple[dict[str, Any], list[str]]:
    """Make a plan of a mission.

    Args:
        mission: the mission, its places in metres around the origin.
        origin_deg: latitude, longitude and altitude of the world's origin, which becomes the planned home position.
        config: settings of the actions, with which coverages are planned.

    Returns:
        The plan for JSON, and a sentence for each part of the mission that it doesn't have.

    Raises:
        ExportError: no step can be in a plan.
    """
    return _Exporter(origin_deg, config).run(mission)


class _Exporter:
    def __init__(self, origin_deg: Sequence[float], config: ActionsConfig) -> None:
        self._origin_deg = _geodetic(origin_deg)
        self._config = config
        self._items: list[dict[str, Any]] = []
        self._zones: list[dict[str, Any]] = []
        self._notes: list[str] = []
        self._rally_points: list[list[float]] = []
        self._speed_mps: float | None = None
        self._here_m = (0.0, 0.0)
        self._count = 0
        self._taken_off = False

    def run(self, mission: Mission) -> tuple[dict[str, Any], list[str]]:
        """The plan and the notes."""
        for number, step in enumerate(mission.steps, 1):
            where = f"step {number} ({step.label})"
            if isinstance(step, WaitStep):
                self._items.append(self._item(DELAY_NAV, [step.duration_s, -1, -1, -1, 0, 0, 0], frame=2))
            else:
                self._goal(step.action, step.goal, where)
        self._rally_points = [[*self._degrees(point), 0.0] for point in mission.rally_points_ned_m]
        if not self._items:
            raise ExportError("has no step that a plan of QGroundControl can have: " + "; ".join(self._notes))
        if any(not isinstance(step, WaitStep) and step.on_failure != FailurePolicy() for step in mission.steps):
            self._notes.append("on_failure is left out: the autopilot's own failsafes apply")
        return self._plan(), self._notes

    def _plan(self) -> dict[str, Any]:
        mission = {
            "version": 2, "firmwareType": PX4, "vehicleType": QUADROTOR, "cruiseSpeed": 15, "hoverSpeed": 5,
            "globalPlanAltitudeMode": RELATIVE_MODE, "plannedHomePosition": list(self._origin_deg),
            "items": self._items,
        }  # fmt: skip
        return {
            "fileType": "Plan", "version": 1, "groundStation": "QGroundControl", "mission": mission,
            "geoFence": {"version": 2, "polygons": self._zones, "circles": []},
            "rallyPoints": {"version": 2, "points": self._rally_points},
        }  # fmt: skip

    def _goal(self, action: str, fields: Mapping[str, Any], where: str) -> None:
        if action not in ACTIONS:
            self._lose(where, f"QGroundControl has no action {action}")
            return
        goal: Goal = msgspec.convert(dict(fields), ACTIONS[action].goal_type)
        if getattr(goal, "frame", "world") == "rover":
            self._lose(where, "a plan has no points relative to the rover")
            return
        match goal:
            case TakeoffGoal():
                self._takeoff(goal.altitude_m)
            case GoToGoal():
                self._go_to(goal)
            case GetImagesGoal():
                self._get_images(goal, where)
            case AreaCoverageGoal():
                self._coverage(goal, where)
            case LandOnSpotGoal() if not (goal.use_uwb or goal.use_tag) and goal.landing_spot_ned_m is not None:
                self._items.append(self._item(LAND, [0, 0, 0, None, *self._degrees(goal.landing_spot_ned_m[:2]), 0]))
            case LandOnSpotGoal():
                self._lose(where, "a plan can't land on the rover, and ends in the air")
            case _:
                self._return(action, where)

    def _lose(self, where: str, reason: str) -> None:
        self._notes.append(f"{where} is left out: {reason}")

    def _return(self, action: str, where: str) -> None:
        if action != "return_home":
            self._lose(where, f"QGroundControl has no action {action}")
            return
        self._items.append(self._item(RETURN, [0, 0, 0, 0, 0, 0, 0], frame=2))
        self._notes.append(f"{where} is the autopilot's own return: to the take-off point, and not to the rover")

    # -- simple items --

    def _takeoff(self, height_m: float) -> None:
        self._items.append(self._item(TAKEOFF, [0, 0, 0, None, *self._degrees((0.0, 0.0)), height_m]))
        self._taken_off = True

    def _go_to(self, goal: GoToGoal) -> None:
        if goal.do_takeoff and not self._taken_off:
            self._takeoff(altitude_m(goal.target_ned_m[2]))
        self._set_speed(goal.speed_mps)
        yaw_deg = None if goal.yaw_rad is None else round(degrees(goal.yaw_rad), 3)
        self._waypoint(goal.target_ned_m[:2], altitude_m(goal.target_ned_m[2]), yaw_deg)

    def _waypoint(self, point_m: tuple[float, float], height_m: float, yaw_deg: float | None = None) -> None:
        self._items.append(self._item(WAYPOINT, [0, 0, 0, yaw_deg, *self._degrees(point_m), height_m]))
        self._here_m = point_m

    def _set_speed(self, speed_mps: float | None) -> None:
        if speed_mps != self._speed_mps:
            speed = DEFAULT_SPEED if speed_mps is None else speed_mps
            self._items.append(self._item(CHANGE_SPEED, [1, speed, -1, 0, 0, 0, 0], frame=2))
            self._speed_mps = speed_mps

    def _get_images(self, goal: GetImagesGoal, where: str) -> None:
        """Waypoints on the circle, beginning at the vehicle, with the camera at the target."""
        north_m, east_m, z_m = goal.center_ned_m
        self._set_speed(goal.speed_mps)
        target = [0, 0, 0, 0, *self._degrees((north_m, east_m)), altitude_m(goal.target_z_ned_m)]
        self._items.append(self._item(ROI, target))
        start_rad = atan2(self._here_m[1] - east_m, self._here_m[0] - north_m)
        for index in range(goal.num_images):
            angle_rad = start_rad + 2.0 * pi * index / goal.num_images
            point_m = (north_m + goal.radius_m * cos(angle_rad), east_m + goal.radius_m * sin(angle_rad))
            self._waypoint(point_m, altitude_m(z_m))
            self._items.append(self._item(TAKE_IMAGES, [0, 0, 1, 0, 0, 0, 0], frame=2))
        self._items.append(self._item(ROI_END, [0, 0, 0, 0, 0, 0, 0], frame=2))
        self._notes.append(f"{where} is {goal.num_images} waypoints with straight lines between them, not a circle")

    def _item(self, command: int, params: list[Any], frame: int = RELATIVE_FRAME) -> dict[str, Any]:
        self._count += 1
        item = {
            "type": "SimpleItem", "command": command, "frame": frame, "params": params, "autoContinue": True,
            "doJumpId": self._count,
        }  # fmt: skip
        if frame == RELATIVE_FRAME:
            item |= {"Altitude": params[6], "AltitudeMode": RELATIVE_MODE, "AMSLAltAboveTerrain": None}
        return item

    def _degrees(self, point_m: Sequence[float]) -> list[float]:
        place = geodetic_from_ned((point_m[0], point_m[1], 0.0), self._origin_deg)
        return [round(place[0], DECIMALS_DEG), round(place[1], DECIMALS_DEG)]

    # -- surveys --

    def _coverage(self, goal: AreaCoverageGoal, where: str) -> None:
        forced = msgspec.structs.replace(goal, force=True)  # whether it makes a map is decided when it is flown
        made = plan_or_refuse(forced, self._config, self._here_m, (0.0, 0.0, 0.0))
        if isinstance(made, Refusal):
            self._lose(where, f"it can't be planned: {made.reason}")
            return
        height_m = altitude_m(goal.z_ned_m)
        path = [self._degrees(point) for point in made.shown.path_ned_m]
        self._set_speed(goal.speed_mps)
        items = [self._item(WAYPOINT, [0, 0, 0, None, *path[0], height_m])]
        items.append(self._item(CAMERA_DISTANCE, [made.shown.picture_distance_m, 0, 1, 0, 0, 0, 0], frame=2))
        items += [self._item(WAYPOINT, [0, 0, 0, None, *place, height_m]) for place in path[1:]]
        items.append(self._item(CAMERA_DISTANCE, [0, 0, 0, 0, 0, 0, 0], frame=2))
        style = {
            "version": 1, "CameraCalc": self._camera(goal, made.shown.line_distance_m, made.shown.picture_distance_m),
            "CameraShots": len(made.shown.pictures_ned_m), "CameraTriggerInTurnAround": True, "FollowTerrain": False,
            "HoverAndCapture": False, "Items": items, "Refly90Degrees": False, "TurnAroundDistance": 0,
            "VisualTransectPoints": path,
        }  # fmt: skip
        self._items.append({
            "type": "ComplexItem", "complexItemType": "survey", "version": 5, "entryLocation": 0,
            "flyAlternateTransects": False, "splitConcavePolygons": False, "TransectStyleComplexItem": style,
            "angle": round(degrees(made.plan.lines_rad), 4),
            "polygon": [self._degrees(corner) for corner in goal.polygon_ned_m],
        })  # fmt: skip
        for hole in goal.holes_ned_m:
            corners = [self._degrees(corner) for corner in hole]
            self._zones.append({"version": 1, "inclusion": False, "polygon": corners})
        self._here_m = made.shown.path_ned_m[-1]
        self._lost_of_coverage(goal, where)

    def _lost_of_coverage(self, goal: AreaCoverageGoal, where: str) -> None:
        if goal.holes_ned_m:
            self._notes.append(
                f"{where}: holes of the area are exclusion zones of the geofence; lines that QGroundControl plans anew "
                "don't avoid them"
            )
        if goal.margin_outline_m:
            self._notes.append(f"{where}: QGroundControl has no margin, so that {goal.margin_outline_m:g} m are lost")

    def _camera(self, goal: AreaCoverageGoal, line_m: float, picture_m: float) -> dict[str, Any]:
        """The survey's camera: the vehicle's own, or for a goal with distances none."""
        height_m = altitude_m(goal.z_ned_m)
        common = {
            "version": 2, "DistanceMode": RELATIVE_MODE, "DistanceToSurface": height_m, "AdjustedFootprintSide": line_m,
            "AdjustedFootprintFrontal": picture_m,
        }  # fmt: skip
        if goal.resolution_m is not None or goal.picture_distance_m is not None:
            return common | {"CameraName": MANUAL_CAMERA}
        camera = self._config.vehicle.camera
        overlap, sidelap = (100.0 * (a if a is not None else b or 0.0) for a, b in (
            (goal.overlap, goal.sidelap), (goal.sidelap, goal.overlap)
        ))  # fmt: skip
        focal_mm = SENSOR_WIDTH_MM * camera.focal_px / camera.width_px
        return common | {
            "CameraName": "Custom Camera", "FixedOrientation": True, "Landscape": True, "MinTriggerInterval": 0,
            "ImageWidth": camera.width_px, "ImageHeight": camera.height_px, "SensorWidth": SENSOR_WIDTH_MM,
            "SensorHeight": SENSOR_WIDTH_MM * camera.height_px / camera.width_px, "FocalLength": focal_mm,
            "FrontalOverlap": overlap, "SideOverlap": sidelap, "ValueSetIsDistance": True,
            "ImageDensity": 100.0 * height_m * SENSOR_WIDTH_MM / (camera.width_px * focal_mm),
        }  # fmt: skip


def areas_of(mission: Mission, origin_deg: Sequence[float]) -> tuple[list[FilePolygon], list[str]]:
    """The areas of a mission's coverages in degrees, and a sentence for the steps that no area shows.

    Raises:
        ExportError: the mission has no area in the world frame.
    """
    areas: list[FilePolygon] = []
    others = 0
    for step in mission.steps:
        goal = None if isinstance(step, WaitStep) else step.goal
        if goal is None or "polygon_ned_m" not in goal or goal.get("frame") == "rover":
            others += 1
            continue
        rings = tuple(
            tuple((place[0], place[1]) for place in (geodetic_from_ned((*c, 0.0), _geodetic(origin_deg)) for c in ring))
            for ring in (goal["polygon_ned_m"], *goal.get("holes_ned_m", ()))
        )
        if all(area.rings != rings for area in areas):
            areas.append(FilePolygon(f"area {len(areas) + 1}", "", rings))
    if not areas:
        raise ExportError("has no area: no step covers one in the world frame")
    left_out = "1 other step is" if others == 1 else f"{others} other steps are"
    notes = [f"{left_out} left out: only areas are written"] if others else []
    return areas, notes


def _geodetic(origin_deg: Sequence[float]) -> tuple[float, float, float]:
    return (origin_deg[0], origin_deg[1], origin_deg[2])
