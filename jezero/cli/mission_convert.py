"""`jezero mission import` and `export`: missions from and for QGroundControl and Google Earth."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.area import ROUTER_WAIT_S, Origin, checked_origin
from jezero.cli.exit_codes import FAILED
from jezero.cli.mission_file import read_mission_file
from jezero.cli.shared import FiniteRange, Printer, common_options

if TYPE_CHECKING:
    from jezero.area_files import FilePolygon
    from jezero.mission_files import MissionFile
    from jezero.mission_files.imported import ImportedMission
    from jezero.schemas.mission import Mission

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
OUT = click.Path(path_type=Path, dir_okay=False)
ENDINGS = ".plan, .kml or .kmz"


@click.command(name="import")
@click.argument("file", type=FILE)
@click.option("-o", "--out", type=OUT, required=True, metavar="MISSION", help="The mission file, e.g. mission.yaml.")
@click.option(
    "--altitude", "altitude_m", type=FiniteRange(min=0.0, min_open=True), default=8.0, show_default=True,
    help="Metres above the take-off point at which areas of a KML or KMZ file are flown.",
)  # fmt: skip
@click.option(
    "--overlap", type=FiniteRange(0.0, 0.95), default=0.7, show_default=True,
    help="Overlap of the images of these areas, 0 to 0.95.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def import_mission(file: Path, out: Path, altitude_m: float, overlap: float, as_json: bool) -> None:
    """Make a mission of a plan of QGroundControl (.plan), or of the polygons of a KML or KMZ file.

    Points and areas stay in degrees. Each part of the plan that the mission doesn't have is named.
    """
    from jezero.area_files.polygon import count

    printer = Printer(as_json)
    made = _imported(file, altitude_m, overlap, printer)
    _write(out, made.to_yaml().encode(), printer)
    for note in made.notes:
        printer.event("lost", note)
    _check(out, printer)
    printer.event(
        "written", f"{out}: {count(len(made.steps), 'step')}; jezero mission check {out} plans them", file=str(out)
    )


@click.command(name="export")
@click.argument("file")
@click.option("-o", "--out", type=OUT, required=True, metavar="FILE", help=f"The file to write: {ENDINGS}.")
@click.option(
    "--origin", nargs=2, type=float, callback=checked_origin, metavar="LAT LON",
    help="Degrees of the world's origin [that of the running stack, else the simulator's].",
)  # fmt: skip
@common_options
def export_mission(file: str, out: Path, origin: Origin | None, vehicle: str, router: str, as_json: bool) -> None:
    """Write a mission as a plan of QGroundControl (.plan), or its areas as KML or KMZ.

    Each part of the mission that the file can't have is named.
    """
    printer = Printer(as_json)
    ending = out.suffix.lower()
    if ending not in (".plan", ".kml", ".kmz"):
        raise click.BadParameter(f"{out}: its name must end in {ENDINGS}", param_hint="-o")
    origin_deg = _origin_deg(origin, vehicle, router)
    mission = read_mission_file(file, origin_deg[:2], printer).mission
    data, notes = _exported(mission, origin_deg, ending, printer)
    _write(out, data, printer)
    for note in notes:
        printer.event("lost", note)
    where = "{:.6f}, {:.6f}".format(*origin_deg[:2])
    printer.event("written", f"{out}: around the world's origin at {where}", file=str(out), origin_deg=origin_deg[:2])


def _imported(file: Path, altitude_m: float, overlap: float, printer: Printer) -> "ImportedMission":
    from jezero.area_files import AreaFileError, read_polygons
    from jezero.area_files.geojson import parse_json
    from jezero.area_files.reader import BYTES_MAX
    from jezero.mission_files.imported import import_polygons
    from jezero.mission_files.qgc_import import import_plan

    ending = file.suffix.lower()
    try:
        if ending == ".plan":
            if file.stat().st_size > BYTES_MAX:
                raise AreaFileError(f"has more than {BYTES_MAX / 1e6:.0f} MB, which no plan needs")
            return import_plan(parse_json(file.read_bytes()), file.stem)
        if ending in (".kml", ".kmz"):
            return import_polygons(read_polygons(file), file.stem, altitude_m, overlap)
    except RecursionError:
        printer.fail("mistakes", f"{file} is nested too deeply", FAILED)
    except (AreaFileError, OSError) as error:
        text = str(error) if str(file) in str(error) else f"{file}: {error}"
        printer.fail("mistakes", text, FAILED)
    raise click.BadParameter(f"{file}: its name must end in {ENDINGS}", param_hint="FILE")


def _exported(
    mission: "Mission", origin_deg: Sequence[float], ending: str, printer: Printer
) -> tuple[bytes, list[str]]:
    from jezero.area_files.kml_writer import kml_of, kmz_of
    from jezero.mission_files.qgc_export import ExportError, areas_of, export_plan
    from jezero.services.actions.config import load_actions_config

    try:
        if ending == ".plan":
            plan, notes = export_plan(mission, origin_deg, load_actions_config())
            return json.dumps(plan, indent=4).encode() + b"\n", notes
        areas: list[FilePolygon]
        areas, notes = areas_of(mission, origin_deg)
    except ExportError as error:
        printer.fail("mistakes", f"{mission.name} {error}", FAILED)
    return (kml_of if ending == ".kml" else kmz_of)(areas), notes


def _origin_deg(origin: Origin | None, vehicle: str, router: str) -> list[float]:
    """Latitude, longitude and altitude of the world's origin."""
    from jezero.client import TimedOut, Unreachable, Vehicle
    from jezero.runtime.config import load_config
    from jezero.services.simulator.config import SimulatorConfig

    if origin is not None:
        return [*origin.position_deg, 0.0]
    try:
        with Vehicle.connect(vehicle, router=router, insecure=True, timeout_s=ROUTER_WAIT_S) as uav:
            odometry = uav.status().odometry
            if odometry is not None and odometry.origin_deg is not None:
                return list(odometry.origin_deg)
    except (Unreachable, TimedOut):
        pass
    return list(load_config(SimulatorConfig, "simulator").origin.origin_deg)


def _check(out: Path, printer: Printer) -> "MissionFile":
    """Read the file that was written: a plan may have numbers that no goal takes."""
    first = _first_place(out)
    return read_mission_file(str(out), first, printer)


def _first_place(out: Path) -> "list[float] | None":
    """Latitude and longitude of any place of the mission, around which all others are near."""
    import yaml

    document: dict[str, Any] = yaml.safe_load(out.read_text(encoding="utf-8"))
    for point in document.get("points", {}).values():
        return list(point["degrees"])
    for area in document.get("areas", {}).values():
        return list(area["degrees"][0])
    return None


def _write(out: Path, data: bytes, printer: Printer) -> None:
    try:
        out.write_bytes(data)
    except OSError as error:
        printer.fail("mistakes", f"{out} can't be written: {error.strerror or error}", FAILED)
