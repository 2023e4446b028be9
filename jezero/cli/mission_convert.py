"""`jezero mission import` and `export`: missions from and for QGroundControl and Google Earth."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jezero.cli.area import ROUTER_WAIT_S, Origin, checked_origin
from jezero.cli.exit_codes import FAILED
from jezero.cli.mission_file import read_fence_file, read_mission_file
from jezero.cli.shared import FiniteRange, Printer, common_options

if TYPE_CHECKING:
    from jezero.area_files import FilePolygon
    from jezero.mission_files.imported import ImportedMission
    from jezero.schemas.mission import Mission

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
OUT = click.Path(path_type=Path, dir_okay=False)
EXPORTED = ".plan, .kml or .kmz"


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
@click.option("--leave-out", is_flag=True, help="Write the mission also without what it can't have.")
@click.option("--force", is_flag=True, help="Write over files that exist.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def import_mission(
    file: Path, out: Path, altitude_m: float, overlap: float, leave_out: bool, force: bool, as_json: bool
) -> None:
    """Make a mission of a plan (.plan, .mission), of waypoints (.waypoints, .txt), or of the areas of KML or KMZ.

    Points and areas stay in degrees. A geofence is written beside the mission, as mission.fence.yaml. What is flown in
    another way is named. A plan with parts that no mission can have is refused, or with --leave-out written without
    them.
    """
    from jezero.area_files.polygon import count
    from jezero.mission_files.imported import fence_yaml

    printer = Printer(as_json)
    made = _imported(file, altitude_m, overlap, printer)
    if made.lost and not leave_out:
        parts = "\n".join(f"  {text}" for text in made.lost)
        hint = "change the plan, or leave this out with --leave-out"
        printer.fail("mistakes", f"{file} has what no mission can have:\n{parts}\n{hint}", FAILED, lost=made.lost)
    texts = {out: made.to_yaml()}
    if made.fence is not None:
        texts[out.with_suffix(".fence.yaml")] = fence_yaml(made.fence)
    _refuse_existing(texts, force, printer)
    for path, text in texts.items():
        _write(path, text.encode(), printer)
    for note in made.lost:
        printer.event("lost", f"left out: {note}", note=note)
    for note in made.notes:
        printer.event("note", note, note=note)
    read_mission_file(str(out), made.some_origin_deg, printer)  # a plan may have numbers that no goal takes
    printer.event(
        "written", f"{out}: {count(len(made.steps), 'step')}; jezero mission check {out} plans them", file=str(out)
    )
    for path in list(texts)[1:]:
        read_fence_file(str(path), printer)
        printer.event("written", f"{path}: the geofence; jezero fence set {path} puts it in force", file=str(path))


@click.command(name="export")
@click.argument("file")
@click.option("-o", "--out", type=OUT, required=True, metavar="FILE", help=f"The file to write: {EXPORTED}.")
@click.option(
    "--origin", nargs=2, type=float, callback=checked_origin, metavar="LAT LON",
    help="Degrees of the world's origin [that of the running stack, else the simulator's].",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Write over a file that exists.")
@common_options
def export_mission(
    file: str, out: Path, origin: Origin | None, force: bool, vehicle: str, router: str, as_json: bool
) -> None:
    """Write a mission as a plan of QGroundControl (.plan), or its areas as KML or KMZ.

    Each part of the mission that the file can't have is named.
    """
    printer = Printer(as_json)
    ending = out.suffix.lower()
    if ending not in (".plan", ".kml", ".kmz"):
        raise click.BadParameter(f"{out}: its name must end in {EXPORTED}", param_hint="-o")
    _refuse_existing((out,), force, printer)
    origin_deg = _origin_deg(origin, vehicle, router)
    known_deg = origin_deg if origin is None else origin.position_deg
    mission = read_mission_file(file, known_deg, printer).mission
    data, notes = _exported(mission, origin_deg, ending, printer)
    _write(out, data, printer)
    for note in notes:
        printer.event("lost", note, note=note)
    where = "{:.6f}, {:.6f}".format(*origin_deg[:2])
    printer.event("written", f"{out}: around the world's origin at {where}", file=str(out), origin_deg=origin_deg[:2])


def _imported(file: Path, altitude_m: float, overlap: float, printer: Printer) -> "ImportedMission":
    from jezero.area_files import AreaFileError
    from jezero.mission_files.other_programs import import_file
    from jezero.mission_files.reader import FOREIGN

    endings = (*FOREIGN, ".txt")
    if file.suffix.lower() not in endings:
        raise click.BadParameter(f"{file}: its name must end in one of {', '.join(endings)}", param_hint="FILE")
    try:
        return import_file(file, altitude_m, overlap)
    except AreaFileError as error:
        printer.fail("mistakes", str(error), FAILED)


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


def _refuse_existing(files: Iterable[Path], force: bool, printer: Printer) -> None:
    existing = [str(file) for file in files if file.exists()]
    if existing and not force:
        printer.fail("mistakes", f"{' and '.join(existing)} exists: choose another name, or add --force", FAILED)


def _write(out: Path, data: bytes, printer: Printer) -> None:
    try:
        out.write_bytes(data)
    except OSError as error:
        printer.fail("mistakes", f"{out} can't be written: {error.strerror or error}", FAILED)
