"""`jezero info`: the services and topics of the stack, from the declarations that the services run with."""

import json
from collections.abc import Sequence
from typing import Any

import click

from jezero.plugins import action_names, all_actions
from jezero.runtime.service import Spec
from jezero.schemas.topics import ENDPOINTS, TOPICS, Topic, feedback_of
from jezero.services.actions.table import action_server
from jezero.services.autopilot.service import SPEC as AUTOPILOT
from jezero.services.estimator.service import SPEC as ESTIMATOR
from jezero.services.estimator.tag_detector.service import SPEC as TAG_DETECTOR
from jezero.services.simulator.camera.service import SPEC as CAMERA
from jezero.services.simulator.service import SPEC as SIMULATOR
from jezero.services.vehicle_bridge.service import SPEC as VEHICLE_BRIDGE

Row = dict[str, Any]
TABLE_WIDTH_MIN = 120


def all_specs() -> dict[str, Spec]:
    """Declarations of all services of the stack, by name."""
    actions = (action_server(name, boot_id=0).spec for name in action_names())
    specs = (SIMULATOR, CAMERA, AUTOPILOT, VEHICLE_BRIDGE, TAG_DETECTOR, ESTIMATOR, *actions)
    return {spec.name: spec for spec in specs}


def all_topics() -> tuple[Topic[Any], ...]:
    """Every topic, with the feedback of each action; the health of each service is left out."""
    return (*TOPICS, *map(feedback_of, all_actions().values()))


def topic_rows() -> list[Row]:
    """One row a topic: name, message type, rate, delivery, writer, readers."""
    specs = all_specs().values()
    return [
        {
            "topic": topic.name,
            "type": topic.struct.__name__,
            "rate_hz": topic.rate_hz,
            "delivery": topic.delivery,
            "writer": topic.writer,
            "readers": [s.name for s in specs if topic in (*s.inputs, *s.on_demand)],
        }
        for topic in all_topics()
    ]


def endpoint_rows() -> list[Row]:
    """One row an endpoint: name, request type, the service that replies, the services that send requests."""
    specs = all_specs().values()
    return [
        {
            "endpoint": endpoint.name,
            "request": endpoint.request_type.__name__,
            "replies": endpoint.server,
            "requested by": [s.name for s in specs if endpoint in s.calls],
        }
        for endpoint in ENDPOINTS
    ]


def service_rows() -> list[Row]:
    """One row a service: the topics it reads and publishes, the endpoints it replies on and requests, its links."""
    return [
        {
            "service": spec.name,
            "reads": [t.name for t in (*spec.inputs, *spec.on_demand)],
            "publishes": [t.name for t in spec.outputs],
            "replies": [e.name for e in spec.serves],
            "requests": [e.name for e in spec.calls],
            "links": list(spec.links),
        }
        for spec in all_specs().values()
    ]


def mermaid() -> str:
    """The graph of services and topics as a Mermaid flowchart; the five action servers are one node."""

    def node(service: str) -> str:
        return "actions" if service in action_names() else service

    edges: dict[tuple[str, str], list[str]] = {}
    for row in topic_rows():
        writers = [name for name, spec in all_specs().items() if row["topic"] in {t.name for t in spec.outputs}]
        for writer in writers or [row["writer"]]:
            for reader in row["readers"]:
                topics = edges.setdefault((node(writer), node(reader)), [])
                if row["topic"] not in topics:
                    topics.append(row["topic"])
    lines = [f"    {writer} -->|{'<br>'.join(topics)}| {reader}" for (writer, reader), topics in edges.items()]
    return "\n".join(["flowchart TD", *lines])


def markdown(rows: Sequence[Row]) -> str:
    """Rows as a Markdown table."""
    names = list(rows[0])
    lines = [names, ["---"] * len(names), *([_cell(row[name]) for name in names] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def reference_page() -> str:
    """The page docs/reference/topics.md: the graph and the three tables."""
    return f"""# Topics, endpoints and services

This page is the output of `jezero info page`. Keys are `jezero/<vehicle>/<name>`; *actions* are all action servers.
Every service also publishes `health/<service>` once a second.

```mermaid
{mermaid()}
```

## Topics

{markdown(topic_rows())}

## Endpoints

{markdown(endpoint_rows())}

## Services

{markdown(service_rows())}
"""


def _cell(value: Any) -> str:
    """A value for people; a list that holds all action servers names them together."""
    if isinstance(value, list):
        if set(action_names()) <= set(value):
            value = [*(name for name in value if name not in action_names()), "actions"]
        return ", ".join(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


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
        table.add_column(name, no_wrap=True)
    table.add_column(last)
    for row in rows:
        table.add_row(*map(_cell, row.values()))
    console = Console()
    Console(width=max(console.width, TABLE_WIDTH_MIN)).print(table)


def _print_services(rows: Sequence[Row]) -> None:
    """One paragraph a service, one line for each kind of declaration that it has."""
    for row in rows:
        name, *kinds = row
        click.secho(row[name], bold=True)
        for kind in kinds:
            if row[kind]:
                click.echo(click.wrap_text(_cell(row[kind]), 110, f"  {kind:<11}", " " * 13))


JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
MERMAID = click.option("--mermaid", "as_mermaid", is_flag=True, help="The graph of services as a Mermaid flowchart.")


@click.group()
def info() -> None:
    """Show services, topics and endpoints; no running stack is needed."""


@info.command()
def page() -> None:
    """Print all tables as one page in Markdown."""
    click.echo(reference_page(), nl=False)


@info.command()
@JSON
@MERMAID
def topics(as_json: bool, as_mermaid: bool) -> None:
    """Show every topic: its type, rate, writer and readers."""
    if as_mermaid:
        click.echo(mermaid())
    else:
        _print(topic_rows(), as_json=as_json)


@info.command()
@JSON
def endpoints(as_json: bool) -> None:
    """Show every endpoint: its request, and the service that replies."""
    _print(endpoint_rows(), as_json=as_json)


@info.command()
@JSON
@MERMAID
def services(as_json: bool, as_mermaid: bool) -> None:
    """Show every service: the topics it reads and publishes, the endpoints it replies on and requests."""
    if as_mermaid:
        click.echo(mermaid())
    else:
        rows = service_rows()
        if as_json:
            _print(rows, as_json=True)
        else:
            _print_services(rows)
