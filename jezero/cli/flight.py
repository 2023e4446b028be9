"""The commands of the section "Flight": each parses its arguments, calls the client and prints the outcome."""

import json
import shutil
import sys
import textwrap
import time
from contextlib import suppress
from math import atan2, degrees, hypot, inf, radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import click
import msgspec

from jezero.base.files import naming
from jezero.base.mistakes import mistake, own_fields, unknown
from jezero.cli import completion
from jezero.cli.goals import fly_goal, point_in_words, send_goal
from jezero.cli.options import (
    FINITE,
    FRAMES,
    NUMBERS,
    CommandGroup,
    FiniteRange,
    PngFile,
    common_options,
    flight_options,
    world_option,
)
from jezero.cli.terminal import REFUSED, Printer, connected

if TYPE_CHECKING:
    from jezero.base.frames import Vec3
    from jezero.client import Vehicle
    from jezero.client.rover import Leg
    from jezero.client.velocity import VelocityGoal
    from jezero.schemas.goals import Frame
    from jezero.schemas.preflight import Override, PreflightReport
    from jezero.schemas.rows import Action

COLORS = {"passed": "green", "warning": "yellow", "failed": "red"}
INDENT = 20
"""Colours of the preflight's verdicts, and the column of its texts."""


@click.command()
@common_options
def preflight(vehicle: str, router: str, as_json: bool) -> None:
    """Check what a pilot checks before a takeoff: services, sensors, position, compasses, battery, fence, storage.

    It takes a second and a half. The exit code is 3 when a check has failed, for which a takeoff is refused.
    """
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        report = uav.preflight()
    if as_json:
        click.echo(msgspec.json.encode(report).decode())
    else:
        _print_checks(report)
    if report.failed():
        raise SystemExit(REFUSED)


def _print_checks(report: "PreflightReport") -> None:
    width = max(min(shutil.get_terminal_size().columns, 120), 2 * INDENT)
    for check in report.checks:
        lines = textwrap.wrap(check.text, width - INDENT) or [""]
        verdict = click.style(f"{check.verdict:<9}", fg=COLORS[check.verdict], bold=check.verdict != "passed")
        click.echo(f"{check.name:<11}{verdict}{lines[0]}")
        for line in lines[1:]:
            click.echo(" " * INDENT + line)
    from jezero.schemas.preflight import Override

    failed, warned = ([c.name for c in report.checks if c.verdict == verdict] for verdict in ("failed", "warning"))
    warnings = f"; warnings: {', '.join(warned)}" if warned else ""
    if not failed:
        click.echo(f"ready for a takeoff{warnings}")
        return
    click.echo(f"a takeoff would be refused: {', '.join(failed)}{warnings}")
    if set(failed) <= set(get_args(Override)):
        click.echo("to take off all the same: jezero takeoff " + " ".join(f"--override {name}" for name in failed))


class OverrideName(click.ParamType[str]):
    """The name of a preflight check that a takeoff may override."""

    name = "name"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from jezero.schemas.preflight import Override

        if value not in (names := get_args(Override)):
            self.fail(f"{value!r} is no check that can be overridden; these are: {', '.join(names)}", param, ctx)
        return str(value)


override_option = click.option(
    "--override",
    multiple=True,
    type=OverrideName(),
    help="Take off although this preflight check has failed; may be given several times.",
)


@click.command(context_settings=NUMBERS)
@click.argument("altitude_m", metavar="[ALTITUDE]", type=FINITE, default=2.0)
@override_option
@flight_options
def takeoff(
    altitude_m: float, override: tuple["Override", ...], yes: bool, vehicle: str, router: str, as_json: bool
) -> None:
    """Take off to ALTITUDE metres above the take-off point (2 by default; positive is up)."""
    from jezero.schemas.goals import TakeoffGoal
    from jezero.schemas.topics import TAKEOFF

    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        goal = send_goal(printer, uav, TAKEOFF, TakeoffGoal(altitude_m=altitude_m, override=override), yes=yes)
        fly_goal(printer, goal, "takeoff")


