"""`jezero mission`: checks mission files, and flies them by the mission service of the vehicle."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from jezero.cli.area import Origin, checked_origin
from jezero.cli.exit_codes import ABORTED, FAILED, INCOMPLETE
from jezero.cli.mission_convert import export_mission, import_mission
from jezero.cli.mission_file import read_mission_file
from jezero.cli.shared import FINITE, Printer, common_options, connected, flight_options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jezero.client import Vehicle
    from jezero.schemas.mission import MissionProgress

FILE_HELP = "FILE is a mission in YAML or JSON, or the name of one that comes with jezero: jezero mission list."
WIND = click.option(
    "--wind", nargs=2, type=FINITE, metavar="MPS FROM_DEG",
    help="Wind to plan for, and the direction from which it blows [what the vehicle measures].",
)  # fmt: skip
COLOURS = {"succeeded": "green", "failed": "red", "interrupted": "yellow", "stopped": "yellow"}
GOES_ON = "the mission goes on; jezero mission status shows it, jezero mission stop ends it"


@click.group()
def mission() -> None:
    """Fly missions: lists of goals in a file, in YAML or JSON.

    `jezero mission check FILE` names every mistake. `jezero mission run FILE` hands the mission to the vehicle, where
    it goes on when this command or this computer is gone.
    """


@mission.command(name="list")
def list_missions() -> None:
    """List the missions that come with jezero."""
    from jezero.mission_files import shipped_file, shipped_names

    for name in shipped_names():
        path = shipped_file(name)
        click.echo(f"{name:<16}{path.read_text(encoding='utf-8').partition(chr(10))[0].removeprefix('# ')}")
        click.echo(f"{'':<16}{path}")


@mission.command(epilog=FILE_HELP)
@click.argument("file")
@click.option(
    "--origin", nargs=2, type=float, callback=checked_origin, metavar="LAT LON",
    help="Degrees of the world's origin without a stack, for areas in degrees [the simulator's].",
)  # fmt: skip
@WIND
@common_options
def check(
    file: str, origin: Origin | None, wind: tuple[float, float] | None, vehicle: str, router: str, as_json: bool
) -> None:
    """Name the mistakes of a mission, and plan its steps without flying them.

    Each step is planned from where the step before ends, in the state in which it leaves the vehicle: by the stack, or
    without one in this process, for a full battery. A step in which the battery would end the mission is named.
    """
    from jezero.cli.mission_check import check_mission

    printer = Printer(as_json)
    check_mission(printer, lambda at: read_mission_file(file, at, printer), origin, wind, vehicle, router)


@mission.command(epilog=FILE_HELP)
@click.argument("file")
@WIND
@flight_options
def run(file: str, wind: tuple[float, float] | None, yes: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Fly a mission, and show its progress. Ctrl+C ends this command only.

    The plan is shown as by `jezero mission check`. A mission with a step that would fail is not sent, and one of more
    than a minute must be confirmed; with --yes both are sent.
    """
    from jezero.cli.mission_check import show_mission
    from jezero.cli.plan import LONG_FLIGHT_S, confirm

    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        read = read_mission_file(file, _origin_deg(uav), printer)
        judged = show_mission(printer, read, uav, _origin_deg(uav) or (), wind)
        if judged.mistakes and not yes:
            reason = f"not sent: {judged.mistakes} of the steps would fail; --yes sends it all the same"
            printer.fail("mistakes", reason, FAILED, number=judged.mistakes)
        if judged.duration_s > LONG_FLIGHT_S and not yes:
            confirm(printer)
        mission_id = uav.mission.run(read.mission)
        count = len(read.mission.steps)
        printer.event("accepted", f"{read.mission.name}: accepted, {count} steps", mission_id=mission_id, steps=count)
        _follow(printer, uav, mission_id)


@mission.command()
@common_options
def status(vehicle: str, router: str, as_json: bool) -> None:
    """Show the mission that is flown, or the last one."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        _show(printer, uav.mission.progress())


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


mission.add_command(import_mission)
mission.add_command(export_mission)
_add_command(
    "pause", "Hold the present step; the vehicle hovers until `resume`.", "paused; jezero mission resume goes on"
)
_add_command("resume", "Go on with a paused or interrupted mission.", GOES_ON)
_add_command("swapped", "Go on with an interrupted mission, after a change of the battery.", GOES_ON)
_add_command("skip", "Leave the present step out, and go on with the next one.", GOES_ON)
_add_command("stop", "End the mission; the vehicle hovers.", "stopped: the vehicle hovers")


def _origin_deg(uav: "Vehicle") -> "Sequence[float] | None":
    """Latitude, longitude and altitude of the vehicle's world origin; None while it is unknown."""
    odometry = uav.status().odometry
    return None if odometry is None else odometry.origin_deg


def _follow(printer: Printer, uav: "Vehicle", mission_id: str) -> None:
    """Show the progress of a mission until its end, or until the vehicle is not heard any more."""
    from jezero.client import Unreachable

    try:
        for progress in _changes(uav, mission_id):
            _show(printer, progress)
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


def _changes(uav: "Vehicle", mission_id: str) -> "Iterator[MissionProgress]":
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


def _show(printer: Printer, progress: "MissionProgress") -> None:
    import msgspec

    colour = COLOURS.get(progress.state)
    if progress.left_out and colour == "green":
        colour = "yellow"
    printer.event("progress", click.style(in_words(progress), fg=colour), **msgspec.to_builtins(progress))


def in_words(progress: "MissionProgress") -> str:
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
