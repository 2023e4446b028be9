"""`jezero getimages` and `jezero gridsweep`: goals that take images."""

from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click
import msgspec
from click.core import ParameterSource

from jezero.cli.area import (
    CoverageRequest,
    Origin,
    area_options,
    around_origin,
    place_in_words,
    read_polygon_file,
    vehicle_origin,
)
from jezero.cli.coverage_plan import show_coverage_plan
from jezero.cli.pictures import PNG_OR_JPG, default_folder, take_pictures
from jezero.cli.plan import agreed_plan, as_planned, send_goal
from jezero.cli.shared import FINITE, FRAMES, NUMBERS, FiniteRange, Printer, connected, flight_options
from jezero.os_errors import write_whole
from jezero.private_files import keep_private

if TYPE_CHECKING:
    from jezero import Vehicle
    from jezero.client.dataset import Dataset, Kind
    from jezero.schemas.goals import AreaCoverageGoal, Frame

RESUME_OPTIONS = {"resume", "kind", "yes", "vehicle", "router", "as_json"}
"""Parameters that a resumed coverage uses; the others are those of the coverage that ended early."""
DRAWING = Path("runs/plan.png")
RESUME = "resume.json"
"""File with the goal that takes the missing images, in the folder of an incomplete coverage."""


@click.command(context_settings=NUMBERS)
@click.argument("x", type=FINITE)
@click.argument("y", type=FINITE)
@click.argument("z", type=FINITE)
@click.argument("radius", type=FINITE)
@click.argument("n", type=int)
@click.argument("frame", type=FRAMES, default="world")
@click.option("--target-z", type=FINITE, default=0.0, show_default=True, help="z of the target, NED.")
@click.option("--speed", "speed_mps", type=FINITE, help="Metres per second along the circle.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder of the images [runs/<time>].")
@click.option("--format", "kind", type=PNG_OR_JPG, default="jpg", show_default=True, help="Image format.")
@click.option("--stream/--no-stream", default=True, show_default=True, help="Fetch images as taken, or at the end.")
@flight_options
def getimages(
    x: float,
    y: float,
    z: float,
    radius: float,
    n: int,
    frame: str,
    target_z: float,
    speed_mps: float | None,
    out: Path | None,
    kind: str,
    stream: bool,
    yes: bool,
    vehicle: str,
    router: str,
    as_json: bool,
) -> None:
    """Take images of a target from all sides: N images on a circle of RADIUS metres around X Y, at height Z.

    Coordinates are metres north, east and down, so 4 m up is `-4`. FRAME is world (default) or rover, whose origin is
    the middle of its platform: `jezero getimages -2.0 0 -4 2 4 rover`.
    """
    from jezero.schemas.goals import GetImagesGoal
    from jezero.schemas.topics import GET_IMAGES

    printer = Printer(as_json)
    dataset = _new_dataset(out, kind)
    goal = GetImagesGoal(
        center_ned_m=(x, y, z),
        radius_m=radius,
        num_images=n,
        frame=cast("Frame", frame),
        target_z_ned_m=target_z,
        speed_mps=speed_mps,
        stream_images=stream,
    )
    with connected(vehicle, router, printer) as uav:
        take_pictures(printer, send_goal(printer, uav, GET_IMAGES, goal, yes=yes), "getimages", dataset)


