"""The commands of the section "Survey": images of a target, images of an area and its plan, and the map of them."""

import json
from contextlib import suppress
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from time import strftime
from typing import TYPE_CHECKING, Any, cast

import click
import msgspec
from click.core import ParameterSource

from jezero.base.files import keep_private, write_whole
from jezero.base.mistakes import mistake
from jezero.cli.goals import agreed_plan, as_planned, flight_in_words, minutes, send_goal, take_pictures
from jezero.cli.options import (
    FINITE,
    FRAMES,
    NUMBERS,
    ROUTER_WAIT_S,
    FiniteRange,
    Origin,
    PngFile,
    flight_options,
    origin_option,
    simulator_origin,
    vehicle_origin,
)
from jezero.cli.terminal import Printer, connected

if TYPE_CHECKING:
    from jezero.area_files import FilePolygon
    from jezero.client import Vehicle
    from jezero.client.dataset import Dataset, Kind
    from jezero.mapping.making import Map
    from jezero.schemas.actions import PlannedCoverage, PlanReply
    from jezero.schemas.fence import Fence
    from jezero.schemas.goals import AreaCoverageGoal, Corners, Frame

PNG_OR_JPG = click.Choice(["jpg", "png"])
RESUME_OPTIONS = {"resume", "kind", "yes", "vehicle", "router", "as_json"}
"""Parameters that a resumed coverage uses; the others are those of the coverage that ended early."""
DRAWING = Path("runs/plan.png")
RESUME = "resume.json"
"""File with the goal that takes the missing images, in the folder of an incomplete coverage."""
M_PER_PX = 0.02
"""Resolution of a map."""


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


def _new_dataset(out: Path | None, kind: str) -> "Dataset":
    from jezero.client.dataset import Dataset

    keep_private()
    try:
        return Dataset(out or Path("runs") / strftime("%Y-%m-%d_%H-%M-%S"), cast("Kind", kind))
    except FileExistsError as error:
        raise click.ClickException(str(error)) from None


@click.command(context_settings=NUMBERS)
@click.argument("frame", type=FRAMES, default="world")
@click.option(
    "--polygon",
    "file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="File of the area, see above.",
)
@click.option("--feature", metavar="NAME|N", help="The area of this name or number, if the file has several.")
@click.option("--metres", is_flag=True, help="The file is in metres: [north, east], or by its headings.")
@origin_option("Degrees of the world's origin for --plan-only without a stack [the simulator's].")
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
        _show_plan(_request(**given), origin, file, vehicle=vehicle, router=router, as_json=as_json)
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


@dataclass(frozen=True)
class CoverageRequest:
    """A coverage whose area is not placed in the world yet.

    Attributes:
        polygon: the area as its file has it.
        fields: the goal's other fields.
    """

    polygon: "FilePolygon"
    fields: dict[str, Any]

    def goal(self, origin: Origin | None) -> "AreaCoverageGoal":
        """Place the area. Without an origin, it must be in metres."""
        from jezero.area_files import AreaFileError, place
        from jezero.schemas.goals import AreaCoverageGoal

        try:
            area = place(self.polygon, None if origin is None else origin.position_deg)
        except AreaFileError as error:
            raise click.ClickException(str(error)) from None
        return AreaCoverageGoal(
            polygon_ned_m=area.polygon_ned_m, holes_ned_m=area.holes_ned_m, origin_deg=area.origin_deg, **self.fields
        )


def _request(file: Path | None, feature: str | None, metres: bool, **fields: Any) -> CoverageRequest:
    """Make a coverage from the options; asks for the missing values."""
    from jezero.area_files import FilePolygon

    if file is None:
        polygon = FilePolygon("", "the area", (_prompt_for_corners(),), in_metres=True)
    else:
        polygon = _read_polygon(file, feature, metres=metres, frame=fields["frame"])
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


