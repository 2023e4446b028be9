"""`jezero pause`, `jezero resume` and `jezero modify`: requests about the goal in charge, whoever sent it."""

import json
from typing import Any

import click

from jezero.cli.flight import NUMBERS, Printer, common_options, connected


@click.command()
@common_options
def pause(vehicle: str, router: str, as_json: bool) -> None:
    """Pause the goal in charge: the vehicle brakes and hovers until `jezero resume`.

    The goal keeps control. `jezero hover` and `jezero abort` end it, and so does an empty battery.
    """
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        goal_id = uav.pause()
        printer.event("result", f"pausing goal {goal_id}", outcome="succeeded", goal_id=goal_id)


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
    fields = _fields(words)
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        goal_id, warning = uav.modify(**fields)
        printer.event("result", f"modified goal {goal_id}", outcome="succeeded", goal_id=goal_id, warning=warning)
        printer.warn(warning)


def _fields(words: tuple[str, ...]) -> dict[str, Any]:
    """The fields of `key=value` words.

    Raises:
        click.UsageError: a word has no `=`, or a field is given twice.
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
