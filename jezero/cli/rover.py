"""`jezero rover`: drives the rover."""

from contextlib import suppress
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jezero.cli.shared import FINITE, NUMBERS, Printer, common_options, connected

if TYPE_CHECKING:
    from jezero.client.rover import Leg


@click.group()
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
    from jezero.client.rover import Leg, leg_problem

    if problem := leg_problem(Leg(inf if for_s is None else for_s, speed_mps, yaw_rate_rps)):
        raise click.UsageError(problem)
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
