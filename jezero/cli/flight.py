"""Commands that fly the vehicle: each parses its arguments, calls the client and prints the outcome."""

import sys
from math import radians
from typing import TYPE_CHECKING, cast

import click

from jezero.cli.override import override_option
from jezero.cli.plan import send_goal
from jezero.cli.shared import (
    FINITE,
    FRAMES,
    NUMBERS,
    Printer,
    common_options,
    connected,
    flight_options,
    fly_goal,
    point_in_words,
)

if TYPE_CHECKING:
    from jezero.schemas.goals import Frame
    from jezero.schemas.preflight import Override


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
