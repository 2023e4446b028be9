"""`jezero ground`: the ground station alone, for a vehicle whose stack runs here or elsewhere."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.options import RECORDING_PATH, Router, insecure_option, keys_option, vehicle_option

if TYPE_CHECKING:
    from jezero.services.ground_station.config import GroundStationConfig

FILE = click.Path(exists=True, dir_okay=False)


@click.command()
@click.option(
    "--connect",
    "--router",
    "router",
    envvar="JEZERO_ROUTER",
    type=Router(),
    default="tcp/127.0.0.1:7447",
    show_default=True,
    help="Endpoint of the vehicle's router.",
)
@keys_option
@vehicle_option("Vehicle's name.")
@click.option("--recording", type=RECORDING_PATH, help="Look back at this recording, or at those of a run's folder.")
@click.option("--port", type=click.IntRange(1, 65535), help="Port of the pages [default: as in ground_station.toml].")
@click.option("--listen", metavar="ADDRESS", help="IP address of the pages; 0.0.0.0 for all networks.")
@click.option("--certificate", type=FILE, help="TLS certificate, PEM.")
@click.option("--key", type=FILE, help="Private key of the certificate, PEM.")
@insecure_option("Serve and connect to other addresses than 127.0.0.1 without TLS.", expose_value=True)
@click.option("--set-password", is_flag=True, help="Set the password of those who may fly, and end.")
def ground(router: str, vehicle: str, recording: Path | None, set_password: bool, **given: Any) -> None:
    """Serve the ground station's pages to browsers, until Ctrl+C.

    `jezero up` starts a ground station too. This command is for a laptop beside the vehicle. When the port is busy, the
    next free one is taken.

    On this machine's own address (127.0.0.1) anybody may fly. On another one, whoever knows the password may fly and
    everybody else may watch; it needs --certificate and --key, or --insecure.
    """
    config = _settings(given)
    if set_password:
        _set_password(config)
        return
    _serve(config, vehicle, router, recording)


def _settings(given: dict[str, Any]) -> "GroundStationConfig":
    """The settings of ground_station.toml, with the options in their places."""
    import msgspec

    from jezero.base.config import load_config
    from jezero.services.ground_station.config import GroundStationConfig

    changes = {name: value for name, value in given.items() if value is not None}
    return msgspec.structs.replace(load_config(GroundStationConfig, "ground_station"), **changes)


def _set_password(config: "GroundStationConfig") -> None:
    """Ask for a password, or read it from the first line of standard input, and write its hash."""
    with _ground_extra():
        from jezero.services.ground_station.access import password_file, write_password

    if sys.stdin.isatty():
        password = click.prompt("Password", hide_input=True, confirmation_prompt=True)
    else:
        password = sys.stdin.readline().rstrip("\r\n")
    try:
        write_password(password_file(config), password)
    except ValueError as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"the password is set; its hash is in {password_file(config)}")


def _serve(config: "GroundStationConfig", vehicle: str, router: str, recording: Path | None) -> None:
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig

    with _ground_extra():
        from jezero.services.ground_station.access import listening_of
        from jezero.services.ground_station.web.server import PageServer
    live = router if recording is None else None
    place = _run_folder(vehicle) if recording is None else _checked(recording)
    server = PageServer(listening_of(config), load_config(VehicleConfig, "vehicle"), vehicle, live, place)
    with suppress(KeyboardInterrupt):  # uvicorn raises Ctrl+C anew after its own shutdown
        click.echo(
            f"the pages of {vehicle if recording is None else recording} are on {server.address}. Ctrl+C ends them."
        )
        server.run()


@contextmanager
def _ground_extra() -> Iterator[None]:
    """Imports from the extra `ground`, with a sentence where it is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "jezero":
            raise
        raise click.ClickException("the ground station is an extra: pip install 'jezero[ground]'") from None


def _run_folder(vehicle: str) -> Path | None:
    """Folder of the vehicle's run on this machine, whose recordings are listed; None when there is none."""
    from jezero.runtime.instance import run_folder_of

    try:
        return run_folder_of(vehicle)
    except OSError:  # the user has no home
        return None


def _checked(recording: Path) -> Path:
    """The path, if it is a recording or the folder of a run that has one."""
    from jezero.recording import RecordingError, open_recording

    try:
        open_recording(recording)
    except RecordingError as error:
        raise click.ClickException(str(error)) from None
    return recording
