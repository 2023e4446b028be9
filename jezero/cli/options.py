"""Types of values and options that several commands share, and the world's origin as an option."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.base.vehicle_name import checked_vehicle
from jezero.keys.bundle import INSECURE_VARIABLE, endpoint_of
from jezero.keys.bundle import VARIABLE as KEYS_VARIABLE

if TYPE_CHECKING:
    from jezero.schemas.state import Odometry

FRAMES = click.Choice(["world", "rover"])
RECORDING_PATH = click.Path(path_type=Path)
NUMBERS = {"ignore_unknown_options": True}  # "-4" is a coordinate, not an option
KEYS, INSECURE = "jezero.keys", "jezero.insecure"
"""Names under which click's context has the values of these options."""
ROUTER_WAIT_S = 0.5
"""Longest wait for a stack that could make a plan without a flight."""


class Finite(click.ParamType[float]):
    """A number that is neither NaN nor infinite."""

    name = "float"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = click.FLOAT.convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


FINITE = Finite()

WHOLE = 1000
"""Letters of the longest sentence in a list of commands."""


class FiniteRange(click.FloatRange):
    """A number within limits. Its parent class takes NaN, which no comparison excludes."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        return FINITE.convert(super().convert(value, param, ctx), param, ctx)


class CommandGroup(click.Group):
    """Group whose help has the whole first sentence of each command; click cuts it at the width of a line."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        rows = [(name, each.get_short_help_str(WHOLE)) for name, each in commands.items() if each is not None]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


class PngFile(click.Path):
    """A file that is written as a PNG, and named so."""

    name = "file"

    def __init__(self) -> None:
        super().__init__(dir_okay=False, writable=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from jezero.client.png import png_file

        try:
            return png_file(os.fsdecode(super().convert(value, param, ctx)))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class VehicleName(click.ParamType[str]):
    """The name of a vehicle."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            return checked_vehicle(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Router(click.ParamType[str]):
    """The address of a router, which becomes its endpoint with what `keys_option` and `insecure_option` say."""

    name = "address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            meta = ctx.meta if ctx else {}
            insecure = bool(meta.get(INSECURE)) or os.environ.get(INSECURE_VARIABLE) == "1"
            return endpoint_of(value, meta.get(KEYS), insecure=insecure)
        except ValueError as error:
            self.fail(str(error), param, ctx)


def flight_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every command that sends a goal."""
    command = click.option("--yes", is_flag=True, help="Fly for more than a minute without a question.")(command)
    return common_options(command)


def common_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every command that connects to a vehicle."""
    json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
    return vehicle_options(json_option(command))


def vehicle_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that name a vehicle, its router and the bundle for it."""
    command = insecure_option("Connect to another computer without TLS, on a network that you trust.")(command)
    command = keys_option(command)
    command = click.option(
        "--router",
        envvar="JEZERO_ROUTER",
        type=Router(),
        default="tcp/127.0.0.1:7447",
        show_default=True,
        help="Router's endpoint.",
    )(command)
    return vehicle_option("Vehicle's name.")(command)


def vehicle_option(text: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The option of the vehicle's name, with its help."""
    return click.option(
        "--vehicle", envvar="JEZERO_VEHICLE", type=VehicleName(), default="uav1", show_default=True, help=text
    )


def keys_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option of the bundle, which the type `Router` uses."""
    return click.option(
        "--keys",
        envvar=KEYS_VARIABLE,
        type=click.Path(path_type=Path, exists=True, file_okay=False),
        is_eager=True,
        expose_value=False,
        callback=_keep,
        help="Folder of the bundle of `jezero keys`, for an address with tls.",
    )(command)


def insecure_option(text: str, *, expose_value: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The option that permits addresses without TLS, which the type `Router` uses.

    Args:
        text: help.
        expose_value: whether the command gets its value too.
    """
    return click.option(
        "--insecure",
        is_flag=True,
        default=None,
        is_eager=True,
        expose_value=expose_value,
        callback=_keep,
        help=text,
    )


def _keep(ctx: click.Context, param: click.Parameter, value: Any) -> Any:
    """Keep an option's value for the type `Router`."""
    ctx.meta[f"jezero.{param.name}"] = value
    return value


def check_times(start_s: float, end_s: float | None, result: str) -> None:
    """Refuse the values of `--from` and `--to` that no part of a recording has.

    Args:
        start_s: seconds from the start of the recording.
        end_s: the same; None for its end.
        result: what would be empty.
    """
    if start_s < 0.0:
        raise click.UsageError(f"--from {start_s:g}: give seconds from the start of FILE, 0 or more")
    if end_s is not None and end_s <= start_s:
        raise click.UsageError(f"--to {end_s:g} is not after --from {start_s:g}: {result} would be empty")


@dataclass(frozen=True)
class Origin:
    """The world's origin, and where it is known from.

    Attributes:
        position_deg: latitude and longitude.
        source: for people.
        altitude_m: above sea level; None where it is not known.
    """

    position_deg: tuple[float, float]
    source: str
    altitude_m: float | None = None

    @property
    def origin_deg(self) -> tuple[float, ...]:
        """Latitude and longitude, and the altitude where it is known."""
        return self.position_deg if self.altitude_m is None else (*self.position_deg, self.altitude_m)

    def __str__(self) -> str:
        return "{:.6f}, {:.6f}".format(*self.position_deg)


def world_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option of the world, which every process that this command starts, and this one, reads."""
    from jezero.cli import completion

    return click.option(
        "--world",
        metavar="NAME|FILE",
        is_eager=True,
        expose_value=False,
        callback=_choose_world,
        shell_complete=completion.worlds,
        help="World to fly in, such as mars: what it changes in the settings [default: JEZERO_WORLD, or none].",
    )(command)


def _choose_world(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    from jezero.base.config import WORLD_VARIABLE, ConfigError, find_world

    if value is None:
        return
    try:
        path = find_world(value)
    except ConfigError as error:
        raise click.BadParameter(str(error)) from None
    os.environ[WORLD_VARIABLE] = str(path) if value.endswith(".toml") else value


def origin_option(text: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The option of the world's origin, with its help."""
    return click.option("--origin", nargs=2, type=float, callback=_checked_origin, metavar="LAT LON", help=text)


def _checked_origin(
    context: click.Context, parameter: click.Parameter, value: tuple[float, float] | None
) -> Origin | None:
    if value is None:
        return None
    if not (all(map(isfinite, value)) and abs(value[0]) <= 90.0 and abs(value[1]) <= 180.0):
        raise click.BadParameter("expected a latitude within ±90 and a longitude within ±180 degrees")
    return Origin(value, "--origin")


def vehicle_origin(odometry: "Odometry | None") -> Origin | None:
    """The world's origin as the vehicle's autopilot has it; None until it sends it."""
    if odometry is None or odometry.origin_deg is None:
        return None
    return Origin(odometry.origin_deg[:2], "the vehicle's", odometry.origin_deg[2])


def simulator_origin() -> Origin:
    """The origin of the simulator's world, for plans that no stack flies."""
    from jezero.base.config import load_config
    from jezero.services.simulator.config import SimulatorConfig

    latitude_deg, longitude_deg, altitude_m = load_config(SimulatorConfig, "simulator").origin.origin_deg
    return Origin((latitude_deg, longitude_deg), "the simulator's settings", altitude_m)
