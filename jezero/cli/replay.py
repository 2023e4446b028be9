"""`jezero replay`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from jezero.cli.recording import RECORDING_PATH
from jezero.cli.shared import FINITE, vehicle_options

PLAIN = ("speed", "start_s", "end_s", "loop", "topics", "force", "vehicle", "router")
"""Parameters of a replay onto a bus, which mean nothing with --through."""


def _plain_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a replay onto a bus."""
    for option in (
        click.option("--force", is_flag=True, help="Replay where services run, too, without commands and clock."),
        click.option("--topic", "topics", multiple=True, help="Only this topic; may be given several times."),
        click.option("--loop", is_flag=True, help="Begin again at the end."),
        click.option("--to", "end_s", type=FINITE, metavar="S", help="End, in seconds from the start of FILE."),
        click.option("--from", "start_s", type=FINITE, default=0.0, metavar="S",
                     help="Start, in seconds from the start of FILE."),
        click.option("--speed", type=FINITE, default=1.0, show_default=True, metavar="K",
                     help="Seconds of the flight per second."),
    ):  # fmt: skip
        command = option(command)
    return command


@click.command()
@click.argument("file", type=RECORDING_PATH)
@_plain_options
@vehicle_options
@click.option("--through", "service", metavar="SERVICE", help="Publish nothing; run this service on what it received.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="With --through: a setting that is to differ; may be given several times.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="With --through: print one JSON object.")
@click.pass_context
def replay(
    context: click.Context,
    /,
    file: Path,
    service: str | None,
    settings: tuple[str, ...],
    as_json: bool,
    **plain: Any,
) -> None:
    """Publish the messages of FILE as the services did when it was recorded, at the same times.

    Other programs see the flight again: `jezero watch`, `jezero status`, clients. Nothing flies: goals and requests are
    not sent. Without a router at its address, the replay is the router. In a terminal, space pauses and continues,
    `.` or the right arrow steps by a tenth of a second, q quits.

    FILE is a recording, or the folder of a run.
    """
    if service is not None:
        from jezero.cli.replay_through import replay_through

        if given := [name for name in PLAIN if _is_given(context, name)]:
            option = next(each for each in context.command.params if each.name == given[0]).opts[0]
            raise click.UsageError(f"{option} has no meaning with --through, which publishes nothing")
        replay_through(file, service, settings, as_json=as_json)
        return
    if settings or as_json:
        raise click.UsageError(f"{'--set' if settings else '--json'} needs --through SERVICE")
    from jezero.cli.replay_onto_bus import replay_onto_bus

    _check_range(plain["speed"], plain["start_s"], plain["end_s"])
    _check_vehicle(plain["vehicle"])
    replay_onto_bus(file, **plain)


def _is_given(context: click.Context, name: str) -> bool:
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def _check_range(speed: float, start_s: float, end_s: float | None) -> None:
    if not 0.001 <= speed <= 1000.0:
        raise click.UsageError(f"--speed {speed:g}: give a number from 0.001 to 1000")
    if start_s < 0.0:
        raise click.UsageError(f"--from {start_s:g}: give seconds from the start of FILE, 0 or more")
    if end_s is not None and end_s <= start_s:
        raise click.UsageError(f"--to {end_s:g} is not after --from {start_s:g}: the replay would be empty")


def _check_vehicle(vehicle: str) -> None:
    """Refuse a name that is none: a wildcard would be published to every vehicle."""
    import msgspec

    from jezero.runtime.config import NAME_EXPECTED, Instance

    try:
        msgspec.convert({"vehicle": vehicle}, Instance)
    except msgspec.ValidationError:
        raise click.UsageError(f"--vehicle is {vehicle!r}: {NAME_EXPECTED}") from None
