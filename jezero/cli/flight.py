"""Commands that fly the vehicle: each parses its arguments, calls the client and prints the outcome."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite, radians
from typing import TYPE_CHECKING, Any, NoReturn, cast

import click

from jezero.cli.exit_codes import ABORTED, REFUSED, UNREACHABLE
from jezero.cli.override import override_option
from jezero.cli.plan import minutes, send_goal
from jezero.router_address import parse_router

if TYPE_CHECKING:
    from rich.progress import Progress

    from jezero.client import Goal, Vehicle
    from jezero.schemas.goals import Frame
    from jezero.schemas.preflight import Override

FRAMES = click.Choice(["world", "rover"])
PLAIN_PERIOD_S = 1.0


class Finite(click.ParamType[float]):
    """A number that is neither NaN nor infinite."""

    name = "float"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = click.FLOAT.convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


class Router(click.ParamType[str]):
    """The address of a router."""

    name = "address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            parse_router(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)
        return str(value)


class FiniteRange(click.FloatRange):
    """A number within limits. Its parent class takes NaN, which no comparison excludes."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        return FINITE.convert(super().convert(value, param, ctx), param, ctx)


FINITE = Finite()
NUMBERS = {"ignore_unknown_options": True}  # "-4" is a coordinate, not an option


def common_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every command that connects to a vehicle."""
    json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
    return vehicle_options(json_option(command))


def vehicle_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that name a vehicle and its router."""
    command = click.option(
        "--router",
        envvar="JEZERO_ROUTER",
        type=Router(),
        default="tcp/127.0.0.1:7447",
        show_default=True,
        help="Router's endpoint.",
    )(command)
    return click.option(
        "--vehicle", envvar="JEZERO_VEHICLE", default="uav1", show_default=True, help="Vehicle's name."
    )(command)


