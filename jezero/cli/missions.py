"""The commands of the section "Missions": fences, and missions that the vehicle's mission service flies.

A file with mistakes ends a command, which names each of them. The plan of a mission is judged by what it needs: each
step with duration, length, battery and images, and the sum.
"""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import msgspec

from jezero.base.mistakes import unknown
from jezero.cli import completion
from jezero.cli.goals import LONG_FLIGHT_S, confirm, minutes
from jezero.cli.options import (
    FINITE,
    ROUTER_WAIT_S,
    CommandGroup,
    FiniteRange,
    Origin,
    common_options,
    flight_options,
    origin_option,
    simulator_origin,
    vehicle_origin,
)
from jezero.cli.terminal import ABORTED, FAILED, INCOMPLETE, Printer, connected

if TYPE_CHECKING:
    from jezero.area_files import FilePolygon
    from jezero.client import Vehicle
    from jezero.mission_files import MissionFile, StepPlan
    from jezero.mission_files.imported import ImportedMission
    from jezero.mission_files.planning import Plan, Start
    from jezero.schemas.actions import PlanReply
    from jezero.schemas.fence import Fence
    from jezero.schemas.goals import Goal
    from jezero.schemas.mission import Mission, MissionProgress
    from jezero.schemas.rows import Action

ROVER_TIMEOUT_S = 2.0
FENCE_HELP = "FILE is a fence in YAML or JSON, or a .plan of QGroundControl with a geofence."
MISSION_HELP = "FILE is a mission in YAML or JSON, or the name of one that comes with jezero: jezero mission list."
WIND = click.option(
    "--wind", nargs=2, type=FINITE, metavar="MPS FROM_DEG",
    help="Wind to plan for, and the direction from which it blows [what the vehicle measures].",
)  # fmt: skip
COLOURS = {"succeeded": "green", "failed": "red", "interrupted": "yellow", "stopped": "yellow"}
GOES_ON = "the mission goes on; jezero mission status shows it, jezero mission stop ends it"
WAITS = "this command waits until the mission goes on or is stopped; Ctrl+C ends the command alone"
BUSY_TRIES, BUSY_S = 10, 0.3
Wind = tuple[float, float]
"""Speed in m/s, and the direction from which it blows, in degrees clockwise from north."""
FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
OUT = click.Path(path_type=Path, dir_okay=False)
EXPORTED = ".plan, .kml or .kmz"
T = TypeVar("T")


def read_mission_file(file: str, origin_deg: Sequence[float] | None, printer: Printer) -> "MissionFile":
    """Read a mission file, or one that comes with jezero."""
    from jezero.mission_files import read_mission, shipped_file, shipped_names

    path, names = Path(file), shipped_names()
    if not path.exists() and file in names:
        path = shipped_file(file)
    elif not path.exists() and path.name == file and not path.suffix:
        text = f"{unknown('mission', file, names)}, or the path of a file"
        printer.fail("mistakes", text, FAILED, problems=[{"line": 0, "text": text}])
    return _read(lambda: read_mission(path, origin_deg), printer)


def read_fence_file(file: str, printer: Printer) -> "Fence":
    """Read a fence file, or the geofence of a plan."""
    from jezero.mission_files import read_fence

    return _read(lambda: read_fence(file), printer)


def _read(read: Callable[[], T], printer: Printer) -> T:
    from jezero.mission_files import MissionFileError

    try:
        return read()
    except MissionFileError as error:
        problems = [{"line": problem.line, "text": problem.text} for problem in error.problems]
        printer.fail("mistakes", str(error), FAILED, problems=problems)


@click.group(cls=CommandGroup)
def fence() -> None:
    """Set the fence, which the vehicle doesn't leave; a goal whose planned way does is refused before it starts."""


@fence.command("check", epilog=FENCE_HELP)
@click.argument("file", shell_complete=completion.files)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def check_fence(file: str, as_json: bool) -> None:
    """Name the mistakes of a fence file."""
    from jezero.base.fence import fence_doubts

    printer = Printer(as_json)
    read = read_fence_file(file, printer)
    warnings = fence_doubts(read)
    printer.event("fence", _fence_in_words(read), warnings=warnings)
    for warning in warnings:
        printer.warn(warning)