@click.command(context_settings=NUMBERS)
@click.argument("frame", type=FRAMES, default="world")
@area_options
@click.option("--z", "z_ned_m", type=FINITE, help="Height of the flight, NED: 5 m up is -5.")
@click.option(
    "--margin",
    "margin_outline_m",
    type=FiniteRange(min=0.0),
    default=0.0,
    show_default=True,
    help="Metres from the outline.",
)
@click.option(
    "--hole-margin",
    "margin_holes_m",
    type=FiniteRange(min=0.0),
    default=1.0,
    show_default=True,
    help="Metres from each hole.",
)
@click.option(
    "--resolution", "resolution_m", type=FiniteRange(min=0.0), help="Metres between lines, and between images."
)
@click.option("--overlap", type=FiniteRange(0.0, 0.95), help="Share of an image that the next one repeats.")
@click.option("--sidelap", type=FiniteRange(0.0, 0.95), help="The same for the images of the next line.")
@click.option(
    "--picture-distance", "picture_distance_m", type=FiniteRange(min=0.0, min_open=True),
    help="Metres between images on a line [that of --resolution or --overlap].",
)  # fmt: skip
@click.option(
    "--angle", "angle_deg", type=FiniteRange(-360.0, 360.0),
    help="Direction of the lines in degrees, clockwise from north [that of the shortest path].",
)  # fmt: skip
@click.option("--speed", "speed_mps", type=FINITE, help="Metres per second along the lines.")
@click.option("--force", is_flag=True, help="Fly also where images show too little, or no map can be made of them.")
@click.option("--plan-only", is_flag=True, help="Draw the plan instead of flying it.")
@click.option("--plan-id", default="", metavar="ID", help="Fly exactly the plan that --plan-only has shown.")
@click.option(
    "--resume", type=click.Path(path_type=Path, exists=True, file_okay=False), help="Folder of an incomplete coverage."
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder of the images [runs/<time>], or the plan's PNG file."
)
@click.option("--format", "kind", type=PNG_OR_JPG, default="jpg", show_default=True, help="Image format.")
@flight_options
def gridsweep(
    origin: Origin | None,
    plan_only: bool,
    resume: Path | None,
    out: Path | None,
    kind: str,
    yes: bool,
    vehicle: str,
    router: str,
    as_json: bool,
    **given: Any,
) -> None:
    """Cover an area in parallel lines and take images of all of it.

    Without --polygon the command asks for the corners. A file is in degrees: GeoJSON (.geojson, .json), KML (.kml,
    .kmz), a plan of QGroundControl (.plan), a shapefile (.shp), or a table (.csv) with the headings
    "latitude,longitude", a line for each corner, and an empty line before each hole. Metres around the world's origin
    are in a table with the headings "north,east", or with --metres in a table without headings or in GeoJSON. FRAME is
    world (default) or rover, whose areas are in metres. --plan-only asks the running stack for the plan that it would
    fly; without a stack, the path begins near the world's origin. --resume takes the missing images of a coverage that
    ended early.
    """
    _refuse_unused(plan_only=plan_only, resume=resume)
    if plan_only:
        file = _drawing(out)
        show_coverage_plan(_request(**given), origin, file, vehicle=vehicle, router=router, as_json=as_json)
        return
    if origin is not None:
        raise click.UsageError("--origin is for --plan-only: a vehicle that flies has its own")
    printer = Printer(as_json)
    pending: AreaCoverageGoal | CoverageRequest
    if resume is None:
        pending, dataset = _request(**given), _new_dataset(out, kind)
    else:
        missing, dataset = _resumed(resume, kind)
        if missing is None:
            text = f"nothing is missing in {resume}: all {dataset.count} images are there"
            printer.event("result", text, outcome="succeeded", folder=str(resume))
            return
        pending = missing
    with connected(vehicle, router, printer) as uav:
        goal = _placed(pending, printer, vehicle_origin(uav.status().odometry))
        _fly_coverage(printer, uav, goal, dataset, yes=yes, is_new=resume is None)


def _fly_coverage(
    printer: Printer, uav: "Vehicle", goal: "AreaCoverageGoal", dataset: "Dataset", *, yes: bool, is_new: bool
) -> None:
    """Fly a coverage as the user has agreed to its plan, and save its images and what is needed to resume it."""
    from jezero.schemas.topics import AREA_COVERAGE

    plan = agreed_plan(printer, uav, AREA_COVERAGE, goal, yes=yes)
    images_goal: Any = uav.send(AREA_COVERAGE, as_planned(goal, plan))
    # with its start, the same path can be resumed if its server dies, and drawn beside the one flown
    start_ned_m = goal.start_ned_m if plan.coverage is None else plan.coverage.start_ned_m
    goal = msgspec.structs.replace(goal, plan_id="", start_ned_m=start_ned_m)
    if is_new:
        dataset.note(goal=goal)
    _write_resume_goal(dataset.folder, goal)
    take_pictures(
        printer, images_goal, "gridsweep", dataset, lambda result: _write_resume_goal(dataset.folder, result.resume)
    )


def _placed(
    pending: "AreaCoverageGoal | CoverageRequest", printer: Printer, known: Origin | None
) -> "AreaCoverageGoal":
    """The goal around the vehicle's origin; prints where a new area is."""
    if not isinstance(pending, CoverageRequest):
        return around_origin(pending, known)
    goal = pending.goal(known)
    printer.event(
        "area", f"area: {place_in_words(goal, known)}", origin_deg=None if known is None else known.position_deg
    )
    return goal


