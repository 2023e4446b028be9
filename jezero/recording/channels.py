"""The channels of a recording: which topics there are, and the JSON Schema of each topic's messages."""

from functools import cache
from typing import Any

import msgspec

from jezero.plugins import PluginError, load_declaration, plugin_names
from jezero.recording.images import HEADERS
from jezero.recording.images import JSON_SCHEMA as IMAGE_JSON_SCHEMA
from jezero.recording.images import SCHEMA_NAME as IMAGE_SCHEMA_NAME
from jezero.schemas.topics import ACTIONS, CAMERA, TOPICS, Topic, feedback_of, health_of

_HEADERS = Topic(HEADERS, CAMERA.type, CAMERA.rate_hz, CAMERA.writer)
_HEALTH = health_of("").name
_ANY_OBJECT = b'{"type":"object"}'


@cache
def topic_of(name: str) -> Topic[Any] | None:
    """The declared topic of a channel; None for a topic that this version of jezero doesn't know."""
    if name.startswith(_HEALTH):
        return health_of(name.removeprefix(_HEALTH))
    return _topics().get(name)


@cache
def _topics() -> dict[str, Topic[Any]]:
    plugins: list[Topic[Any]] = []
    for name in plugin_names():
        try:
            plugins.append(feedback_of(load_declaration(name).action))
        except PluginError:  # a broken package takes away its own channel only
            continue
    return {topic.name: topic for topic in (*TOPICS, *map(feedback_of, ACTIONS.values()), _HEADERS, *plugins)}


def keys_without_images() -> list[str]:
    """Keys, without `jezero/<vehicle>/`, of everything that is recorded but the camera's images."""
    return [name for name in _topics() if name not in (CAMERA.name, HEADERS)] + [f"{_HEALTH}*"]


def schema_name(name: str) -> str:
    """Name of the schema of a channel's messages, such as `jezero.Odometry`."""
    if name == CAMERA.name:
        return IMAGE_SCHEMA_NAME
    topic = topic_of(name)
    return "jezero.Message" if topic is None else f"jezero.{topic.struct.__name__}"


@cache
def json_schema(name: str) -> bytes:
    """JSON Schema of a channel's messages, without references.

    Viewers such as Foxglove want an object at the top, and the items of an array in `items`.
    """
    if name == CAMERA.name:
        return IMAGE_JSON_SCHEMA
    topic = topic_of(name)
    if topic is None:
        return _ANY_OBJECT
    schema = msgspec.json.schema(topic.type)
    return msgspec.json.encode(_simplified(schema, schema.get("$defs", {})))


def _simplified(node: Any, definitions: dict[str, Any]) -> Any:
    if isinstance(node, list):
        return [_simplified(item, definitions) for item in node]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        return _simplified(definitions[node["$ref"].rpartition("/")[2]], definitions)
    simple = {key: _simplified(value, definitions) for key, value in node.items() if key != "$defs"}
    items = simple.pop("prefixItems", None)
    if items:
        simple["items"] = items[0] if all(item == items[0] for item in items) else {}
    return simple
