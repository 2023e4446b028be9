"""GeoJSON (RFC 7946): Polygon and MultiPolygon, alone, in features and in collections."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from jezero.area_files.polygon import AreaFileError, Corner, FilePolygon, excerpt, number_from, ring_from
from jezero.area_files.reference_system import Convert, degrees_from
from jezero.area_files.rings import joined_at_180
from jezero.base.files import NOT_UTF8

NAMES = ("name", "Name", "NAME", "title", "id")
"""Properties of a feature that name it, the best first."""


def parse_json(data: bytes) -> Any:
    """The content of a JSON file.

    Raises:
        AreaFileError: it is not JSON.
    """
    try:
        return json.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise AreaFileError(NOT_UTF8) from None
    except json.JSONDecodeError as error:
        raise AreaFileError(f"line {error.lineno}, column {error.colno} is not JSON ({error.msg})") from None
    except RecursionError:
        raise AreaFileError("is nested too deeply") from None
    except ValueError:  # an integer of thousands of digits
        raise AreaFileError("has a number with too many digits") from None


def read_geojson(content: Any, *, metres: bool) -> list[FilePolygon]:
    """Read all polygons of a file.

    Args:
        content: content of the file.
        metres: the coordinates are [north, east] in metres instead of [longitude, latitude] in degrees.

    Raises:
        AreaFileError: it has no polygon, or something that is not GeoJSON.
    """
    if isinstance(content, list):
        if not metres:
            raise AreaFileError("is a plain list of corners, which is in metres, [north, east]: add --metres")
        content = {"type": "Polygon", "coordinates": [content]}
    convert = _converter(content, metres)
    others: set[str] = set()
    found: list[FilePolygon] = []
    for geometry, name, place in _geometries(content, "", ""):
        kind = geometry.get("type")
        if isinstance(kind, str) and kind in {"Polygon", "MultiPolygon"}:
            found += _polygons(geometry, name, place, convert, in_metres=metres)
        else:
            others.add(excerpt(kind))
    if not found:
        has = f": it has {', '.join(sorted(others))}" if others else ""
        raise AreaFileError(f"has no GeoJSON Polygon or MultiPolygon{has}")
    return [replace(polygon, perhaps_metres=not metres and "crs" not in content) for polygon in found]


def _polygons(
    geometry: dict[str, Any], name: str, place: str, convert: Convert, *, in_metres: bool
) -> Iterator[FilePolygon]:
    """The polygons of a Polygon or a MultiPolygon.

    Args:
        place: where the geometry stands in the file; "" if it is the whole file.
        convert: makes a corner of the first two coordinates.

    Raises:
        AreaFileError: the coordinates are not those of such a geometry.
    """
    coordinates = geometry.get("coordinates")
    parts = coordinates if geometry["type"] == "MultiPolygon" else [coordinates]
    if not isinstance(parts, list):
        raise AreaFileError(f"{place or geometry['type']}: its coordinates are not a list of polygons")
    order = "[north, east] in metres" if in_metres else "[longitude, latitude] in degrees"
    whole = place or str(geometry["type"])
    areas = []
    for number, rings in enumerate(parts, 1):
        here = f"{whole}, part {number}" if len(parts) > 1 else whole
        if not isinstance(rings, list) or not rings:
            raise AreaFileError(f"{here}: its coordinates are not a list of rings")
        areas.append(tuple(_ring(ring, f"{here}, ring {index}", convert, order) for index, ring in enumerate(rings, 1)))
    areas = areas if in_metres else joined_at_180(areas)
    for number, area in enumerate(areas, 1):
        here = f"{whole}, part {number}" if len(areas) > 1 else whole
        yield FilePolygon(name, here, area, in_metres)


def _ring(ring: Any, place: str, convert: Convert, order: str) -> tuple[Corner, ...]:
    if not isinstance(ring, list):
        raise AreaFileError(f'{place}: "{excerpt(ring)}" is not a list of corners, {order}')
    corners = []
    for number, position in enumerate(ring, 1):
        values = position[:2] if isinstance(position, list) else ()
        first, second = (number_from(value) for value in (*values, None, None)[:2])
        if first is None or second is None:
            raise AreaFileError(f'{place}, corner {number}: "{excerpt(position)}" is not {order}')
        corners.append(convert(first, second))
    return ring_from(corners, place)


def _geometries(content: Any, name: str, place: str) -> Iterator[tuple[dict[str, Any], str, str]]:
    """Each geometry with its name and its place, those of features and collections one by one."""
    if not isinstance(content, dict):
        raise AreaFileError(f'{place + ": " if place else ""}"{excerpt(json.dumps(content))}" is not a GeoJSON object')
    kind = content.get("type")
    if kind == "Feature":
        if content.get("geometry") is not None:
            yield from _geometries(content["geometry"], _name_of(content), place)
        return
    member, noun = {"FeatureCollection": ("features", "feature"), "GeometryCollection": ("geometries", "geometry")}.get(
        str(kind), ("", "")
    )
    if not member:
        yield content, name, place
        return
    members = content.get(member)
    if not isinstance(members, list):
        raise AreaFileError(f'{place + ": " if place else ""}the {kind} has no list "{member}"')
    for number, each in enumerate(members, 1):
        yield from _geometries(each, name, ", ".join(filter(None, (place, f"{noun} {number}"))))


def _name_of(feature: dict[str, Any]) -> str:
    properties = feature.get("properties")
    named = properties if isinstance(properties, dict) else {}
    for value in (*(named.get(name) for name in NAMES), feature.get("id")):
        if isinstance(value, str | int | float) and str(value).strip():
            return str(value).strip()
    return ""


def _converter(content: Any, metres: bool) -> Convert:
    """Function from the first two coordinates of a position to a corner."""
    system = content.get("crs") if isinstance(content, dict) else None
    if system is None:
        return (lambda north_m, east_m: (north_m, east_m)) if metres else _swap
    if metres:
        raise AreaFileError("names a coordinate system (crs), so its coordinates are not metres: leave out --metres")
    properties = system.get("properties") if isinstance(system, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if not isinstance(name, str):
        raise AreaFileError(f'the coordinate system (crs) "{excerpt(system)}" has no name: leave it out for WGS 84')
    return degrees_from(name)


def _swap(longitude_deg: float, latitude_deg: float) -> Corner:
    return latitude_deg, longitude_deg
