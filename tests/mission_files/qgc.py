"""Plans as QGroundControl 4 saves them."""

import json
from pathlib import Path
from typing import Any

HOME_DEG = (47.397742, 8.545594, 488.0)
FIELD_DEG = [[47.3980, 8.5458], [47.3980, 8.5464], [47.3984, 8.5464], [47.3984, 8.5458]]
HOLE_DEG = [[47.3981, 8.5460], [47.3981, 8.5461], [47.3982, 8.5461]]


def simple(command: int, params: list[Any], frame: int = 3) -> dict[str, Any]:
    """A SimpleItem."""
    return {
        "AMSLAltAboveTerrain": None, "Altitude": params[6], "AltitudeMode": 1, "autoContinue": True, "command": command,
        "doJumpId": 1, "frame": frame, "params": params, "type": "SimpleItem",
    }  # fmt: skip


def survey(camera: dict[str, Any] | None = None, style: dict[str, Any] | None = None, **fields: Any) -> dict[str, Any]:
    """A survey for a camera that QGroundControl knows; the arguments change it."""
    camera = {
        "AdjustedFootprintFrontal": 12.4, "AdjustedFootprintSide": 28.0, "CameraName": "Sony ILCE-QX1",
        "DistanceMode": 1, "DistanceToSurface": 40, "FixedOrientation": False, "FocalLength": 16,
        "FrontalOverlap": 75, "ImageDensity": 1.0, "ImageHeight": 3632, "ImageWidth": 5456, "Landscape": True,
        "MinTriggerInterval": 0, "SensorHeight": 15.4, "SensorWidth": 23.2, "SideOverlap": 65,
        "ValueSetIsDistance": True, "version": 2,
    } | (camera or {})  # fmt: skip
    transects = {
        "CameraCalc": camera, "CameraShots": 40, "CameraTriggerInTurnAround": True, "FollowTerrain": False,
        "HoverAndCapture": False, "Items": [], "Refly90Degrees": False, "TurnAroundDistance": 0,
        "VisualTransectPoints": [], "version": 1,
    } | (style or {})  # fmt: skip
    plain = {
        "TransectStyleComplexItem": transects, "angle": 0, "complexItemType": "survey", "entryLocation": 0,
        "flyAlternateTransects": False, "polygon": FIELD_DEG, "splitConcavePolygons": False, "type": "ComplexItem",
        "version": 5,
    }  # fmt: skip
    return plain | fields


def plan(*items: dict[str, Any], polygons: Any = (), rally: Any = (), home: Any = HOME_DEG) -> dict[str, Any]:
    """A plan with these items, zones of the geofence, and rally points."""
    mission = {
        "cruiseSpeed": 15, "firmwareType": 12, "globalPlanAltitudeMode": 1, "hoverSpeed": 5, "items": list(items),
        "plannedHomePosition": list(home), "vehicleType": 2, "version": 2,
    }  # fmt: skip
    zones = [{"inclusion": inclusion, "polygon": corners, "version": 1} for corners, inclusion in polygons]
    return {
        "fileType": "Plan", "geoFence": {"circles": [], "polygons": zones, "version": 2},
        "groundStation": "QGroundControl", "mission": mission, "rallyPoints": {"points": list(rally), "version": 2},
        "version": 1,
    }  # fmt: skip


TAKEOFF = simple(22, [0, 0, 0, None, 47.397742, 8.545594, 15])
WAYPOINT = simple(16, [4, 0, 0, 90, 47.3980, 8.5460, 25])
LAND = simple(21, [0, 0, 0, None, 47.3978, 8.5457, 0])


def written(folder: Path, content: Any, name: str = "survey.plan") -> Path:
    """The file of a plan."""
    path = folder / name
    path.write_text(json.dumps(content))
    return path