@click.command(context_settings=NUMBERS)
@click.argument("x", type=FINITE)
@click.argument("y", type=FINITE)
@click.argument("z", type=FINITE)
@click.argument("frame", type=FRAMES, default="world")
@click.argument("do_takeoff", metavar="[TAKEOFF]", type=bool, default=False)
@click.option("--speed", "speed_mps", type=FINITE, help="Metres per second along the path.")
@click.option("--yaw", "yaw_deg", type=FINITE, help="Heading in degrees: 0 is north, 90 is east.")
@override_option
@flight_options
def target(
    x: float,
    y: float,
    z: float,
    frame: str,
    do_takeoff: bool,
    speed_mps: float | None,
    yaw_deg: float | None,
    override: tuple["Override", ...],
    yes: bool,
    vehicle: str,
    router: str,
    as_json: bool,
) -> None:
    """Fly to X Y Z: metres north, east and down, so 4 m up is `-4`.

    FRAME is world (default) or rover; TAKEOFF true takes off first: `jezero target 0 0 -4 world true`.
    """
    from jezero.base.frames import wrap_pi
    from jezero.schemas.goals import GoToGoal
    from jezero.schemas.topics import GO_TO

    printer = Printer(as_json)
    goal = GoToGoal(
        target_ned_m=(x, y, z),
        frame=cast("Frame", frame),
        do_takeoff=do_takeoff,
        yaw_rad=None if yaw_deg is None else wrap_pi(radians(yaw_deg)),
        speed_mps=speed_mps,
        override=override,
    )
    with connected(vehicle, router, printer) as uav:
        fly_goal(printer, send_goal(printer, uav, GO_TO, goal, yes=yes), "target")


@click.command(context_settings=NUMBERS)
@click.argument("forward_mps", metavar="FORWARD", type=FiniteRange(-50.0, 50.0))
@click.argument("right_mps", metavar="[RIGHT]", type=FiniteRange(-50.0, 50.0), default=0.0)
@click.argument("up_mps", metavar="[UP]", type=FiniteRange(-50.0, 50.0), default=0.0)
@click.argument("yaw_rate_rps", metavar="[YAW_RATE]", type=FiniteRange(-10.0, 10.0), default=0.0)
@click.option("--for", "for_s", type=FiniteRange(0.0), metavar="S", help="Seconds to fly [default: until Ctrl+C].")
@common_options
def velocity(
    forward_mps: float,
    right_mps: float,
    up_mps: float,
    yaw_rate_rps: float,
    for_s: float | None,
    vehicle: str,
    router: str,
    as_json: bool,
) -> None:
    """Fly at FORWARD m/s along the heading, RIGHT m/s to its right and UP m/s, turning at YAW_RATE rad/s.

    Positive rates turn clockwise as seen from above. At the end the vehicle hovers. It stops in front of the fence and
    above the ground, and keeps within the speeds of its settings.
    """
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        _fly_velocity(printer, uav, (forward_mps, right_mps, up_mps, yaw_rate_rps), inf if for_s is None else for_s)


def _fly_velocity(printer: Printer, uav: "Vehicle", command: tuple[float, float, float, float], for_s: float) -> None:
    """Fly by one velocity command until the time is over, or until Ctrl+C, and print what limits it."""
    with uav.fly_velocity() as stick:
        printer.event(
            "accepted", f"velocity: accepted (goal {stick.goal_id}); Ctrl+C stops", goal_id=stick.goal_id, warning=""
        )
        with suppress(KeyboardInterrupt):
            _repeat(printer, stick, command, for_s)
    printer.event("result", "velocity: the vehicle hovers", outcome="succeeded", goal_id=stick.goal_id)


def _repeat(printer: Printer, stick: "VelocityGoal", command: tuple[float, float, float, float], for_s: float) -> None:
    limited_by, begin_s = "", time.monotonic()
    while (left_s := for_s - (time.monotonic() - begin_s)) > 0.0:
        stick.send(*command, for_s=min(left_s, 0.2))
        newest_by = limited_by if stick.newest is None else stick.newest.limited_by
        if newest_by not in ("", limited_by):
            printer.warn(f"limited by {newest_by}")
        limited_by = newest_by


