"""Polygons with holes from files: GeoJSON and CSV, metres [north, east]."""

import json
from pathlib import Path
from typing import Any

Corners = tuple[tuple[float, float], ...]


class PolygonFileError(ValueError):
    """The file has no valid polygon; the message names the place and the expected content."""


def read_polygon(file: Path) -> tuple[Corners, tuple[Corners, ...]]:
    """Read the outline and the holes, each (n, 2) metres north and east.

    Raises:
        PolygonFileError: the file can't be read, or has no polygon.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise PolygonFileError(f"{file} can't be read: {error}") from None
    rings = _from_csv(file, text) if file.suffix.lower() == ".csv" else _from_geojson(file, text)
    if not rings:
        raise PolygonFileError(f"{file} has no corners")
    return rings[0], tuple(rings[1:])


def _from_csv(file: Path, text: str) -> list[Corners]:
    rings: list[list[tuple[float, float]]] = [[]]
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            rings.append([])
            continue
        try:
            north_m, east_m = (float(word) for word in line.split(","))
        except ValueError:
            if number == 1:  # a header line
                continue
            raise PolygonFileError(f'{file}, line {number}: "{line}" is not "north,east" in metres') from None
        rings[-1].append((north_m, east_m))
    return [tuple(ring) for ring in rings if ring]


def _from_geojson(file: Path, text: str) -> list[Corners]:
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise PolygonFileError(f"{file} is not JSON ({error}); a list of corners must end in .csv") from None
    geometry = _polygon_in(content)
    if geometry is None:
        raise PolygonFileError(f"{file} has no GeoJSON Polygon")
    if "crs" in content or "crs" in geometry:
        raise PolygonFileError(f"{file} names a coordinate system (crs): coordinates must be metres, [north, east]")
    try:
        return [tuple((float(corner[0]), float(corner[1])) for corner in ring) for ring in geometry["coordinates"]]
    except (KeyError, TypeError, ValueError, IndexError):
        raise PolygonFileError(f"{file}: coordinates must be rings of [north, east] in metres") from None


def _polygon_in(content: Any) -> Any:
    """The first Polygon of a geometry, a feature or a collection."""
    if not isinstance(content, dict):
        return None
    if content.get("type") == "Polygon":
        return content
    inside = [content.get("geometry"), *(content.get("features") or []), *(content.get("geometries") or [])]
    return next((found for each in inside if (found := _polygon_in(each)) is not None), None)
