"""Reads an area file of any format, and chooses the one area that is meant."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jezero.area_files.area import EXTENT_MIN_M, Area, area_m2, place
from jezero.area_files.csv_table import read_csv
from jezero.area_files.geojson import parse_json, read_geojson
from jezero.area_files.kml import read_kml, read_kmz
from jezero.area_files.polygon import AreaFileError, FilePolygon, excerpt
from jezero.area_files.qgc_plan import is_plan, read_plan
from jezero.area_files.shapefiles import read_shapefile

BYTES_MAX = 50_000_000
LISTED_MAX = 20
METRES_FORMATS = {".csv", ".txt", ".json", ".geojson"}
FORMATS = {*METRES_FORMATS, ".kml", ".kmz", ".plan", ".shp"}


def read_area(
    file: Path | str, origin_deg: Sequence[float] | None, *, feature: str | int | None = None, metres: bool = False
) -> Area:
    """Read an area and place it in the world frame.

    Args:
        file: GeoJSON (.geojson, .json), table (.csv, .txt), KML (.kml, .kmz), plan of QGroundControl (.plan), or
            shapefile (.shp).
        origin_deg: latitude and longitude of the world's origin in degrees, such as `Odometry.origin_deg`; None if the
            file is in metres.
        feature: name of the area, or its number counted from 1; a file with several areas needs it.
        metres: the coordinates are metres, [north, east]; for GeoJSON and tables.

    Raises:
        AreaFileError: the file can't be read, or has no such area; the message says what to write instead.
    """
    return place(read_polygon(file, feature=feature, metres=metres), origin_deg)


def read_polygon(file: Path | str, *, feature: str | int | None = None, metres: bool = False) -> FilePolygon:
    """Read the polygon of an area; the arguments and the error are those of `read_area`."""
    found = read_polygons(file, metres=metres)
    try:
        chosen = _choose(found, feature)
    except AreaFileError as error:
        raise AreaFileError(f"{file}: {error}") from None
    return replace(chosen, place=f"{file}, {chosen.place}")


def read_polygons(file: Path | str, *, metres: bool = False) -> list[FilePolygon]:
    """Read all areas of a file; the arguments and the error are those of `read_area`."""
    try:
        return _read(Path(file), metres)
    except OSError as error:
        raise AreaFileError(f"{file} can't be read: {error.strerror or error}") from None
    except RecursionError:
        raise AreaFileError(f"{file} is nested too deeply") from None
    except AreaFileError as error:
        raise AreaFileError(f"{file}: {error}") from None


def _read(file: Path, metres: bool) -> list[FilePolygon]:
    kind = file.suffix.lower()
    if kind not in FORMATS:
        ending = f'its name ends in "{kind}"' if kind else "its name has no ending"
        raise AreaFileError(f"{ending}: known are {', '.join(sorted(FORMATS))}")
    if metres and kind not in METRES_FORMATS:
        raise AreaFileError(f"{kind} files are never in [north, east] metres: leave out --metres")
    if file.stat().st_size == 0:
        raise AreaFileError("is empty: export the area again")
    if file.stat().st_size > BYTES_MAX:
        raise AreaFileError(f"has more than {BYTES_MAX / 1e6:.0f} MB: export the one field only")
    if kind == ".shp":
        return read_shapefile(file)
    data = file.read_bytes()
    if kind in {".csv", ".txt"}:
        return read_csv(data, metres=metres)
    if kind == ".kmz":
        return read_kmz(data, BYTES_MAX)
    if kind == ".kml":
        return read_kml(data)
    content = parse_json(data)
    if kind == ".plan" or is_plan(content):
        return read_plan(content)
    return read_geojson(content, metres=metres)


def _choose(found: list[FilePolygon], feature: str | int | None) -> FilePolygon:
    """The polygon of a name or a number, or the only one."""
    if feature is None:
        if len(found) == 1:
            return found[0]
        if all(polygon.in_metres and area_m2(polygon) < EXTENT_MIN_M**2 for polygon in found):
            raise AreaFileError("has only areas of less than 0.1 m: if its numbers are degrees, leave out --metres")
        raise AreaFileError(f"has {len(found)} areas, choose one with --feature NUMBER or NAME: {_listed(found)}")
    named = [polygon for polygon in found if polygon.name == str(feature)]
    if len(named) == 1:
        return named[0]
    if named:
        raise AreaFileError(f'has {len(named)} areas "{feature}", choose one with --feature NUMBER: {_listed(found)}')
    if str(feature).isdecimal() and 1 <= int(feature) <= len(found):
        return found[int(feature) - 1]
    raise AreaFileError(f'has no area "{feature}", but {_listed(found)}')


def _listed(found: list[FilePolygon]) -> str:
    """Number, name and size of each area."""
    listed = [
        " ".join(filter(None, (str(number), excerpt(polygon.name), f"({area_m2(polygon):.0f} m²)")))
        for number, polygon in enumerate(found[:LISTED_MAX], 1)
    ]
    rest = len(found) - len(listed)
    return ", ".join(listed) + (f", and {rest} more" if rest else "")
