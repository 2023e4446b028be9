"""`jezero pause`, `jezero resume` and `jezero modify`: requests about the goal in charge, whoever sent it."""

import click

from jezero.cli.action import key_values
from jezero.cli.shared import NUMBERS, Printer, common_options, connected


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
    fields = key_values(words)
    printer = Printer(as_json)
    with connected(vehicle, router, printer) as uav:
        goal_id, warning = uav.modify(**fields)
        printer.event("result", f"modified goal {goal_id}", outcome="succeeded", goal_id=goal_id, warning=warning)
        printer.warn(warning)