@click.command(name="land_on_spot", context_settings=NUMBERS)
@click.argument("use_uwb", metavar="[USE_UWB]", type=bool, default=True)
@click.argument("use_tag", metavar="[USE_TAG]", type=bool, default=True)
@click.option(
    "--spot",
    nargs=3,
    type=FINITE,
    metavar="X Y Z",
    help="Rover's position, or the spot: metres north, east, down.",
)
@click.option("--frame", type=FRAMES, default="world", show_default=True, help="Frame of the spot.")
@click.option("--force", is_flag=True, help="Land in more wind than the settings allow, too.")
@flight_options
def land_on_spot(
    use_uwb: bool,
    use_tag: bool,
    spot: tuple[float, float, float] | None,
    frame: str,
    yes: bool,
    force: bool,
    vehicle: str,
    router: str,
    as_json: bool,
) -> None:
    """Land on the rover. USE_UWB and USE_TAG (both true by default) choose the sensors that find it.

    Without UWB the command needs the rover's approximate position, from --spot or a prompt. Without UWB and
    tags this is the spot on the ground on which the vehicle lands.
    """
    from jezero.schemas.goals import LandOnSpotGoal
    from jezero.schemas.topics import LAND_ON_SPOT

    printer = Printer(as_json)
    if not use_uwb and spot is None:
        spot = _prompt_for_spot(use_tag)
    if not use_uwb and spot is not None and not as_json:
        what = "Rover position" if use_tag else "Landing spot"
        click.echo(f"{what}: [{spot[0]:g}, {spot[1]:g}, {spot[2]:g}]")
    goal = LandOnSpotGoal(
        landing_spot_ned_m=spot, frame=cast("Frame", frame), use_uwb=use_uwb, use_tag=use_tag, force=force
    )
    with connected(vehicle, router, printer) as uav:
        fly_goal(printer, send_goal(printer, uav, LAND_ON_SPOT, goal, yes=yes), "land_on_spot")


def _prompt_for_spot(use_tag: bool) -> tuple[float, float, float]:
    """Ask for the spot as in the thesis' Fig. 4.9; scripts give it with --spot."""
    if not sys.stdin.isatty():
        raise click.UsageError("without UWB the landing spot must be given: --spot X Y Z")
    click.echo("Not using UWB")
    what = "rover position" if use_tag else "landing spot"
    spot = (
        click.prompt(f"Enter {what} x ", type=FINITE),
        click.prompt(f"Enter {what} y ", type=FINITE),
        click.prompt(f"Enter {what} z ", type=FINITE, default=0.0),
    )
    click.echo("Using apriltag" if use_tag else "Not using apriltag")
    return spot


@click.command(name="return")
@click.option("--height", "safe_height_m", type=FINITE, help="Height of the way above the origin in metres.")
@click.option("--speed", "speed_mps", type=FINITE, help="Speed on the way in m/s.")
@flight_options
def return_home(
    safe_height_m: float | None, speed_mps: float | None, yes: bool, vehicle: str, router: str, as_json: bool
) -> None:
    """Fly home and land: on the rover if it is known, else where the vehicle took off, else at a rally point."""
    from jezero.schemas.goals import ReturnHomeGoal
    from jezero.schemas.topics import RETURN_HOME

    printer = Printer(as_json)
    goal = ReturnHomeGoal(safe_height_m=safe_height_m, speed_mps=speed_mps)
    with connected(vehicle, router, printer) as uav:
        fly_goal(printer, send_goal(printer, uav, RETURN_HOME, goal, yes=yes), "return")


@click.command(context_settings=NUMBERS)
@click.argument("point", nargs=-1, type=FINITE, metavar="[X Y Z]")
@common_options
def hover(point: tuple[float, ...], vehicle: str, router: str, as_json: bool) -> None:
    """Hover here, or at X Y Z (metres north, east and down) while hovering already."""
    if len(point) not in {0, 3}:
        raise click.UsageError("give no coordinates, or all three: X Y Z")
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        uav.hover((point[0], point[1], point[2]) if point else None)
        where = f" at {point_in_words(point)}" if point else ""
        printer.event("result", f"hovering{where}", outcome="succeeded")


@click.command()
@common_options
def pause(vehicle: str, router: str, as_json: bool) -> None:
    """Pause the goal in charge: the vehicle brakes and hovers until `jezero resume`.

    The goal keeps control. `jezero hover` and `jezero abort` end it, and so does an empty battery.
    """
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        goal_id = uav.pause()
        printer.event(
            "result", f"goal {goal_id} is paused, and the vehicle hovers", outcome="succeeded", goal_id=goal_id
        )


