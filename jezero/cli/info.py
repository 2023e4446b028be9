"""`jezero info`: the services and topics of the stack, and the reference pages of the documentation."""

import json
from collections.abc import Sequence
from importlib import import_module

import click
import msgspec

from jezero.base.mistakes import unknown
from jezero.cli import completion
from jezero.cli.options import CommandGroup, simulator_origin
from jezero.cli.reference.actions import action_rows, field_rows
from jezero.cli.reference.topics import Actions, Row, endpoint_rows, mermaid, service_rows, topic_rows
from jezero.cli.reference.words import cell
from jezero.schemas.topics import ACTIONS

PAGES_OF_ACTIONS = ("topics", "actions")
PAGES = (*PAGES_OF_ACTIONS, "settings", "commands", "python", "ros2")
"""Names of the pages: each is a module of `jezero.cli.reference` with a function `page`."""
TABLE_WIDTH_MIN, COLUMN_WIDTH_MAX = 120, 40
JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
MERMAID = click.option("--mermaid", "as_mermaid", is_flag=True, help="The graph of services as a Mermaid flowchart.")


@click.group(cls=CommandGroup)
def info() -> None:
    """Show services, topics and endpoints; no running stack is needed."""


@info.command()
@click.argument("name", type=click.Choice(PAGES))
@click.option("--own", is_flag=True, help="Only jezero's own actions, without those of installed packages.")
def page(name: str, own: bool) -> None:
    """Print the page NAME of the reference in Markdown: docs/reference/NAME.md is this output with `--own`."""
    from jezero.base.plugins import all_actions

    click.echo(reference_page(name) if own else reference_page(name, all_actions()), nl=False)


def reference_page(name: str, actions: Actions = ACTIONS) -> str:
    """The page docs/reference/<name>.md.

    Args:
        actions: actions on the pages `topics` and `actions`.
    """
    make = import_module(f"jezero.cli.reference.{name}").page
    text: str = make(actions) if name in PAGES_OF_ACTIONS else make()
    return text


@info.command()
@JSON
def origin(as_json: bool) -> None:
    """Show the world's origin by the simulator's settings; `jezero status` shows that of a running stack."""
    origin_deg = simulator_origin().origin_deg
    text = "latitude {:.7f}, longitude {:.7f}, {:.1f} m".format(*origin_deg)
    click.echo(json.dumps({"origin_deg": origin_deg}) if as_json else text)


@info.command()
@JSON
@MERMAID
def topics(as_json: bool, as_mermaid: bool) -> None:
    """Show every topic: its type, rate, writer and readers."""
    from jezero.base.plugins import all_actions

    if as_mermaid:
        click.echo(mermaid(all_actions()))
    else:
        _print(topic_rows(all_actions()), as_json=as_json)


@info.command()
@click.argument("name", required=False, shell_complete=completion.actions)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per action, with JSON Schemas.")
def actions(name: str | None, as_json: bool) -> None:
    """Show every action, or the fields of goal, feedback and result of the action NAME."""
    from jezero.base.plugins import action_names, all_actions, find_action

    if name is not None and name not in action_names():
        raise click.BadParameter(unknown("action", name, action_names()))
    shown = all_actions() if name is None else {name: find_action(name)}
    if as_json:
        for action in shown.values():
            click.echo(json.dumps(msgspec.to_builtins(action.description)))
    elif name is None:
        _print(action_rows(shown), as_json=False)
    else:
        action = shown[name]
        parts = {"goal": action.goal_type, "feedback": action.feedback_type, "result": action.result_type}
        click.echo(f"Goals are sent to {action.endpoint.name}, planned by {action.plan.name}.")
        for part, struct in parts.items():
            click.secho(f"\n{part}", bold=True)
            _print(field_rows(struct), as_json=False)


@info.command()
@JSON
def endpoints(as_json: bool) -> None:
    """Show every endpoint: its request, and the service that replies."""
    from jezero.base.plugins import all_actions

    _print(endpoint_rows(all_actions()), as_json=as_json)


@info.command()
@JSON
@MERMAID
def services(as_json: bool, as_mermaid: bool) -> None:
    """Show every service: the topics it reads and publishes, the endpoints it replies on and requests."""
    from jezero.base.plugins import all_actions

    if as_mermaid:
        click.echo(mermaid(all_actions()))
    else:
        rows = service_rows(all_actions())
        if as_json:
            _print(rows, as_json=True)
        else:
            _print_services(rows)


def _print(rows: Sequence[Row], *, as_json: bool) -> None:
    if as_json:
        for row in rows:
            click.echo(json.dumps(row))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    *names, last = rows[0]
    for name in names:
        longest = max(len(cell(row[name])) for row in rows)
        table.add_column(name, no_wrap=longest <= COLUMN_WIDTH_MAX, max_width=COLUMN_WIDTH_MAX)
    table.add_column(last)
    for row in rows:
        table.add_row(*map(cell, row.values()))
    console = Console()
    Console(width=max(console.width, TABLE_WIDTH_MIN)).print(table)


def _print_services(rows: Sequence[Row]) -> None:
    """One paragraph a service, one line for each kind of declaration that it has."""
    for row in rows:
        name, *kinds = row
        click.secho(row[name], bold=True)
        for kind in kinds:
            if row[kind]:
                click.echo(click.wrap_text(cell(row[kind]), 110, f"  {kind:<11}", " " * 13))