def flight_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every command that sends a goal."""
    command = click.option("--yes", is_flag=True, help="Fly for more than a minute without a question.")(command)
    return common_options(command)


class Printer:
    """Prints events as text with a progress bar on a terminal, as plain lines into a pipe, or as JSON lines."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self._bar: Progress | None = None
        self._printed_s = -PLAIN_PERIOD_S
        self._warned: set[str] = set()

    def event(self, kind: str, text: str, **fields: Any) -> None:
        """Print one event: `text` for people, or `fields` as JSON."""
        self._end_bar()
        click.echo(json.dumps({"type": kind, **fields}) if self.as_json else text)

    def warn(self, text: str) -> None:
        """Print a warning for people, once; programs find it in the events. "" is none."""
        if text and not self.as_json and text not in self._warned:
            self._end_bar()
            self._warned.add(text)
            click.echo(f"warning: {text}", err=True)

    def hint(self, text: str) -> None:
        """Print a line for the person at the terminal."""
        if not self.as_json and sys.stdout.isatty():
            click.secho(text, dim=True)

    def progress(self, text: str, done: float | None, **fields: Any) -> None:
        """Print feedback: a bar on a terminal, a line per second into a pipe. `done` is a fraction from 0 to 1."""
        if self.as_json:
            click.echo(json.dumps({"type": "feedback", **fields}))
        elif sys.stdout.isatty():
            self._draw(text, done)
        elif time.monotonic() - self._printed_s >= PLAIN_PERIOD_S:
            self._printed_s = time.monotonic()
            click.echo(text)

    def fail(self, kind: str, text: str, exit_code: int, **fields: Any) -> NoReturn:
        """End the command with JSON on standard output, a sentence on standard error, and an exit code."""
        self._end_bar()
        if self.as_json:
            click.echo(json.dumps({"type": kind, **fields}))
        click.echo(text, err=True)
        raise SystemExit(exit_code)

    def _draw(self, text: str, done: float | None) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        if self._bar is None:
            self._bar = Progress(BarColumn(24), TextColumn("{task.description}"), transient=True)
            self._bar.start()
            self._bar.add_task(text, total=None)
        self._bar.update(self._bar.task_ids[0], description=text, completed=done or 0.0, total=done and 1.0)

    def _end_bar(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


@contextmanager
def connected(vehicle: str, router: str, printer: Printer) -> Iterator["Vehicle"]:
    """Connect for one command; an error of the client becomes a sentence and an exit code."""
    from jezero.client import Aborted, Canceled, JezeroError, Refused, Vehicle

    try:
        with Vehicle.connect(vehicle, router=router) as uav:
            yield uav
    except Refused as error:
        printer.fail("rejected", f"refused: {error}", REFUSED, reason=str(error), code=error.code)
    except Canceled as error:
        printer.fail("result", f"canceled: {error}", ABORTED, outcome="canceled", reason=str(error))
    except Aborted as error:
        printer.fail("result", f"aborted: {error}", ABORTED, outcome="aborted", reason=str(error))
    except KeyboardInterrupt:
        printer.fail("interrupted", "interrupted", ABORTED, reason="interrupted")
    except JezeroError as error:
        printer.fail("unreachable", f"unreachable: {error}", UNREACHABLE, reason=str(error))


def fly_goal(printer: Printer, goal: "Goal[Any, Any]", name: str) -> None:
    """Follow a goal to its end. Ctrl+C cancels the goal; a second one ends the command at once."""
    import msgspec

    printer.event("accepted", f"{name}: accepted (goal {goal.goal_id})", goal_id=goal.goal_id, warning=goal.warning)
    printer.warn(goal.warning)
    try:
        _follow(printer, goal)
    except KeyboardInterrupt:
        printer.event("canceling", "canceling: the vehicle will hover where it is", goal_id=goal.goal_id)
        goal.cancel()
        _follow(printer, goal)
    result = msgspec.to_builtins(goal.result())
    position = result.get("pos_uav_ned_m") or result.get("touchdown_ned_m")
    where = f" at {point_in_words(position)}" if position else ""
    printer.event("result", f"{name}: succeeded{where}", outcome="succeeded", goal_id=goal.goal_id, result=result)


def _follow(printer: Printer, goal: "Goal[Any, Any]") -> None:
    import msgspec

    from jezero.cli.goal_keys import GoalKeys

    farthest_m = 0.0
    with GoalKeys(printer, goal) as keys:
        for feedback in goal.feedback():
            keys.poll()
            fields = msgspec.to_builtins(feedback)
            distance_m, done = fields.get("distance_m"), None
            if distance_m is not None:
                farthest_m = max(farthest_m, distance_m)
                done = 1.0 - distance_m / farthest_m if farthest_m > 0.0 else 1.0
            text = f"{'paused, ' if goal.paused else ''}{_in_words(fields)}{time_to_go(goal)}"
            more = {"remaining_s": goal.remaining_s, "paused": goal.paused}
            printer.progress(text, done, goal_id=goal.goal_id, **more, **fields)


def time_to_go(goal: "Goal[Any, Any]") -> str:
    """The end of a line of progress; "" while the time is unknown."""
    return "" if goal.remaining_s is None else f", {minutes(goal.remaining_s)} to go"


def _in_words(feedback: dict[str, Any]) -> str:
    """A line for people from the feedback of any action."""
    fields = {name: value for name, value in feedback.items() if name != "kind"}
    parts = []
    if "pos_uav_ned_m" in fields:
        parts.append(f"position {point_in_words(fields.pop('pos_uav_ned_m'))} in {fields.pop('frame', 'world')}")
    if "distance_m" in fields:
        parts.append(f"{fields.pop('distance_m'):.2f} m to go")
    if "phase" in fields:
        parts.append(str(fields.pop("phase")))
    if "place" in fields:
        why = f" ({reason})" if (reason := fields.pop("reason", "")) else ""
        parts.append(f"to the {fields.pop('place').replace('_', ' ')}{why}".replace("to the here", "landing here"))
    for name in ("pos_rel_ned_m", "cone_m", "place_ned_m", "landing"):  # for programs
        fields.pop(name, None)
    parts.extend(
        f"{name} {value:.2f}" if isinstance(value, float) else f"{name} {value}" for name, value in fields.items()
    )
    return ", ".join(parts)


def point_in_words(pos_ned_m: Any) -> str:
    return "({:.2f}, {:.2f}, {:.2f})".format(*pos_ned_m)


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
    from jezero.frames import wrap_pi
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
def abort(vehicle: str, router: str, as_json: bool) -> None:
    """End the goal in charge at once: hover, or disarm if still on the ground."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        reply = uav.abort("abort from the command line")
        text = reply.reason or ("aborted: hovering" if reply.hovering else "aborted: on the ground")
        printer.event("result", text, outcome="succeeded", hovering=reply.hovering, reason=reply.reason)


@click.command()
@click.option("--yes", is_flag=True, help="Confirm to stop the motors, also in the air.")
@common_options
def kill(yes: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Stop the motors at once. A flying vehicle falls."""
    if not yes:
        raise click.UsageError(
            "this stops the motors also in the air: add --yes to confirm (`jezero abort` makes the vehicle hover)"
        )
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        uav.kill(confirm=True)
        printer.event("result", "killed: motors off", outcome="succeeded")