@click.command()
@common_options
def resume(vehicle: str, router: str, as_json: bool) -> None:
    """Go on with the paused goal in charge."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        goal_id = uav.resume()
        printer.event("result", f"goal {goal_id} goes on", outcome="succeeded", goal_id=goal_id)


@click.command(context_settings=NUMBERS)
@click.argument("words", nargs=-1, required=True, metavar="KEY=VALUE...")
@common_options
def modify(words: tuple[str, ...], vehicle: str, router: str, as_json: bool) -> None:
    """Change fields of the goal in charge while it is flown: `jezero modify speed_mps=1.5`.

    The vehicle brakes, and goes on by the new plan. A VALUE is JSON where it parses, and text otherwise. `jezero info
    page actions` lists the fields that may change.
    """
    fields = key_values(words)
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        goal_id, warning = uav.modify(**fields)
        printer.event("result", f"modified goal {goal_id}", outcome="succeeded", goal_id=goal_id, warning=warning)
        printer.warn(warning)


def key_values(words: tuple[str, ...]) -> dict[str, Any]:
    """Values by key, of `key=value` words; a value that is no JSON is a text.

    Raises:
        click.UsageError: a word has no `=`, or a key is given twice.
    """
    fields: dict[str, Any] = {}
    for word in words:
        key, separator, value = word.partition("=")
        if not separator or not key:
            raise click.UsageError(f"{word!r} is not KEY=VALUE, such as speed_mps=1.5")
        if key in fields:
            raise click.UsageError(f"{key} is given twice")
        try:
            fields[key] = json.loads(value)
        except ValueError:
            fields[key] = value
    return fields


@click.command()
@common_options
def abort(vehicle: str, router: str, as_json: bool) -> None:
    """End the goal in charge at once: hover, or disarm if still on the ground."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        reply = uav.abort("abort from the command line")
        text = reply.reason or ("aborted: hovering" if reply.hovering else "aborted: on the ground")
        printer.event("result", text, outcome="succeeded", hovering=reply.hovering, reason=reply.reason)