@fence.command("set", epilog=FENCE_HELP)
@click.argument("file", shell_complete=completion.files)
@common_options
def set_fence(file: str, vehicle: str, router: str, as_json: bool) -> None:
    """Set the fence of a vehicle on the ground, until the vehicle's stack ends."""
    printer = Printer(as_json)
    read = read_fence_file(file, printer)
    with connected(vehicle, router, printer) as uav:
        uav.set_fence(read)
        warnings = _fence_doubts(uav, read)
        printer.event("fence", f"in force: {_fence_in_words(read)}", warnings=warnings)
        for warning in warnings:
            printer.warn(warning)


@fence.command("clear")
@common_options
def clear_fence(vehicle: str, router: str, as_json: bool) -> None:
    """Take the fence of a vehicle on the ground away."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        uav.set_fence(None)
        printer.event("fence", "no fence")


@fence.command("show")
@common_options
def show_fence(vehicle: str, router: str, as_json: bool) -> None:
    """Show the fence in force."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        state = uav.fence()
        waiting = "the fence waits for the vehicle's origin" if state.fence_id else "no fence"
        text = waiting if state.fence is None else _fence_in_words(state.fence)
        outside = f"; the vehicle is {state.outside}" if state.outside else ""
        printer.event("fence", text + outside, **msgspec.to_builtins(state))


