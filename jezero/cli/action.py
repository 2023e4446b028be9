"""`jezero action`: every action that there is, those of installed packages too."""

import json
from typing import Any

import click
import msgspec

from jezero.cli.plan import send_goal
from jezero.cli.shared import NUMBERS, Printer, connected, flight_options, fly_goal
from jezero.plugins import PluginError, action_names, find_action
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action
from jezero.schemas.topics import ACTIONS

COMMON = frozenset(field.name for field in msgspec.structs.fields(Goal))
"""Fields of every goal, which the client fills in."""


@click.group()
def action() -> None:
    """List all actions, or send a goal to any of them."""


@action.command("list")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def list_actions(as_json: bool) -> None:
    """Show every action with the fields of its goal; a field without a default must be given."""
    for name in action_names():
        try:
            found = find_action(name)
        except PluginError as error:
            click.echo(json.dumps({"action": name, "problem": str(error)}) if as_json else f"{name}\n  {error}")
            continue
        origin = "jezero" if name in ACTIONS else "package"
        if as_json:
            click.echo(json.dumps({"action": name, "from": origin, "goal": _fields(found)}))
            continue
        click.secho(name if origin == "jezero" else f"{name} (from a package)", bold=True)
        for field, default in _fields(found).items():
            click.echo(f"  {field}" if default is None else f"  {field}={default}")


@action.command(context_settings=NUMBERS)
@click.argument("name")
@click.argument("fields", nargs=-1, metavar="[KEY=VALUE]...")
@flight_options
def send(name: str, fields: tuple[str, ...], yes: bool, vehicle: str, router: str, as_json: bool) -> None:
    """Send a goal to the action NAME and follow it to its end.

    A VALUE is JSON where it parses, and text otherwise: `jezero action send go_to target_ned_m=[0,0,-4]`.
    """
    printer = Printer(as_json)
    given = _goal_fields(name, fields)
    found = find_action(name)
    try:
        goal = msgspec.convert(given, found.goal_type)
    except msgspec.ValidationError as error:
        raise click.UsageError(f"{name}: {error}. `jezero info actions {name}` shows the fields") from None
    with connected(vehicle, router, printer) as uav:
        fly_goal(printer, send_goal(printer, uav, found, goal, yes=yes), name)


def _goal_fields(name: str, words: tuple[str, ...]) -> dict[str, Any]:
    """The fields of a goal from `key=value` words.

    Raises:
        click.UsageError: a word has no `=`, a field is unknown or given twice, or there is no such action.
    """
    try:
        known = _fields(find_action(name))
    except PluginError as error:
        raise click.UsageError(str(error)) from None
    fields = key_values(words)
    for key in fields:
        if key not in known:
            raise click.UsageError(f"{name} has no field {key!r}; its fields are {', '.join(known)}")
    return fields


def key_values(words: tuple[str, ...]) -> dict[str, Any]:
    """Values by key, of `key=value` words; a value that is no JSON is a text.

    Raises:
        click.UsageError: a word has no `=`, or a key is given twice.
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


def _fields(found: Action[Any]) -> dict[str, str | None]:
    """Fields of an action's goal, each with its default as JSON; None for a field that must be given."""
    fields = {field.name: field for field in msgspec.structs.fields(found.goal_type)}
    own = [*(name for name in fields if name not in COMMON), "on_client_loss"]
    return {name: None if fields[name].required else msgspec.json.encode(fields[name].default).decode() for name in own}
