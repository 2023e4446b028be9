"""Plans of QGroundControl: the areas of its surveys, or those of the geofence; exclusion fences become holes."""

from collections.abc import Iterator
from math import cos, pi, sin
from typing import Any

from jezero.area_files.polygon import AreaFileError, Corner, FilePolygon, Ring, excerpt, number_from, ring_from
from jezero.area_files.rings import overlap
from jezero.base.frames import geodetic_from_ned

CIRCLE_CORNERS = 72
"""The polygon in place of a circle differs from it by a thousandth of the radius."""
RADIUS_MAX_M = 50_000.0
PLAN_VERSION, MISSION_VERSION, OLD_GEOFENCE_VERSION, GEOFENCE_VERSION = 1, 2, 1, 2
SAVE_AGAIN = "open it in a QGroundControl of today and save it again"


def is_plan(content: Any) -> bool:
    """Whether a JSON file is a plan of QGroundControl."""
    return isinstance(content, dict) and content.get("fileType") == "Plan"


def checked_plan(content: Any) -> dict[str, Any]:
    """The content of a plan.

    Raises:
        AreaFileError: it is no plan, or one of a version that is not read.
    """
    if not is_plan(content):
        raise AreaFileError('is not a plan of QGroundControl: it has no "fileType": "Plan"')
    mission = _member(content, "mission")
    for kind, part, known in (("plan", content, PLAN_VERSION), ("mission", mission, MISSION_VERSION)):
        version = part.get("version", known)
        if version != known:
            raise AreaFileError(f'is a {kind} of version "{excerpt(version)}", and {known} is read: {SAVE_AGAIN}')
    plan: dict[str, Any] = content
    return plan


def read_plan(content: Any) -> list[FilePolygon]:
    """Read the areas of a plan; its degrees are [latitude, longitude].

    Raises:
        AreaFileError: it is not a plan, or has neither a survey nor a geofence that includes an area.
    """
    content = checked_plan(content)
    fences = list(read_geofence(content))
    kinds: list[str] = []
    areas = list(_surveys(_member(content, "mission"), kinds))
    if not areas:
        areas = [(place, ring) for place, ring, included in fences if included]
    if not areas:
        has = f": its items are {', '.join(sorted(set(kinds)))}" if kinds else ""
        raise AreaFileError(f"has neither a survey nor a geofence that includes an area{has}")
    return _with_holes(areas, fences)


def read_surveys(content: Any) -> list[FilePolygon]:
    """Read the areas of a plan's surveys in their order; exclusion fences that overlap with them are holes.

    Raises:
        AreaFileError: a survey or a fence has no area.
    """
    surveys = list(_surveys(_member(content, "mission"), []))
    return _with_holes(surveys, list(read_geofence(content)))


def _with_holes(areas: list[tuple[str, Ring]], fences: list[tuple[str, Ring, bool]]) -> list[FilePolygon]:
    excluded = [ring for _, ring, included in fences if not included]
    return [
        FilePolygon(place, place, (outline, *(ring for ring in excluded if overlap(outline, ring))))
        for place, outline in areas
    ]


def _surveys(mission: dict[str, Any], kinds: list[str]) -> Iterator[tuple[str, Ring]]:
    """The areas of the surveys; the kinds of all complex items are added to `kinds`."""
    number = 0
    for item in _list(mission, "items"):
        kind = item.get("complexItemType") if isinstance(item, dict) else None
        if kind is None:
            continue
        kinds.append(excerpt(kind))
        if kind == "survey":
            number += 1
            yield f"survey {number}", _ring(item.get("polygon"), f"survey {number}")


