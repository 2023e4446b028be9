"""The page of services, topics and endpoints, from the declarations that the services run with.

The functions take the actions to show: jezero's own, or those of installed packages too.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from jezero.cli.reference.words import table
from jezero.runtime.service import Spec
from jezero.schemas.rows import Action, Endpoint, Topic
from jezero.schemas.topics import ACTIONS, ENDPOINTS, TOPICS, feedback_of
from jezero.services.table import ServiceRow, make, services

Row = dict[str, Any]
Actions = Mapping[str, Action[Any]]


def all_specs(actions: Actions = ACTIONS) -> dict[str, Spec]:
    """Declarations of all services of the stack, by name."""
    rows = {name: row for name, row in services().items() if not row.is_action or name in actions}
    return {name: _spec_of(row, actions) for name, row in rows.items()}


def _spec_of(row: ServiceRow, actions: Actions) -> Spec:
    """`SPEC` beside the maker, or the declaration of a service made for it where that depends on the actions."""
    spec = getattr(import_module(row.maker.partition(":")[0]), "SPEC", None)
    return make(row, {"boot_id": 0, "actions": actions}).spec if spec is None else spec


def all_topics(actions: Actions = ACTIONS) -> tuple[Topic[Any], ...]:
    """Every topic, with the feedback of each action; the health of each service is left out."""
    return (*TOPICS, *map(feedback_of, actions.values()))


def all_endpoints(actions: Actions = ACTIONS) -> tuple[Endpoint[Any, Any], ...]:
    """Every endpoint."""
    others = (action for name, action in actions.items() if name not in ACTIONS)
    return (*ENDPOINTS, *(endpoint for action in others for endpoint in action.endpoints))


def topic_rows(actions: Actions = ACTIONS) -> list[Row]:
    """One row a topic: name, message type, rates, writer and readers."""
    specs = all_specs(actions).values()
    return [
        {
            "topic": topic.name,
            "type": topic.struct.__name__,
            "rate_hz": topic.rate_hz,
            "link_hz": topic.rate_hz if topic.link_hz is None else topic.link_hz,
            "writer": " or ".join(_writers(topic)),
            "readers": [s.name for s in specs if topic in (*s.inputs, *s.on_demand)],
        }
        for topic in all_topics(actions)
    ]


def _writers(topic: Topic[Any]) -> list[str]:
    return [
        topic.writer,
        *([topic.driver] if topic.driver else []),
        *([topic.host] if topic.host != "vehicle" else []),
    ]


def endpoint_rows(actions: Actions = ACTIONS) -> list[Row]:
    """One row an endpoint: name, request type, the service that replies, and who sends requests, or may."""
    specs = all_specs(actions).values()
    return [
        {
            "endpoint": endpoint.name,
            "request": endpoint.request_type.__name__,
            "replies": endpoint.server,
            "may request": endpoint.asker,
            "requested by": [s.name for s in specs if endpoint in s.calls],
        }
        for endpoint in all_endpoints(actions)
    ]


def service_rows(actions: Actions = ACTIONS) -> list[Row]:
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
        for spec in all_specs(actions).values()
    ]


def mermaid(actions: Actions = ACTIONS) -> str:
    """The graph of services and topics as a Mermaid flowchart; the action servers are one node."""
    specs = all_specs(actions)

    def node(service: str) -> str:
        return "actions" if service in actions else service

    edges: dict[tuple[str, str], list[str]] = {}
    for row in topic_rows(actions):
        writers = [name for name, spec in specs.items() if row["topic"] in {t.name for t in spec.outputs}]
        for writer in writers or [row["writer"]]:
            for reader in row["readers"]:
                topics = edges.setdefault((node(writer), node(reader)), [])
                if row["topic"] not in topics:
                    topics.append(row["topic"])
    lines = [f"    {writer} -->|{'<br>'.join(topics)}| {reader}" for (writer, reader), topics in edges.items()]
    return "\n".join(["flowchart TD", *lines])


def page(actions: Actions = ACTIONS) -> str:
    """The page: the graph and the three tables."""
    return f"""# Topics, endpoints and services

This page is the output of `jezero info page topics --own`. Keys are `jezero/<vehicle>/<name>`; *actions* are all action
servers. Every service also publishes `health/<service>` once a second, and at once when its state changes.

*link_hz* is the greatest rate at which a topic crosses a link [between computers](../how-to/three-computers.md).

*May read* and *may request* name who may do so from another computer with [keys](../how-to/keys.md#who-may-what): a
viewer is everybody of the team, a pilot who flies, a service one of the vehicle's own.

```mermaid
{mermaid(actions)}
```

## Topics

{table(topic_rows(actions))}

## Endpoints

{table(endpoint_rows(actions))}

## Services

{table(service_rows(actions))}
"""