def _read_polygon(file: Path, feature: str | None, *, metres: bool, frame: str) -> "FilePolygon":
    """Read the polygon of an area; in the rover's frame it must be in metres."""
    from jezero.area_files import AreaFileError, read_polygon

    try:
        polygon = read_polygon(file, feature=feature, metres=metres)
    except AreaFileError as error:
        raise click.ClickException(str(error)) from None
    if frame == "rover" and not polygon.in_metres:
        raise click.ClickException(
            f"{polygon.place} is in degrees, which are never relative to the rover: leave out `rover`, or add --metres "
            "to a file in metres"
        )
    return polygon


def _drawing(out: Path | None) -> Path:
    """File of a plan's drawing."""
    if out is None:
        return DRAWING
    if out.suffix.lower() != ".png" or out.is_dir():
        raise click.UsageError(f"with --plan-only, --out is a PNG file, such as plan.png, and {out} is none")
    return out


@dataclass(frozen=True)
class _Planned:
    """A plan that is not flown.

    Attributes:
        start: where its path begins, and why there, for people.
        reply: of the stack that would fly it; None for a plan that no stack knows.
        fence: the vehicle's fence; None without one, and for a plan in the rover's frame.
    """

    goal: "AreaCoverageGoal"
    origin: Origin
    coverage: "PlannedCoverage"
    warning: str
    start: str
    reply: "PlanReply | None" = None
    fence: "Fence | None" = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know before the plan is flown, the fence that it leaves among it."""
        from jezero.base.fence import way_refusal

        leaves = ""
        if self.fence is not None:
            way_ned_m = [(north_m, east_m, self.goal.z_ned_m) for north_m, east_m in self.coverage.path_ned_m]
            leaves = way_refusal(self.fence, way_ned_m, from_ground=False, to_ground=False)
        return tuple(text for text in (self.warning, leaves) if text)


def _show_plan(
    request: CoverageRequest, origin: Origin | None, file: Path, *, vehicle: str, router: str, as_json: bool
) -> None:
    """Plan a coverage, draw it into a file, and print its figures.

    A running stack plans it as it would fly it. With an origin of its own, the plan is not that of a stack.
    """
    from jezero.report.coverage_plot import draw_plan
    from jezero.services.actions.area_coverage.area import make_area

    planned = _plan_of_stack(request, vehicle, router) if origin is None else None
    if planned is None:
        place = origin or simulator_origin()
        start = "assumed at the vehicle's place before a flight, 0 0, as no stack is asked"
        planned = _plan_here(request, place, (0.0, 0.0), start)
    goal, coverage = planned.goal, planned.coverage
    area = make_area(goal.polygon_ned_m, goal.holes_ned_m)
    title = f"{len(coverage.pictures_ned_m)} images, {coverage.length_m:.0f} m, {minutes(coverage.duration_s)}"
    draw_plan(file, area, coverage, title, planned.fence)
    if as_json:
        click.echo(json.dumps(_plan_fields(planned)))
        return
    shares = f"{100.0 * coverage.covered:.1f} % of it swept, {100.0 * coverage.photographed:.1f} % photographed"
    click.echo(f"area        {area.area:.1f} m², {shares}")
    click.echo(f"place       {place_in_words(goal, planned.origin)}")
    lines = f"lines {coverage.line_distance_m:.3g} m apart"
    click.echo(f"path        {coverage.length_m:.1f} m in {coverage.duration_s:.0f} s, {lines}")
    click.echo(f"images      {len(coverage.pictures_ned_m)}, every {coverage.picture_distance_m:.3g} m")
    click.echo(f"start       {planned.start}")
    if planned.reply is not None:
        click.echo(f"flight      {flight_in_words(planned.reply)}")
        click.echo(f"plan        {coverage.plan_id}: with --plan-id {coverage.plan_id} exactly this plan is flown")
    click.echo(f"drawn in    {file}")
    for warning in planned.warnings:
        click.echo(f"warning: {warning}", err=True)


def place_in_words(goal: "AreaCoverageGoal", origin: Origin | None) -> str:
    """Where the area of a goal lies."""
    norths_m, easts_m = zip(*goal.polygon_ned_m, strict=True)
    ends_m = (round(end_m) for end_m in (min(norths_m), max(norths_m), min(easts_m), max(easts_m)))
    where = "north {} to {} m, east {} to {} m".format(*ends_m)
    if goal.frame == "rover":
        return f"{where} from the rover's platform"
    at = "" if origin is None else f" at {origin} ({origin.source})"
    return f"{where} from the world's origin{at}"


def _plan_of_stack(request: CoverageRequest, vehicle: str, router: str) -> _Planned | None:
    """The plan as the running stack would fly it; None without a stack."""
    from jezero.client import TimedOut, Unreachable, Vehicle

    try:
        with Vehicle.connect(vehicle, router=router, insecure=True, timeout_s=ROUTER_WAIT_S) as uav:
            planned = _ask_stack(request, uav)
            if planned is not None and planned.goal.frame == "world":
                with suppress(Unreachable, TimedOut):  # a bridge of an earlier version publishes no fence
                    return replace(planned, fence=uav.fence().fence)
            return planned
    except (Unreachable, TimedOut):
        return None


def _ask_stack(request: CoverageRequest, uav: "Vehicle") -> _Planned | None:
    """The plan by a stack; from the vehicle's position also if the stack would refuse to fly it now."""
    from jezero.client import Refused
    from jezero.schemas.topics import AREA_COVERAGE

    odometry = uav.status().odometry
    if odometry is None:
        return None
    origin = vehicle_origin(odometry) or simulator_origin()
    goal = request.goal(origin)
    north_m, east_m, _ = odometry.pos_uav_ned_m
    at = f"at the vehicle, {north_m:.1f} m north and {east_m:.1f} m east"
    try:
        reply = uav.plan(AREA_COVERAGE, goal)
    except Refused as error:
        if goal.frame == "rover":
            raise click.ClickException(str(error)) from None
        return _plan_here(request, origin, (north_m, east_m), f"{at}; it would not fly now: {error}")
    if reply.coverage is None:
        return None
    return _Planned(
        goal, origin, reply.coverage, reply.warning, "at the vehicle" if goal.frame == "rover" else at, reply
    )