def _refuse_unused(*, plan_only: bool, resume: Path | None) -> None:
    """Refuse options that a plan without a flight, or a resumed coverage, would not use."""
    context = click.get_current_context()
    given = {
        parameter.name: parameter.opts[-1] if parameter.param_type_name == "option" else "FRAME"
        for parameter in context.command.params
        if context.get_parameter_source(str(parameter.name)) is ParameterSource.COMMANDLINE
    }
    if plan_only and (unused := [given[name] for name in ("resume", "plan_id") if name in given]):
        raise click.UsageError(f"{unused[0]} is for a flight: leave out {unused[0]} or --plan-only")
    unused = [word for name, word in given.items() if name not in RESUME_OPTIONS]
    if resume is not None and unused:
        raise click.UsageError(
            f"--resume takes the rest of the coverage as it was planned: leave out {', '.join(sorted(unused))}"
        )


def _drawing(out: Path | None) -> Path:
    """File of a plan's drawing."""
    if out is None:
        return DRAWING
    if out.suffix.lower() != ".png" or out.is_dir():
        raise click.UsageError(f"with --plan-only, --out is a PNG file, such as plan.png, and {out} is none")
    return out


def _new_dataset(out: Path | None, kind: str) -> "Dataset":
    from jezero.client.dataset import Dataset

    keep_private()
    try:
        return Dataset(out or default_folder(), cast("Kind", kind))
    except FileExistsError as error:
        raise click.ClickException(str(error)) from None


def _resumed(folder: Path, kind: str) -> "tuple[AreaCoverageGoal | None, Dataset]":
    """Goal for the missing images of a folder, None if all are there, and the folder's dataset.

    The folder of a command that was killed has images since its goal was written, so the images count.
    """
    from jezero.client.dataset import Dataset
    from jezero.schemas.goals import AreaCoverageGoal
    from jezero.schemas.images import LISTING

    file, listing = folder / RESUME, folder / LISTING
    if not file.exists() and not listing.exists():
        raise click.ClickException(f"{folder} has neither {RESUME} nor {LISTING}: is it the folder of a gridsweep?")
    try:
        if not file.exists():
            return None, Dataset.reopen(folder)
        goal = msgspec.json.decode(file.read_bytes(), type=AreaCoverageGoal)
        whole = msgspec.structs.replace(goal, first_picture=0)
        if not listing.exists():
            return whole, Dataset(folder, cast("Kind", kind), goal=whole)
        dataset = Dataset.reopen(folder, cast("Kind", kind), goal=whole)
    except msgspec.DecodeError as error:
        raise click.ClickException(f"{folder} can't be resumed: {error}") from None
    if dataset.first_missing == dataset.planned:
        file.unlink()
        return None, dataset
    return msgspec.structs.replace(goal, first_picture=dataset.first_missing), dataset


def _write_resume_goal(folder: Path, goal: "AreaCoverageGoal | None") -> None:
    """Write the goal for the missing images, or remove the file if none is missing."""
    file = folder / RESUME
    if goal is None:
        file.unlink(missing_ok=True)
    else:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(file, msgspec.json.format(msgspec.json.encode(goal), indent=1) + b"\n")


def _request(file: Path | None, feature: str | None, metres: bool, **fields: Any) -> CoverageRequest:
    """Make a coverage from the options; asks for the missing values."""
    from jezero.area_files import FilePolygon

    if file is None:
        polygon = FilePolygon("", "the area", (_prompt_for_corners(),), in_metres=True)
    else:
        polygon = read_polygon_file(file, feature, metres=metres, frame=fields["frame"])
    angle_deg = fields.pop("angle_deg")
    fields["angle_rad"] = None if angle_deg is None else radians(angle_deg)
    if fields["z_ned_m"] is None:
        fields["z_ned_m"] = click.prompt("Enter altitude", type=FINITE)
    if fields["resolution_m"] is None and fields["overlap"] is None and fields["sidelap"] is None:
        fields["resolution_m"] = click.prompt("Enter resolution", type=FINITE)
    return CoverageRequest(polygon, fields)


def _prompt_for_corners() -> tuple[tuple[float, float], ...]:
    """Ask for the corners as in the thesis' Fig. 3.13."""
    corners = []
    for number in range(1, click.prompt("Enter number of grid points", type=click.IntRange(3, 1000)) + 1):
        click.echo(f"Grid point n. {number} :")
        corners.append(
            (click.prompt("Enter x coordinate", type=FINITE), click.prompt("Enter y coordinate", type=FINITE))
        )
    return tuple(corners)
