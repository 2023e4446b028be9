"""The page of services, topics and endpoints, from the declarations that the services run with."""

from importlib import import_module
from typing import Any

from jezero.base.plugins import action_names, all_actions, find_action, plugin_names
from jezero.cli.reference.words import table
from jezero.runtime.service import Spec
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.topics import ENDPOINTS, TOPICS, feedback_of
from jezero.services.table import ServiceRow, make, services

Row = dict[str, Any]


def all_specs() -> dict[str, Spec]:
    """Declarations of all services of the stack, by name."""
    return {name: _spec_of(row) for name, row in services().items()}


def _spec_of(row: ServiceRow) -> Spec:
    """`SPEC` beside the maker, or the declaration of a service made for it where that depends on the actions."""
    spec = getattr(import_module(row.maker.partition(":")[0]), "SPEC", None)
    return make(row, {"boot_id": 0}).spec if spec is None else spec


def all_topics() -> tuple[Topic[Any], ...]:
    """Every topic, with the feedback of each action; the health of each service is left out."""
    return (*TOPICS, *map(feedback_of, all_actions().values()))


def all_endpoints() -> tuple[Endpoint[Any, Any], ...]:
    """Every endpoint, also those of the actions of packages."""
    return (*ENDPOINTS, *(endpoint for name in plugin_names() for endpoint in find_action(name).endpoints))


def topic_rows() -> list[Row]:
    """One row a topic: name, message type, rates, writer and readers."""
    specs = all_specs().values()
    return [
        {
            "topic": topic.name,
            "type": topic.struct.__name__,
            "rate_hz": topic.rate_hz,
            "link_hz": topic.rate_hz if topic.link_hz is None else topic.link_hz,
            "writer": topic.writer if topic.host == "vehicle" else f"{topic.writer} or {topic.host}",
            "readers": [s.name for s in specs if topic in (*s.inputs, *s.on_demand)],
        }
        for topic in all_topics()
    ]


def endpoint_rows() -> list[Row]:
    """One row an endpoint: name, request type, the service that replies, and who sends requests, or may."""
    specs = all_specs().values()
    return [
        {
            "endpoint": endpoint.name,
            "request": endpoint.request_type.__name__,
            "replies": endpoint.server,
            "may request": endpoint.asker,
            "requested by": [s.name for s in specs if endpoint in s.calls],
        }
        for endpoint in all_endpoints()
    ]


def service_rows() -> list[Row]:
    """One row a service: the topics it reads and publishes, the endpoints it replies on and requests, its links."""
    return [
        {
            "service": spec.name,
            "reads": ["all topics"] if spec.hears_all else [t.name for t in (*spec.inputs, *spec.on_demand)],
            "publishes": [t.name for t in spec.outputs],
            "replies": [e.name for e in spec.serves],
            "requests": [e.name for e in spec.calls],
            "links": list(spec.links),
        }
        for spec in all_specs().values()
    ]


def mermaid() -> str:
    """The graph of services and topics as a Mermaid flowchart; the action servers are one node."""

    def node(service: str) -> str:
        return "actions" if service in action_names() else service

    specs = all_specs()
    edges: dict[tuple[str, str], list[str]] = {}
    for row in topic_rows():
        writers = [name for name, spec in specs.items() if row["topic"] in {t.name for t in spec.outputs}]
        for writer in writers or [row["writer"]]:
            for reader in row["readers"]:
                topics = edges.setdefault((node(writer), node(reader)), [])
                if row["topic"] not in topics:
                    topics.append(row["topic"])
    lines = [f"    {writer} -->|{'<br>'.join(topics)}| {reader}" for (writer, reader), topics in edges.items()]
    return "\n".join(["flowchart TD", *lines])


def page() -> str:
    """The page: the graph and the three tables."""
    return f"""# Topics, endpoints and services

This page is the output of `jezero info page topics`. Keys are `jezero/<vehicle>/<name>`; *actions* are all action
servers. Every service also publishes `health/<service>` once a second, and at once when its state changes.

*link_hz* is the greatest rate at which a topic crosses a link [between computers](../how-to/three-computers.md).

*May read* and *may request* name who may do so from another computer with [keys](../how-to/keys.md#who-may-what): a
viewer is everybody of the team, a pilot who flies, a service one of the vehicle's own.

```mermaid
{mermaid()}
```

## Topics

{table(topic_rows())}

## Endpoints

{table(endpoint_rows())}

## Services

{table(service_rows())}
"""