def _plan_here(request: CoverageRequest, origin: Origin, start_m: tuple[float, float], start: str) -> _Planned:
    """A plan by this command itself, for a vehicle that hovers at a point of the goal's frame."""
    from jezero.services.actions.area_coverage.planner import plan_or_refuse
    from jezero.services.actions.config import load_actions_config
    from jezero.services.actions.motion.behaviour import Refusal

    goal = request.goal(origin)
    try:
        msgspec.convert(msgspec.to_builtins(goal), type(goal))  # as a server would check its numbers
    except msgspec.ValidationError as error:
        raise click.ClickException(f"gridsweep: {mistake(error, type(goal))}") from None
    made = plan_or_refuse(goal, load_actions_config(), start_m, (0.0, 0.0, 0.0))
    if isinstance(made, Refusal):
        raise click.ClickException(made.reason)
    return _Planned(goal, origin, made.shown, made.plan.warning, start)


def _plan_fields(planned: _Planned) -> dict[str, object]:
    """The plan for programs."""
    coverage, reply = planned.coverage, planned.reply
    return {
        "plan_id": None if reply is None else coverage.plan_id,
        "path_ned_m": coverage.path_ned_m,
        "pictures_ned_m": coverage.pictures_ned_m,
        "start_ned_m": coverage.start_ned_m,
        "length_m": round(coverage.length_m, 3),
        "time_s": round(coverage.duration_s, 3),
        "covered": round(coverage.covered, 5),
        "photographed": round(coverage.photographed, 5),
        "warning": "; ".join(planned.warnings),
        "start": planned.start,
        "battery_used": None if reply is None else reply.battery_used,
        "origin_deg": planned.origin.position_deg,
    }


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