def _fence_doubts(uav: "Vehicle", fence: "Fence") -> tuple[str, ...]:
    """Warnings for the person who has set a fence: about its parts, and about a vehicle or a rover outside."""
    from jezero.base.fence import fence_doubts, places_outside
    from jezero.base.frames import subtract
    from jezero.client.errors import JezeroError

    held, odometry = uav.fence().fence, uav.status().odometry
    if odometry is None or held is None:
        return fence_doubts(fence)
    pos_rover_ned_m = None
    with suppress(JezeroError):  # no estimator runs, or it is silent
        relative = uav.relative(timeout_s=ROVER_TIMEOUT_S)
        if relative.valid:
            pos_rover_ned_m = subtract(odometry.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
    return (*fence_doubts(held), *places_outside(held, odometry.pos_uav_ned_m, pos_rover_ned_m))


def _fence_in_words(fence: "Fence") -> str:
    parts = [] if fence.keep_in is None else [f"stay in {fence.keep_in.name}"]
    parts += [f"stay out of {', '.join(zone.name for zone in fence.keep_out)}"] if fence.keep_out else []
    parts += [] if fence.ceiling_m is None else [f"ceiling {fence.ceiling_m:g} m"]
    parts += [f"floor {fence.floor_over_ground_m:g} m"] if fence.floor_over_ground_m else []
    return f"{fence.name}: {', '.join(parts)}"


@click.group(cls=CommandGroup)
def mission() -> None:
    """Fly missions: lists of goals in a file, in YAML or JSON.

    `jezero mission check FILE` names every mistake. `jezero mission run FILE` hands the mission to the vehicle, where
    it goes on when this command or this computer is gone.
    """


@mission.command("list")
def list_missions() -> None:
    """List the missions that come with jezero."""
    from jezero.mission_files import shipped_file, shipped_names

    for name in shipped_names():
        path = shipped_file(name)
        click.echo(f"{name:<16}{path.read_text(encoding='utf-8').partition(chr(10))[0].removeprefix('# ')}")
        click.echo(f"{'':<16}{path}")


@mission.command("check", epilog=MISSION_HELP)
@click.argument("file", shell_complete=completion.missions)
@origin_option("Degrees of the world's origin without a stack, for areas in degrees [the simulator's].")
@WIND
@common_options
def check_mission(
    file: str, origin: Origin | None, wind: Wind | None, vehicle: str, router: str, as_json: bool
) -> None:
    """Name the mistakes of a mission, and plan its steps without flying them.

    Each step is planned from where the step before ends, in the state in which it leaves the vehicle: by the stack, or
    without one in this process, for a full battery. A step in which the battery would end the mission is named.
    """
    from jezero.client import TimedOut, Unreachable, Vehicle

    printer = Printer(as_json)
    with ExitStack() as ends:
        try:
            uav: Vehicle | None = ends.enter_context(
                Vehicle.connect(vehicle, router=router, insecure=True, timeout_s=ROUTER_WAIT_S)
            )
            found = None if uav is None else vehicle_origin(uav.status().odometry)
        except (Unreachable, TimedOut):
            uav, found = None, None
        found = found or origin or simulator_origin()
        read = read_mission_file(file, found.origin_deg, printer)
        mistakes, _ = _show_plan(printer, read, uav, found.origin_deg, wind)
    if mistakes:
        printer.fail("mistakes", f"{mistakes} of the steps would fail", FAILED, number=mistakes)


@mission.command(epilog=MISSION_HELP)
@click.argument("file", shell_complete=completion.missions)
@WIND
@flight_options
def run(file: str, wind: Wind | None, yes: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Fly a mission, and show its progress. Ctrl+C ends this command only.

    The plan is shown as by `jezero mission check`. A mission with a step that would fail is not sent, and one of more
    than a minute must be confirmed; with --yes both are sent.
    """
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        read = read_mission_file(file, _origin_deg(uav), printer)
        mistakes, duration_s = _show_plan(printer, read, uav, _origin_deg(uav) or (), wind)
        if mistakes and not yes:
            reason = f"not sent: {mistakes} of the steps would fail; --yes sends it all the same"
            printer.fail("mistakes", reason, FAILED, number=mistakes)
        if duration_s > LONG_FLIGHT_S and not yes:
            confirm(printer)
        mission_id = uav.mission.run(read.mission)
        count = len(read.mission.steps)
        printer.event("accepted", f"{read.mission.name}: accepted, {count} steps", mission_id=mission_id, steps=count)
        _follow(printer, uav, mission_id)


def _show_plan(
    printer: Printer, file: "MissionFile", uav: "Vehicle | None", origin_deg: Sequence[float], wind: Wind | None
) -> tuple[int, float]:
    """Print the plan of a mission, and judge it.

    Args:
        uav: the vehicle; None plans in this process, for a vehicle that stands on the world's origin.
        wind: mean wind; None takes what the vehicle measures, and calm air without a stack or on the ground.

    Returns:
        The number of steps that would fail, and the duration in s of the whole mission, as far as it is known.
    """
    from jezero.base.plugins import all_actions
    from jezero.mission_files import plan_mission

    start = _plan_start(uav, wind)
    plans = list(plan_mission(file.mission, all_actions(), _planner(uav, origin_deg), start))
    lines = [_step_in_words(file, index, plan) for index, plan in enumerate(plans)]
    without = "" if uav is not None else "no stack runs: planned for a full battery, and a rover where it starts"
    text = "\n".join(filter(None, [f"{file.mission.name}: {len(lines)} steps", *lines, _sum_in_words(plans), without]))
    printer.event("mission", text, name=file.mission.name, steps=_plan_as_dicts(file, plans))
    return sum(plan.mistake for plan in plans), sum(plan.duration_s or 0.0 for plan in plans)


def _origin_deg(uav: "Vehicle") -> Sequence[float] | None:
    """Latitude, longitude and altitude of the vehicle's world origin; None while it is unknown."""
    odometry = uav.status().odometry
    return None if odometry is None else odometry.origin_deg


def _plan_start(uav: "Vehicle | None", wind: Wind | None) -> "Start":
    """The vehicle as it is, or one that stands on the origin with a full battery."""
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.mission_files.planning import Start
    from jezero.services.mission.config import MissionConfig

    way_margin = load_config(MissionConfig, "mission").way_margin
    start = Start(vehicle=load_config(VehicleConfig, "vehicle"), way_margin=way_margin)
    if uav is not None:
        status = uav.status()
        battery = status.battery
        start = replace(
            start,
            pos_ned_m=start.pos_ned_m if status.odometry is None else status.odometry.pos_uav_ned_m,
            flies=status.armed and not status.landed,
            charge=1.0 if battery is None or battery.remaining is None else battery.remaining,
            wind_ned_mps=status.wind_ned_mps or start.wind_ned_mps,
        )
    if wind is None:
        return start
    speed_mps, from_rad = wind[0], radians(wind[1])
    blows_ned_mps = (-speed_mps * cos(from_rad), -speed_mps * sin(from_rad), 0.0)
    return replace(start, wind_ned_mps=blows_ned_mps)


def _planner(uav: "Vehicle | None", origin_deg: Sequence[float]) -> "Plan":
    """Plans a goal by the stack; by one in this process where there is none, or where it does not see the rover yet."""
    from jezero.client import Refused, TimedOut, Unreachable
    from jezero.schemas.actions import PlanReply
    from jezero.schemas.struct import TEXT_MAX

    virtual: list[Plan] = []

    def plan_here(action: "Action[Any]", goal: "Goal") -> "PlanReply":
        if not virtual:
            from jezero.trials.planning import VirtualPlanner

            virtual.append(VirtualPlanner(origin_deg).plan)
        return virtual[0](action, goal)

    def plan(action: "Action[Any]", goal: "Goal") -> "PlanReply":
        if uav is None:
            return plan_here(action, goal)
        try:
            reply = _plan_by(uav, action, goal)
        except Refused as error:
            reply = PlanReply(accepted=False, reason=error.reason, input_missing=error.input_missing)
        except (Unreachable, TimedOut) as error:  # one server is silent
            reply = PlanReply(accepted=False, reason=str(error)[:TEXT_MAX], input_missing=True)
        unknown = reply.input_missing or (reply.accepted and reply.duration_s is None)
        if unknown and (found := plan_here(action, goal)).accepted:
            return found
        return reply

    return plan


def _plan_by(uav: "Vehicle", action: "Action[Any]", goal: "Goal") -> "PlanReply":
    """Plan by the stack; while its server plans for somebody else, ask again.

    Raises:
        Refused: the goal would be refused.
    """
    from jezero.client import Refused

    for _ in range(BUSY_TRIES):
        try:
            return uav.plan(action, goal)
        except Refused as error:
            if "is being planned" not in error.reason:
                raise
            time.sleep(BUSY_S)
    return uav.plan(action, goal)


def _step_in_words(file: "MissionFile", index: int, plan: "StepPlan") -> str:
    step = file.mission.steps[index]
    begin = f"{index + 1:>4}  line {file.lines[index]:<4} {step.label:<30}"
    flight = _flight_in_words(plan)
    if not plan.problem:
        return f"{begin} {flight}".rstrip()
    return f"{begin} {'WRONG' if plan.mistake else 'not planned'}: {plan.problem}" + (f" ({flight})" if flight else "")


def _flight_in_words(plan: "StepPlan") -> str:
    """Duration, length, battery and images of a step, as far as they are known."""
    reply = plan.reply
    if reply is not None and not reply.accepted:
        return ""
    parts = ["duration unknown" if plan.duration_s is None else minutes(plan.duration_s)]
    if reply is not None and reply.distance_m is not None:
        parts.append(f"{reply.distance_m:.0f} m")
    if plan.charge_used is not None:
        parts.append(f"{100.0 * plan.charge_used:.1f} % of the battery, {100.0 * plan.charge_left:.0f} % left")
    if reply is not None and reply.coverage is not None:
        parts.append(f"{len(reply.coverage.pictures_ned_m)} images")
    return ", ".join(parts)


def _sum_in_words(plans: Sequence["StepPlan"]) -> str:
    known = [plan for plan in plans if plan.duration_s is not None]
    if not known:
        return "no step is planned"
    complete = "" if len(known) == len(plans) else ", without the steps of unknown duration"
    duration_s = sum(plan.duration_s or 0.0 for plan in known)
    length_m = sum((plan.reply.distance_m or 0.0) for plan in known if plan.reply is not None)
    used = sum(plan.charge_used or 0.0 for plan in known)
    return f"in all{complete}: {minutes(duration_s)}, {length_m:.0f} m, {100.0 * used:.0f} % of the battery"


def _plan_as_dicts(file: "MissionFile", plans: Sequence["StepPlan"]) -> list[dict[str, Any]]:
    """The steps for programs."""
    rows = []
    for line, step, plan in zip(file.lines, file.mission.steps, plans, strict=True):
        planned = {
            "problem": plan.problem,
            "mistake": plan.mistake,
            "charge_used": plan.charge_used,
            "charge_left": plan.charge_left,
            "plan": msgspec.to_builtins(plan.reply),
        }
        rows.append({"line": line, **msgspec.to_builtins(step), **planned})
    return rows


def _follow(printer: Printer, uav: "Vehicle", mission_id: str) -> None:
    """Show the progress of a mission until its end, or until the vehicle is not heard any more."""
    from jezero.client import Unreachable

    try:
        for progress in _changes(uav, mission_id):
            _show_progress(printer, progress)
            if progress.state in ("interrupted", "paused"):
                printer.event("waiting", WAITS, mission_id=mission_id)
            last = progress
    except KeyboardInterrupt:
        printer.event("interrupted", GOES_ON, mission_id=mission_id)
        return
    except Unreachable as error:
        raise Unreachable(f"{error}\nwhere only the link to the vehicle is lost, {GOES_ON}") from None
    if last.state != "succeeded":
        raise SystemExit(ABORTED)
    if last.left_out:
        raise SystemExit(INCOMPLETE)


def _changes(uav: "Vehicle", mission_id: str) -> Iterator["MissionProgress"]:
    """Each progress that says something new; the last one is the mission's end."""
    shown = None
    for progress in uav.mission.watch():
        news = (progress.state, progress.reason, progress.step, progress.attempt)
        if progress.mission_id != mission_id or news == shown:
            continue
        shown = news
        yield progress
        if progress.state in ("succeeded", "failed", "stopped"):
            return


@mission.command()
@common_options
def status(vehicle: str, router: str, as_json: bool) -> None:
    """Show the mission that is flown, or the last one."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        _show_progress(printer, uav.mission.progress())


def _show_progress(printer: Printer, progress: "MissionProgress") -> None:
    colour = COLOURS.get(progress.state)
    if progress.left_out and colour == "green":
        colour = "yellow"
    printer.event("progress", click.style(progress_in_words(progress), fg=colour), **msgspec.to_builtins(progress))


def progress_in_words(progress: "MissionProgress") -> str:
    """The progress of a mission in one line."""
    if progress.state == "idle":
        return "no mission has been flown"
    step = f"step {progress.step} of {progress.steps}, {progress.label}"
    reason = f": {progress.reason}" if progress.reason else ""
    attempt = f", try {progress.attempt}" if progress.attempt > 1 else ""
    match progress.state:
        case "running":
            return f"{progress.name}: {step}{attempt}{reason}"
        case "succeeded":
            steps = (
                f"{progress.left_out} of {progress.steps} steps left out"
                if progress.left_out
                else f"{progress.steps} steps"
            )
            return f"{progress.name}: succeeded, {steps}"
        case "interrupted":
            return f"{progress.name}: interrupted at {step}{reason}. jezero mission resume, swapped, skip or stop"
        case "failed":
            return f"{progress.name}: failed at {step}{reason}. jezero mission resume tries the step again"
    return f"{progress.name}: {progress.state} at {step}{reason}"


@mission.command("import")
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


@mission.command("export")
@click.argument("file", shell_complete=completion.missions)
@click.option("-o", "--out", type=OUT, required=True, metavar="FILE", help=f"The file to write: {EXPORTED}.")
@origin_option("Degrees of the world's origin [that of the running stack, else the simulator's].")
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
    origin_deg = _export_origin_deg(origin, vehicle, router)
    known_deg = origin_deg if origin is None else origin.position_deg
    read = read_mission_file(file, known_deg, printer)
    data, notes = _exported(read.mission, origin_deg, ending, printer)
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


def _export_origin_deg(origin: Origin | None, vehicle: str, router: str) -> tuple[float, ...]:
    """Latitude, longitude and altitude of the world's origin."""
    from jezero.client import TimedOut, Unreachable, Vehicle

    if origin is not None:
        return (*origin.position_deg, 0.0)
    found = None
    with (
        suppress(Unreachable, TimedOut),
        Vehicle.connect(vehicle, router=router, insecure=True, timeout_s=ROUTER_WAIT_S) as uav,
    ):
        found = vehicle_origin(uav.status().odometry)
    return (found or simulator_origin()).origin_deg


def _refuse_existing(files: Iterable[Path], force: bool, printer: Printer) -> None:
    existing = [str(file) for file in files if file.exists()]
    if existing and not force:
        printer.fail("mistakes", f"{' and '.join(existing)} exists: choose another name, or add --force", FAILED)


def _write(out: Path, data: bytes, printer: Printer) -> None:
    try:
        out.write_bytes(data)
    except OSError as error:
        printer.fail("mistakes", f"{out} can't be written: {error.strerror or error}", FAILED)


def _add_command(name: str, summary: str, done: str) -> None:
    """Add a command that sends one request to the mission service.

    Args:
        name: of the command, and of the method of `Missions`.
        done: what is printed once the request is carried out.
    """

    @mission.command(name=name, help=summary)
    @common_options
    def command(vehicle: str, router: str, as_json: bool) -> None:
        printer = Printer(as_json)
        with connected(vehicle, router, printer) as uav:
            getattr(uav.mission, name)()
            printer.event("result", done, outcome="succeeded")


_add_command(
    "pause", "Hold the present step; the vehicle hovers until `resume`.", "paused; jezero mission resume goes on"
)

_add_command("resume", "Go on with a paused or interrupted mission.", GOES_ON)

_add_command("swapped", "Go on with an interrupted mission, after a change of the battery.", GOES_ON)

_add_command("skip", "Leave the present step out, and go on with the next one.", GOES_ON)

_add_command("stop", "End the mission; the vehicle hovers.", "stopped: the vehicle hovers")
