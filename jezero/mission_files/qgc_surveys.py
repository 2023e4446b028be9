"""Coverages from the surveys of QGroundControl's plans."""

from collections.abc import Iterator, Mapping
from math import pi, radians
from typing import Any

from jezero.area_files.polygon import AreaFileError, excerpt, number_from
from jezero.area_files.qgc_plan import SAVE_AGAIN
from jezero.mission_files.imported import ImportedMission
from jezero.mission_files.plan_items import Height, survey_height

MANUAL_CAMERA = "Manual (no camera specs)"
OVERLAP_MAX = 0.95
VERSIONS = (4, 5)
CAMERA_COMMANDS = (203, 206, 530, 2000, 2001)
"""Numbers of MAV_CMD with which surveys and scans take images."""


def survey_coverages(
    item: Mapping[str, Any], plan_mode: Any, where: str, made: ImportedMission
) -> Iterator[dict[str, Any]]:
    """Fields of the coverages that a survey becomes, without its area: one, or with a second pass across two.

    Args:
        plan_mode: QGroundControl's number for the altitudes of the whole plan.
        made: gets the notes, and what is lost.

    Raises:
        AreaFileError: the survey is of a version that is not read, or has no altitude or no distances.
    """
    if (version := item.get("version", VERSIONS[-1])) not in VERSIONS:
        raise AreaFileError(f'{where} is of version "{excerpt(version)}", and 4 and 5 are read: {SAVE_AGAIN}')
    style = _member(item, "TransectStyleComplexItem")
    camera = _member(style, "CameraCalc")
    if style.get("FollowTerrain") is True:
        raise AreaFileError(f"{where} follows the terrain, whose heights the vehicle doesn't know: switch that off")
    height = survey_height(camera, plan_mode, where)
    angle_deg = number_from(item.get("angle")) or 0.0
    if lost := list(_lost(item, style)):
        made.lost.append(f"{where}: the coverage plans its own lines, without {', '.join(lost)}")
    spacing = _spacing(camera, where, made)
    passes = (0.0, 90.0) if style.get("Refly90Degrees") is True else (0.0,)
    for turn_deg in passes:
        angle_rad = round(radians(angle_deg + turn_deg) % pi, 6)
        yield {"z_ned_m": _z_ned_m(height), **spacing, "angle_rad": angle_rad}


def takes_pictures(item: Mapping[str, Any]) -> bool:
    """Whether a scan takes images along its way."""
    style = _member(item, "TransectStyleComplexItem")
    distance_m = number_from(_member(style, "CameraCalc").get("AdjustedFootprintFrontal"))
    items = style.get("Items")
    commands = [below.get("command") for below in (items if isinstance(items, list) else []) if isinstance(below, dict)]
    return bool(distance_m) or any(command in CAMERA_COMMANDS for command in commands)


def _z_ned_m(height: Height) -> Height:
    return height if isinstance(height, dict) else -height


def _spacing(camera: Mapping[str, Any], where: str, made: ImportedMission) -> dict[str, float]:
    """Overlaps of images; without a known camera, the distances between lines and between images."""
    overlaps = [number_from(camera.get(side)) for side in ("FrontalOverlap", "SideOverlap")]
    name = camera.get("CameraName")
    if name == MANUAL_CAMERA or None in overlaps:
        side_m, front_m = (number_from(camera.get(f"AdjustedFootprint{part}")) for part in ("Side", "Frontal"))
        if not side_m:
            raise AreaFileError(f"{where} has neither overlaps nor a distance between its lines")
        if not front_m:
            made.notes.append(f"{where} takes no images in the plan; the coverage takes one every {side_m:g} m")
        return {"resolution_m": side_m} | ({"picture_distance_m": front_m} if front_m else {})
    fractions = [min(max(each or 0.0, 0.0) / 100.0, OVERLAP_MAX) for each in overlaps]
    if any((each or 0.0) > 100.0 * OVERLAP_MAX for each in overlaps):
        made.lost.append(f"{where}: overlaps above {100 * OVERLAP_MAX:g} %, which become {100 * OVERLAP_MAX:g} %")
    if isinstance(name, str) and name and name != "Custom Camera":
        made.notes.append(f"{where}: its overlaps hold for the vehicle's own camera, and not for {excerpt(name)}")
    return {"overlap": round(fractions[0], 4), "sidelap": round(fractions[1], 4)}


def _lost(item: Mapping[str, Any], style: Mapping[str, Any]) -> Iterator[str]:
    """Parts of a survey that a coverage doesn't have."""
    if turnaround_m := number_from(style.get("TurnAroundDistance")):
        yield f"the turnarounds of {turnaround_m:g} m"
    if style.get("HoverAndCapture") is True:
        yield "the stop at each image"
    if item.get("flyAlternateTransects") is True:
        yield "the alternate order of lines"


def _member(content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    member = content.get(name)
    return member if isinstance(member, dict) else {}
