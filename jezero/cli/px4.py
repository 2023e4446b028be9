"""`jezero px4 parameters`: compare a flight controller's parameters with those that jezero needs, and set them."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from jezero.base.config import config_directory, load_config
from jezero.base.extras import require
from jezero.base.files import NOT_UTF8, describe_os_error
from jezero.base.mistakes import mistake
from jezero.cli.options import CommandGroup
from jezero.cli.terminal import REFUSED, print_table

if TYPE_CHECKING:
    from jezero.runtime.links import SocketLink
    from jezero.services.vehicle_bridge.controller_parameters import Parameter, ParameterExchange

SILENCE_MAX_S = 6.0
TURN_S = 0.01
REBOOTS = ("MAV_", "SER_")
"""Beginnings of parameters that PX4 reads at its start only."""


@click.group(cls=CommandGroup)
def px4() -> None:
    """Prepare a real flight controller."""


@px4.group(cls=CommandGroup)
def parameters() -> None:
    """Compare and set the parameters of a flight controller, while no stack uses its link."""


FILE = click.argument("file", type=click.Path(path_type=Path, dir_okay=False), required=False)
LINK = click.option("--link", metavar="ADDRESS", default="", help="[default: link in vehicle_bridge.toml]")
SYSTEM_ID_HELP = "MAVLink system id [default: of the first one that is heard]."
SYSTEM_ID = click.option("--system-id", type=click.IntRange(0, 255), default=0, help=SYSTEM_ID_HELP)


@parameters.command()
@FILE
@LINK
@SYSTEM_ID
def check(file: Path | None, link: str, system_id: int) -> None:
    """Compare the flight controller's parameters with FILE [default: px4.toml among the settings].

    The exit code is 3 when one differs.
    """
    wanted = _read(file)
    with_link = _open(link)
    try:
        exchange = _ask(with_link, system_id, wanted, link)
    finally:
        with_link.close()
    _print(wanted, exchange)
    if _differing(wanted, exchange):
        raise SystemExit(REFUSED)


@parameters.command()
@FILE
@LINK
@SYSTEM_ID
@click.option("--yes", is_flag=True, help="Set all that differ, without a question for each.")
def load(file: Path | None, link: str, system_id: int, yes: bool) -> None:
    """Set the parameters of FILE that differ, each after a question, and read them back."""
    wanted = _read(file)
    with_link = _open(link)
    try:
        exchange = _ask(with_link, system_id, wanted, link)
        chosen = []
        for each in _differing(wanted, exchange):
            if each.name in exchange.unknown:
                click.echo(f"{each.name} is left out: the flight controller doesn't know it")
            elif yes or click.confirm(f"{each.name} from {_text(exchange, each)} to {each.value} ({each.why})?"):
                chosen.append(each)
        for each in chosen:
            exchange.set(each.name, each.value)
        _run(with_link, exchange)
    finally:
        with_link.close()
    failed = [each.name for each in chosen if exchange.values.get(each.name) != each.value]
    if failed:
        raise click.ClickException(f"the flight controller keeps its own value of {', '.join(failed)}")
    click.echo(f"{len(chosen)} parameters set")
    if any(each.name.startswith(REBOOTS) for each in chosen):
        click.echo("start the flight controller anew: it reads some of them at its start only")


def _read(file: Path | None) -> list["Parameter"]:
    require("`jezero px4`", "pymavlink", "serial")
    from jezero.services.vehicle_bridge.controller_parameters import ParameterFile

    if file is None:
        return load_config(ParameterFile, "px4").parameter
    try:
        return msgspec.toml.decode(file.read_bytes(), type=ParameterFile).parameter
    except OSError as error:
        raise click.ClickException(describe_os_error(error)) from None
    except msgspec.ValidationError as error:
        raise click.ClickException(f"{file}: {mistake(error, ParameterFile, 'field')}") from None
    except UnicodeDecodeError:
        raise click.ClickException(f"{file} {NOT_UTF8}") from None
    except msgspec.DecodeError as error:
        raise click.ClickException(f"{file}: {error}") from None


def _open(address: str) -> "SocketLink":
    from jezero.keys.controller_key import REMEDY, controller_key
    from jezero.runtime.links import link_of
    from jezero.services.vehicle_bridge.config import VehicleBridgeConfig

    configured = load_config(VehicleBridgeConfig, "vehicle_bridge").link
    if not (address or configured):
        place = config_directory() / "vehicle_bridge.toml"
        raise click.ClickException(f"no flight controller is named: give --link, or set link in {place}")
    name = "--link" if address else "link in vehicle_bridge.toml"
    link = link_of(name, address or configured, signed=bool(controller_key()), remedy=REMEDY)
    link.start()
    return link


def _ask(link: "SocketLink", system_id: int, wanted: list["Parameter"], address: str) -> "ParameterExchange":
    """Read the parameters."""
    from jezero.base.mavlink import UNIX_2015_S
    from jezero.keys.controller_key import CONTROLLER_KEY_VARIABLE, controller_key
    from jezero.services.vehicle_bridge.controller_parameters import ParameterExchange

    exchange = ParameterExchange(system_id, controller_key(), time.time() - UNIX_2015_S)
    exchange.read(each.name for each in wanted)
    _run(link, exchange)
    if exchange.refusal:
        raise click.ClickException(exchange.refusal)
    if not exchange.values and exchange.bad_signatures:
        raise click.ClickException(
            f"{exchange.bad_signatures} messages of the flight controller had no valid signature: give it the key in "
            f"{CONTROLLER_KEY_VARIABLE}, or unset that"
        )
    if not exchange.values:
        raise click.ClickException(
            f"no flight controller replies at {address or 'the link in vehicle_bridge.toml'}: is it plugged in, and "
            "does no stack use the link (`jezero ps`)?"
        )
    return exchange


def _run(link: "SocketLink", exchange: "ParameterExchange") -> None:
    """Exchange until everything was replied to, or nothing comes."""
    quiet_since_s = time.monotonic()
    known = len(exchange.values)
    while not exchange.done and time.monotonic() - quiet_since_s < SILENCE_MAX_S:
        now_ns = time.monotonic_ns()
        if out := exchange.step(link.poll(now_ns), now_ns):
            link.send(out)
        if len(exchange.values) != known:
            known, quiet_since_s = len(exchange.values), time.monotonic()
        time.sleep(TURN_S)


def _differing(wanted: list["Parameter"], exchange: "ParameterExchange") -> list["Parameter"]:
    return [each for each in wanted if not _is_equal(exchange.values.get(each.name), each.value)]


def _is_equal(has: int | float | None, wanted: int | float) -> bool:
    """Whether a parameter has a value, as a float of 32 bits."""
    return has is not None and abs(has - wanted) <= 1e-6 * max(1.0, abs(wanted))


def _text(exchange: "ParameterExchange", each: "Parameter") -> str:
    value = exchange.values.get(each.name)
    return "unknown" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _print(wanted: list["Parameter"], exchange: "ParameterExchange") -> None:
    rows = [
        (
            each.name,
            _text(exchange, each),
            str(each.value),
            "" if _is_equal(exchange.values.get(each.name), each.value) else "differs",
            each.why,
        )
        for each in wanted
    ]
    print_table([("PARAMETER", "CONTROLLER", "NEEDED", "", "WHY"), *rows])
