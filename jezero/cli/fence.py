"""`jezero fence`: places to stay in and out of."""

from contextlib import suppress
from typing import TYPE_CHECKING

import click

from jezero.cli.mission_file import read_fence_file
from jezero.cli.shared import Printer, common_options, connected

if TYPE_CHECKING:
    from jezero.client import Vehicle
    from jezero.schemas.fence import Fence

ROVER_TIMEOUT_S = 2.0
FILE_HELP = "FILE is a fence in YAML or JSON, or a .plan of QGroundControl with a geofence."


@click.group()
def fence() -> None:
    """Set the fence, which the vehicle doesn't leave; a goal whose planned way does is refused before it starts."""


@fence.command(epilog=FILE_HELP)
@click.argument("file")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def check(file: str, as_json: bool) -> None:
    """Name the mistakes of a fence file."""
    from jezero.fence import fence_doubts

    printer = Printer(as_json)
    read = read_fence_file(file, printer)
    warnings = fence_doubts(read)
    printer.event("fence", _in_words(read), warnings=warnings)
    for warning in warnings:
        printer.warn(warning)


@fence.command(name="set", epilog=FILE_HELP)
@click.argument("file")
@common_options
def set_(file: str, vehicle: str, router: str, as_json: bool) -> None:
    """Set the fence of a vehicle on the ground, until the vehicle's stack ends."""
    printer = Printer(as_json)
    read = read_fence_file(file, printer)
    with connected(vehicle, router, printer) as uav:
        uav.set_fence(read)
        warnings = _doubts(uav, read)
        printer.event("fence", f"in force: {_in_words(read)}", warnings=warnings)
        for warning in warnings:
            printer.warn(warning)


@fence.command()
@common_options
def clear(vehicle: str, router: str, as_json: bool) -> None:
    """Take the fence of a vehicle on the ground away."""
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        uav.set_fence(None)
        printer.event("fence", "no fence")


@fence.command()
@common_options
def show(vehicle: str, router: str, as_json: bool) -> None:
    """Show the fence in force."""
    import msgspec

    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        state = uav.fence()
        waiting = "the fence waits for the vehicle's origin" if state.fence_id else "no fence"
        text = waiting if state.fence is None else _in_words(state.fence)
        outside = f"; the vehicle is {state.outside}" if state.outside else ""
        printer.event("fence", text + outside, **msgspec.to_builtins(state))


def _doubts(uav: "Vehicle", fence: "Fence") -> tuple[str, ...]:
    """Warnings for the person who has set a fence: about its parts, and about a vehicle or a rover outside."""
    from jezero.client.errors import JezeroError
    from jezero.fence import fence_doubts, places_outside
    from jezero.frames import subtract

    held, odometry = uav.fence().fence, uav.status().odometry
    if odometry is None or held is None:
        return fence_doubts(fence)
    pos_rover_ned_m = None
    with suppress(JezeroError):  # no estimator runs, or it is silent
        relative = uav.relative(timeout_s=ROVER_TIMEOUT_S)
        if relative.valid:
            pos_rover_ned_m = subtract(odometry.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
    return (*fence_doubts(held), *places_outside(held, odometry.pos_uav_ned_m, pos_rover_ned_m))


def _in_words(fence: "Fence") -> str:
    parts = [] if fence.keep_in is None else [f"stay in {fence.keep_in.name}"]
    parts += [f"stay out of {', '.join(zone.name for zone in fence.keep_out)}"] if fence.keep_out else []
    parts += [] if fence.ceiling_m is None else [f"ceiling {fence.ceiling_m:g} m"]
    parts += [f"floor {fence.floor_over_ground_m:g} m"] if fence.floor_over_ground_m else []
    return f"{fence.name}: {', '.join(parts)}"
