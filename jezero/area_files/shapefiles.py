"""ESRI shapefiles: the polygons of the .shp file, named by the .dbf file, in the coordinates of the .prj file."""

import struct
import warnings
from pathlib import Path
from typing import Any

from jezero.area_files.geojson import NAMES
from jezero.area_files.polygon import AreaFileError, Corner, FilePolygon, excerpt, ring_from
from jezero.area_files.reference_system import Convert, degrees_from
from jezero.area_files.rings import with_holes

DAMAGES = (OSError, ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError, MemoryError)
"""What pyshp raises for damaged files, besides its own exception and that of `struct`."""
NULL, KINDS = 0, {5, 15, 25}
"""Codes of a shape without corners, and of polygons: flat, with altitudes, with measures."""


def read_shapefile(file: Path) -> list[FilePolygon]:
    """Read all polygons; without a .prj file, the coordinates are longitude and latitude.

    Raises:
        AreaFileError: the file is damaged, or has no polygon; or its coordinate system is not known.
    """
    convert = _converter(file)
    found = []
    for number, (rings, name) in enumerate(_shapes(file), 1):
        here = f"shape {number}"
        areas = with_holes([ring_from([convert(*point) for point in ring], here) for ring in rings])
        for part, area in enumerate(areas, 1):
            found.append(FilePolygon(name, here + (f", part {part}" if len(areas) > 1 else ""), area))
    if not found:
        raise AreaFileError("has no shapes")
    return found


def _converter(file: Path) -> Convert:
    """Function from a shape's coordinates to a corner, by the .prj file."""
    prj = _beside(file, ".prj")
    system = "" if prj is None else prj.read_text(encoding="utf-8", errors="replace").strip()
    return degrees_from(system) if system else _unnamed


def _beside(file: Path, suffix: str) -> Path | None:
    """Another file of the same shapefile; None if it is missing."""
    return next((each for name in (suffix, suffix.upper()) if (each := file.with_suffix(name)).exists()), None)


def _unnamed(east: float, north: float) -> Corner:
    if abs(north) > 90.0 or abs(east) > 360.0:
        raise AreaFileError(f"{east:g}, {north:g} is not longitude and latitude, and no .prj file says what it is")
    return north, east


def _shapes(file: Path) -> list[tuple[list[list[Corner]], str]]:
    """The rings of each shape, and its name."""
    try:
        import shapefile
    except ModuleNotFoundError:
        raise AreaFileError("is a shapefile, which needs pyshp, an extra: pip install 'jezero[cli]'") from None
    try:
        with warnings.catch_warnings(action="ignore"), shapefile.Reader(str(file), encodingErrors="replace") as reader:
            kind, shapes = reader.shapeType, [shape for shape in reader.iterShapes() if shape.shapeType != NULL]
            if kind in KINDS:
                named = _beside(file, ".dbf") is not None
                return [(_rings(shape), _name(reader, shape.oid) if named else "") for shape in shapes]
    except shapefile.ShapefileException as error:
        raise AreaFileError(f"is not a shapefile that can be read ({excerpt(error)})") from None
    except (struct.error, *DAMAGES):  # their messages are about bytes
        raise AreaFileError("is not a shapefile that can be read: export it again") from None
    raise AreaFileError(f"has shapes of type {shapefile.SHAPETYPE_LOOKUP.get(kind, kind)} instead of polygons")


def _rings(shape: Any) -> list[list[Corner]]:
    """A shape's rings, without the altitudes and measures of their corners."""
    ends = [*shape.parts[1:], len(shape.points)]
    return [
        [(float(point[0]), float(point[1])) for point in shape.points[start:end]]
        for start, end in zip(shape.parts, ends, strict=True)
    ]


def _name(reader: Any, index: int) -> str:
    """Name of a shape, from the .dbf file."""
    record = reader.record(index).as_dict()
    return next((str(record[name]).strip() for name in NAMES if str(record.get(name) or "").strip()), "")