def read_geofence(content: Any) -> Iterator[tuple[str, Ring, bool]]:
    """The polygons and circles of a plan's geofence: place, outline in degrees, and whether the vehicle stays inside.

    Raises:
        AreaFileError: one of them is damaged, or the geofence is older or newer than the version that is read.
    """
    geofence = _member(content, "geoFence")
    version = geofence.get("version", GEOFENCE_VERSION)
    if version == OLD_GEOFENCE_VERSION:
        yield from _old_geofence(geofence)
        return
    if version != GEOFENCE_VERSION and any(value for name, value in geofence.items() if name != "version"):
        raise AreaFileError(
            f'has a geofence of version "{excerpt(version)}", and versions {OLD_GEOFENCE_VERSION} and '
            f"{GEOFENCE_VERSION} are read: {SAVE_AGAIN}"
        )
    for number, fence in enumerate(_list(geofence, "polygons"), 1):
        place = f"geofence polygon {number}"
        if not isinstance(fence, dict):
            raise AreaFileError(f'{place}: "{excerpt(fence)}" is not a fence')
        yield place, _ring(fence.get("polygon"), place), fence.get("inclusion") is not False
    for number, fence in enumerate(_list(geofence, "circles"), 1):
        place = f"geofence circle {number}"
        circle = fence.get("circle") if isinstance(fence, dict) else None
        if not isinstance(circle, dict):
            raise AreaFileError(f'{place}: "{excerpt(fence)}" is not a circle')
        included = fence.get("inclusion") is not False
        yield place, _circle(circle, place, included=included), included


def _old_geofence(geofence: dict[str, Any]) -> Iterator[tuple[str, Ring, bool]]:
    """The geofence of 2017: one polygon to stay in. Its circle was the vehicle's, and counts without a polygon."""
    circle = _member(geofence, "circle")
    if geofence.get("polygon"):
        yield "geofence polygon", _ring(geofence.get("polygon"), "geofence polygon"), True
    elif circle.get("radius"):
        yield "geofence circle", _circle(circle, "geofence circle", included=True), True


def _circle(circle: dict[str, Any], place: str, *, included: bool) -> Ring:
    """A polygon inside the circle that the vehicle stays in, or around the one that it stays out of."""
    center_deg = _corner(circle.get("center"), place)
    radius_m = number_from(circle.get("radius"))
    if radius_m is None or not 0.0 < radius_m <= RADIUS_MAX_M:
        raise AreaFileError(f'{place}: its radius "{excerpt(circle.get("radius"))}" is not within 0 to 50000 m')
    reach_m = radius_m if included else radius_m / cos(pi / CIRCLE_CORNERS)
    ring = []
    for index in range(CIRCLE_CORNERS):
        angle = 2.0 * pi * index / CIRCLE_CORNERS
        there = geodetic_from_ned((reach_m * cos(angle), reach_m * sin(angle), 0.0), (*center_deg, 0.0))
        ring.append((there[0], there[1]))
    return tuple(ring)


def _ring(corners: Any, place: str) -> Ring:
    if not isinstance(corners, list):
        raise AreaFileError(f"{place} has no list of corners")
    return ring_from([_corner(corner, f"{place}, corner {number}") for number, corner in enumerate(corners, 1)], place)


def _corner(corner: Any, place: str) -> Corner:
    values = corner[:2] if isinstance(corner, list) and len(corner) >= 2 else (None, None)
    latitude_deg, longitude_deg = (number_from(value) for value in values)
    if latitude_deg is None or longitude_deg is None or abs(latitude_deg) > 90.0 or abs(longitude_deg) > 360.0:
        raise AreaFileError(f'{place}: "{excerpt(corner)}" is not [latitude, longitude] in degrees')
    if abs(longitude_deg) > 180.0:
        longitude_deg = (longitude_deg + 180.0) % 360.0 - 180.0
    return latitude_deg, longitude_deg


def _member(content: dict[str, Any], name: str) -> dict[str, Any]:
    member = content.get(name)
    return member if isinstance(member, dict) else {}


def _list(content: dict[str, Any], name: str) -> list[Any]:
    member = content.get(name)
    return member if isinstance(member, list) else []