@click.command()
@click.argument("name", default="")
@click.option("--yes", is_flag=True, help="Confirm to stop the motors.")
@common_options
def kill(name: str, yes: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Stop the motors at once. A flying vehicle falls.

    In the air the vehicle's NAME is the second confirmation: `jezero kill --yes uav1`.
    """
    if not yes:
        raise click.UsageError(
            "this stops the motors: add --yes to confirm, and in the air the vehicle's name too, such as `jezero kill "
            f"--yes {vehicle}` (`jezero abort` makes the vehicle hover)"
        )
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        uav.kill(confirm=True, vehicle=name)
        printer.event("result", "killed: motors off", outcome="succeeded")


@click.group(cls=CommandGroup)
def action() -> None:
    """List all actions, or send a goal to any of them."""


@action.command("list")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def list_actions(as_json: bool) -> None:
    """Show every action with the fields of its goal; a field without a default must be given."""
    from jezero.base.plugins import PluginError, action_names, find_action, refused_plugins
    from jezero.schemas.topics import ACTIONS

    for name in dict.fromkeys((*action_names(), *refused_plugins())):
        try:
            found = find_action(name)
        except PluginError as error:
            click.echo(json.dumps({"action": name, "problem": str(error)}) if as_json else f"{name}\n  {error}")
            continue
        origin = "jezero" if name in ACTIONS else "package"
        if as_json:
            click.echo(json.dumps({"action": name, "from": origin, "goal": _described_fields(found)}))
            continue
        click.secho(name if origin == "jezero" else f"{name} (from a package)", bold=True)
        for field, default in _described_fields(found).items():
            click.echo(f"  {field}" if default is None else f"  {field}={default}")


@action.command(context_settings=NUMBERS)
@click.argument("name", shell_complete=completion.actions)
@click.argument("fields", nargs=-1, metavar="[KEY=VALUE]...", shell_complete=completion.goal_fields)
@flight_options
def send(name: str, fields: tuple[str, ...], yes: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Send a goal to the action NAME and follow it to its end.

    A VALUE is JSON where it parses, and text otherwise: `jezero action send go_to target_ned_m=[0,0,-4]`.
    """
    from jezero.base.plugins import find_action

    printer = Printer(as_json)
    given = _goal_fields(name, fields)
    found = find_action(name)
    try:
        goal = msgspec.convert(given, found.goal_type)
    except msgspec.ValidationError as error:
        raise click.UsageError(f"{name}: {mistake(error, found.goal_type)}") from None
    with connected(vehicle, router, printer) as uav:
        fly_goal(printer, send_goal(printer, uav, found, goal, yes=yes), name)


def _goal_fields(name: str, words: tuple[str, ...]) -> dict[str, Any]:
    """The fields of a goal from `key=value` words.

    Raises:
        click.UsageError: a word has no `=`, a field is unknown or given twice, or there is no such action.
    """
    from jezero.base.plugins import PluginError, find_action

    try:
        found = find_action(name)
    except PluginError as error:
        raise click.UsageError(str(error)) from None
    fields = key_values(words)
    for key in fields:
        if key not in _described_fields(found):
            raise click.UsageError(f"{name}: {unknown('field', key, own_fields(found.goal_type))}")
    return fields


def _described_fields(found: "Action[Any]") -> dict[str, str | None]:
    """Fields of an action's goal, each with its default as JSON; None for a field that must be given."""
    from jezero.schemas.goals import Goal

    common = Goal.__struct_fields__  # which the client fills in
    fields = {field.name: field for field in msgspec.structs.fields(found.goal_type)}
    own = [*(name for name in fields if name not in common), "on_client_loss"]
    return {name: None if fields[name].required else msgspec.json.encode(fields[name].default).decode() for name in own}


@click.command()
@click.option("--watch", is_flag=True, help="Print each change until Ctrl+C.")
@common_options
def status(watch: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Show what the vehicle does, where it is, and why it is not ready."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        if not watch:
            _print_status(printer, uav.status())
            return
        last = None
        try:
            for latest in uav.watch_status():
                shown = (
                    latest.code,
                    latest.armed,
                    latest.landed,
                    latest.autopilot_mode,
                    latest.in_charge,
                    latest.ready,
                    latest.text,
                )
                if as_json or shown != last:
                    _print_status(printer, latest)
                last = shown
        except KeyboardInterrupt:
            return


def _print_status(printer: Printer, latest: Any) -> None:
    if printer.as_json:
        click.echo(msgspec.json.encode(latest).decode())
        return
    rows = [
        ("status", f"{latest.code} {latest.name}{', paused' if latest.paused else ''}"),
        ("in charge", latest.in_charge + (f" (goal {latest.goal_id})" if latest.goal_id else "")),
        ("autopilot", f"{latest.autopilot_mode or 'no link'}, {'armed' if latest.armed else 'disarmed'}"),
        ("vehicle", "on the ground" if latest.landed else "in the air"),
        ("ready", "yes" if latest.ready else f"no: {latest.not_ready_reason}"),
    ]
    if latest.odometry is not None:
        rows.append(("position", f"{point_in_words(latest.odometry.pos_uav_ned_m)} m, NED"))
        if latest.odometry.origin_deg is not None:
            rows.append(("origin", "latitude {:.7f}, longitude {:.7f}, {:.1f} m".format(*latest.odometry.origin_deg)))
        rows.append(("velocity", f"{point_in_words(latest.odometry.vel_uav_ned_mps)} m/s"))
    if latest.wind_ned_mps is not None:
        rows.append(("wind", wind_text(latest.wind_ned_mps, latest.std_gust_mps)))
    if latest.battery is not None and latest.battery.remaining is not None:
        rows.append(("battery", f"{100.0 * latest.battery.remaining:.0f} %"))
    if latest.text:
        rows.append(("last event", latest.text))
    for name, value in rows:
        click.echo(f"{name:<11}{value}")


def wind_text(wind_ned_mps: "Vec3", std_gust_mps: float | None) -> str:
    north_mps, east_mps, _ = wind_ned_mps
    from_deg = round(degrees(atan2(-east_mps, -north_mps))) % 360
    gusts = "" if std_gust_mps is None else f", gusts of {std_gust_mps:.1f} m/s (standard deviation)"
    return f"{hypot(north_mps, east_mps):.1f} m/s from {from_deg} degrees{gusts}"


@click.group(cls=CommandGroup)
def rover() -> None:
    """Drive the rover.

    `jezero rover drive 0.5` drives at 0.5 m/s until Ctrl+C, `jezero rover drive 1 0.2 --for 30` in a circle for half
    a minute. The rover stops when the command ends or is killed.
    """


@rover.command(context_settings=NUMBERS)
@click.argument("speed_mps", metavar="SPEED", type=FINITE)
@click.argument("yaw_rate_rps", metavar="[YAW_RATE]", type=FINITE, default=0.0)
@click.option("--for", "for_s", type=FINITE, metavar="S", help="Seconds to drive [default: until Ctrl+C].")
@common_options
def drive(speed_mps: float, yaw_rate_rps: float, for_s: float | None, vehicle: str, router: str, as_json: bool) -> None:
    """Drive at SPEED m/s (negative is backwards), turning at YAW_RATE rad/s (positive is clockwise from above)."""
    from jezero.client.rover import Leg, leg_refusal

    if refusal := leg_refusal(Leg(inf if for_s is None else for_s, speed_mps, yaw_rate_rps)):
        raise click.UsageError(refusal)
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        with suppress(KeyboardInterrupt):
            printer.event(
                "driving",
                f"driving at {speed_mps:g} m/s and {yaw_rate_rps:g} rad/s" + ("" if for_s else "; Ctrl+C stops"),
                speed_mps=speed_mps,
                yaw_rate_rps=yaw_rate_rps,
            )
            uav.rover.drive(speed_mps, yaw_rate_rps, for_s=for_s)
        printer.event("result", "the rover stands", outcome="succeeded")


@rover.command()
@common_options
def stop(vehicle: str, router: str, as_json: bool) -> None:
    """Stop the rover. Another client that still drives it starts it again."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        uav.rover.stop()
        printer.event("result", "the rover stands", outcome="succeeded")


@rover.command()
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@common_options
def follow(file: Path, vehicle: str, router: str, as_json: bool) -> None:
    """Drive the legs of a CSV FILE, one after the other, then stop.

    The first line of the file is `duration_s,speed_mps,yaw_rate_rps`.
    """
    from jezero.client.rover import read_legs

    try:
        legs = read_legs(file)
    except (ValueError, OSError) as error:
        raise click.UsageError(str(error)) from error
    printer = Printer(as_json)

    def on_leg(number: int, leg: "Leg") -> None:
        text = f"{number} of {len(legs)}: {leg.duration_s:g} s at {leg.speed_mps:g} m/s and {leg.yaw_rate_rps:g} rad/s"
        printer.event("leg", text, number=number, **leg._asdict())

    with connected(vehicle, router, printer) as uav:
        uav.rover.follow(legs, on_leg)
        printer.event("result", "the rover stands", outcome="succeeded")


@click.group(cls=CommandGroup)
def camera() -> None:
    """Save images of the vehicle's camera, or of the simulated ground from above; calibrate a real camera."""


@camera.command()
@click.argument("file", type=PngFile())
@click.option("--timeout", "timeout_s", type=FINITE, default=3.0, show_default=True, help="Seconds to wait.")
@common_options
def snap(file: Path, timeout_s: float, vehicle: str, router: str, as_json: bool) -> None:
    """Save the next image of the camera as FILE, a PNG.

    On another computer than the vehicle's, which its images don't reach, the next preview is saved.
    """
    from jezero.schemas.sensors import CameraPreview

    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        with naming(file):
            frame = uav.camera.snap(file, timeout_s)
        kind = ", a preview" if isinstance(frame, CameraPreview) else ""
        text = f"wrote {file}: {frame.width_px} x {frame.height_px} pixels{kind}, taken at {frame.t_ns / 1e9:.3f} s"
        printer.event("result", text, outcome="succeeded", file=str(file), t_ns=frame.t_ns)


@camera.command(context_settings=NUMBERS)
@click.argument("file", type=PngFile())
@click.option("--middle", nargs=2, type=FINITE, default=(0.0, 0.0), show_default=True, help="North, east in m.")
@click.option("--side", "side_m", type=FiniteRange(0.1, 200.0), default=20.0, show_default=True, help="In m.")
@click.option("--resolution", type=FiniteRange(0.001, 10.0), default=0.02, show_default=True, help="Metres per pixel.")
@world_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line, the result last.")
def orthophoto(file: Path, middle: tuple[float, float], side_m: float, resolution: float, as_json: bool) -> None:
    """Save the simulated ground, seen from straight above, as FILE, a PNG with north at the top.

    No running stack is needed. The vehicle starts at 0 0. Vehicle and rover are not in the image.
    """
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.client.png import png_of
    from jezero.services.simulator.camera.orthophoto import make_orthophoto
    from jezero.services.simulator.camera.service import NoEglError
    from jezero.services.simulator.config import SimulatorConfig

    if side_m / resolution > 20_000:
        raise click.UsageError(f"{side_m:g} m at {resolution:g} m per pixel are more than 20,000 pixels across")
    try:
        simulator, vehicle = load_config(SimulatorConfig, "simulator"), load_config(VehicleConfig, "vehicle")
        picture = make_orthophoto(simulator.terrain, vehicle, middle, side_m, resolution)
    except NoEglError as error:
        raise click.ClickException(f"{error}: install libegl1, libgl1 and libgl1-mesa-dri") from None
    height_px, width_px, _ = picture.shape
    with naming(file):
        file.write_bytes(png_of(width_px, height_px, picture.tobytes()))
    text = f"wrote {file}: {width_px} x {height_px} pixels of {resolution:g} m"
    Printer(as_json).event("result", text, outcome="succeeded", file=str(file), m_per_px=resolution)