def around_origin(goal: "AreaCoverageGoal", origin: Origin | None) -> "AreaCoverageGoal":
    """The goal of an earlier flight around the vehicle's present origin, which an autopilot places where it starts.

    The area is moved as a whole, so that it keeps its plan and the numbers of its images. An area in metres stays.
    """
    from jezero.base.frames import ned_from_geodetic

    if origin is None or goal.origin_deg is None or goal.origin_deg == origin.position_deg:
        return goal
    by_north_m, by_east_m, _ = ned_from_geodetic((*goal.origin_deg, 0.0), (*origin.position_deg, 0.0))

    def moved(corners_m: "Corners") -> "Corners":
        return tuple((north_m + by_north_m, east_m + by_east_m) for north_m, east_m in corners_m)

    return msgspec.structs.replace(
        goal,
        origin_deg=origin.position_deg,
        polygon_ned_m=moved(goal.polygon_ned_m),
        holes_ned_m=tuple(map(moved, goal.holes_ned_m)),
        start_ned_m=None if goal.start_ned_m is None else moved((goal.start_ned_m,))[0],
    )


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
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
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


@click.command("map")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--resolution",
    "m_per_px",
    type=FiniteRange(0.001, 10.0),
    default=M_PER_PX,
    show_default=True,
    help="Metres per pixel.",
)
@click.option("--out", type=PngFile(), help="The map's file, a PNG [FOLDER/map.png].")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
def map_(folder: Path, m_per_px: float, out: Path | None, as_json: bool) -> None:
    """Make a map from a coverage's images in FOLDER: a PNG with north at the top, a GeoTIFF and a KML overlay.

    The PNG's world file is in metres of the world frame, x to the east and y to the north; the GeoTIFF and the overlay
    are in degrees. The ground's height comes from the altimeter; features that images have in common correct their
    positions.
    """
    map_pictures(Printer(as_json), folder, m_per_px, out)


def map_pictures(printer: Printer, folder: Path, m_per_px: float = M_PER_PX, out: Path | None = None) -> None:
    """Make a map from a folder's images and print a summary.

    Raises:
        click.ClickException: the folder has no images, or they cannot be mapped.
    """
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.mapping.making import make_map
    from jezero.mapping.survey import SurveyError

    file = out or folder / "map.png"
    try:
        made = make_map(folder, m_per_px, load_config(VehicleConfig, "vehicle"))
        files = made.save(file)
    except SurveyError as error:
        raise click.ClickException(str(error)) from None
    height_px, width_px, _ = made.mosaic.pixels.shape
    alignment = made.alignment
    printer.event(
        "result",
        f"{_alignment_text(made)}\nmap of {width_px} x {height_px} pixels, {made.description}\n"
        f"wrote {', '.join(str(path) for path in files)}{_origin_text(made)}",
        outcome="succeeded",
        file=str(file),
        files=[str(path) for path in files],
        m_per_px=m_per_px,
        picture_m_per_px=made.picture_m_per_px,
        origin_deg=made.origin_deg,
        pictures=made.pictures,
        pairs=alignment.pairs,
        groups=alignment.groups,
        apart_before_m=alignment.before_m if alignment.pairs else None,
        apart_after_m=alignment.after_m if alignment.pairs else None,
    )


def _alignment_text(made: "Map") -> str:
    alignment = made.alignment
    if alignment.pairs == 0:
        return f"{made.pictures} images without ground in common: each is placed by the vehicle's own position"
    text = (
        f"{made.pictures} images, {alignment.pairs} pairs with ground in common; median offset before alignment "
        f"{100.0 * alignment.before_m:.1f} cm, after it {100.0 * alignment.after_m:.1f} cm"
    )
    if len(alignment.groups) > 1:
        sizes = ", ".join(str(size) for size in alignment.groups)
        text += (
            f"\nwarning: {len(alignment.groups)} groups of images ({sizes}) have no ground in common: where they meet, "
            "the map may be off by the errors of the vehicle's position; take pictures of the ground between them"
        )
    return text


def _origin_text(made: "Map") -> str:
    if made.origin_deg is None:
        return "\nthe images have no position in degrees, so there is no GeoTIFF and no KML"
    latitude, longitude, _ = made.origin_deg
    return f"\nthe map's origin is at latitude {latitude:.7f}, longitude {longitude:.7f}"
