"""Area files of the tests, and how they are read."""

import json
from pathlib import Path
from typing import Any

import pytest

from jezero.area_files import Area, AreaFileError, read_area
from jezero.base.frames import geodetic_from_ned

ORIGIN_DEG = (47.397742, 8.545594)
EXAMPLES = Path(__file__).parents[2] / "docs/how-to/fields"
ORCHARD = ((0.0, 2.0), (0.0, 14.0), (10.0, 16.0), (12.0, 4.0))
TREE = ((4.0, 7.0), (6.0, 7.0), (6.0, 9.0), (4.0, 9.0))
FIELD = ((0.0, 0.0), (0.0, 40.0), (25.0, 45.0), (30.0, 10.0))
NAMED = {"type": "Feature", "properties": {"name": "north"}}


def degrees(corners_m: Any) -> list[list[float]]:
    """[latitude, longitude] of each corner."""
    return [list(geodetic_from_ned((*corner, 0.0), (*ORIGIN_DEG, 0.0))[:2]) for corner in corners_m]


def geojson(corners_m: Any) -> list[list[float]]:
    """A ring of GeoJSON, [longitude, latitude]."""
    return [[longitude, latitude] for latitude, longitude in degrees([*corners_m, corners_m[0]])]


POLYGON = {"type": "Polygon", "coordinates": [geojson(FIELD)]}


def read(folder: Path, name: str, content: str | bytes | dict[str, Any] | list[Any], **options: Any) -> Area:
    """Write a file and read it."""
    data = content if isinstance(content, bytes) else content if isinstance(content, str) else json.dumps(content)
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    return read_area(folder / name, ORIGIN_DEG, **options)


def sentence(folder: Path, name: str, content: str | bytes | dict[str, Any] | list[Any], **options: Any) -> str:
    """Write a file that is refused; the refusal names the file."""
    with pytest.raises(AreaFileError) as refused:
        read(folder, name, content, **options)
    text = str(refused.value)
    assert text.startswith(str(folder / name)) and "\n" not in text
    return text.removeprefix(str(folder / name)).lstrip(":, ")


def near(ring: Any, corners: Any, tolerance_m: float = 0.003) -> bool:
    """Whether a ring has these corners in this order."""
    return len(ring) == len(corners) and all(
        abs(a - b) <= tolerance_m
        for corner, other in zip(ring, corners, strict=True)
        for a, b in zip(corner, other, strict=True)
    )


def same(area: Area, outline: Any, holes: Any = ()) -> bool:
    """Whether an area has these rings, each in any direction, from any corner on, to the centimetre."""
    rings = zip((area.polygon_ned_m, *area.holes_ned_m), (outline, *holes), strict=True)
    return all(near(_sorted(ring), _sorted(other)) for ring, other in rings)


def _sorted(ring: Any) -> Any:
    return sorted((round(north, 2), round(east, 2)) for north, east in ring)
