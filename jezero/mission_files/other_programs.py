"""Missions from the files of other programs: QGroundControl, Mission Planner, Google Earth."""

from pathlib import Path
from typing import Any

from jezero.area_files import AreaFileError, read_polygons
from jezero.area_files.geojson import parse_json
from jezero.area_files.reader import BYTES_MAX
from jezero.mission_files.imported import ImportedMission, import_polygons
from jezero.mission_files.plan_items import WPL, plan_of_mission, plan_of_waypoints
from jezero.mission_files.qgc_import import import_plan

AREAS = (".kml", ".kmz")


def import_file(file: Path, altitude_m: float, overlap: float) -> ImportedMission:
    """Make a mission of a file of another program.

    Args:
        file: a plan, a mission or waypoints; or areas, each of which becomes a coverage.
        altitude_m: as `overlap`, for areas; see `import_polygons`.

    Raises:
        AreaFileError: it can't be read, or has nothing to fly; the message names the file.
    """
    try:
        if file.suffix.lower() in AREAS:
            return import_polygons(read_polygons(file), file.stem, altitude_m, overlap)
        return import_plan(_plan(file), file.stem)
    except RecursionError:
        raise AreaFileError(f"{file} is nested too deeply") from None
    except OSError as error:
        raise AreaFileError(f"{file} can't be read: {error.strerror or error}") from None
    except AreaFileError as error:
        raise AreaFileError(str(error) if str(file) in str(error) else f"{file}: {error}") from None


def _plan(file: Path) -> Any:
    """The content of a plan, or that of the plan that an older file has become."""
    if file.stat().st_size > BYTES_MAX:
        raise AreaFileError(f"has more than {BYTES_MAX / 1e6:.0f} MB, which no plan needs")
    data = file.read_bytes()
    text = data.decode("utf-8-sig", errors="replace")
    if text.lstrip().startswith(WPL) or file.suffix.lower() in (".waypoints", ".txt"):
        return plan_of_waypoints(text)
    content = parse_json(data)
    if file.suffix.lower() == ".mission" and isinstance(content, dict) and content.get("fileType") != "Plan":
        return plan_of_mission(content)
    return content
