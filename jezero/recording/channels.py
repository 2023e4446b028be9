"""The channels of a recording: which topics there are, and the JSON Schema of each topic's messages."""

from contextlib import suppress
from functools import cache
from typing import Any

import msgspec

from jezero.base.codec import has_attachment
from jezero.base.plugins import PluginError, load_declaration, plugin_names
from jezero.recording import foxglove, viewer_scene
from jezero.recording.images import HEADERS
from jezero.schemas.rows import Action, Topic
from jezero.schemas.topics import ACTIONS, CAMERA, TOPICS, feedback_of, health_of, journal_of

_HEADERS = Topic(HEADERS, CAMERA.type, CAMERA.rate_hz, CAMERA.writer)
_HEALTH, _JOURNAL = health_of("").name, journal_of("").name
_ANY_OBJECT = b'{"type":"object","properties":{}}'
_FOXGLOVE: dict[str, type[msgspec.Struct]] = {CAMERA.name: foxglove.CompressedImage, **viewer_scene.MESSAGES}
"""Channels with Foxglove's own messages."""


@cache
def topic_of(name: str) -> Topic[Any] | None:
    """The declared topic of a channel; None for a topic that this version of jezero doesn't know."""
    if name.startswith(_HEALTH):
        return health_of(name.removeprefix(_HEALTH))
    if name.startswith(_JOURNAL):
        return journal_of(name.removeprefix(_JOURNAL))
    return _topics().get(name)


@cache
def _topics() -> dict[str, Topic[Any]]:
    return {topic.name: topic for topic in (*TOPICS, *map(feedback_of, usable_actions().values()), _HEADERS)}


@cache
def usable_actions() -> dict[str, Action[Any]]:
    """All actions by name, those of packages included, but for broken ones: these take away their own channel only."""
    actions = dict(ACTIONS)
    for name in plugin_names():
        with suppress(PluginError):
            actions[name] = load_declaration(name).action
    return actions


def keys_without_images() -> list[str]:
    """Keys, without `jezero/<vehicle>/`, of everything that is recorded but the camera's images."""
    return [name for name, topic in _topics().items() if not has_attachment(topic.type)] + [f"{_HEALTH}*"]


def schema_name(name: str) -> str:
    """Name of the schema of a channel's messages, such as `jezero.Odometry`."""
    if name in _FOXGLOVE:
        return foxglove.schema_name(_FOXGLOVE[name])
    topic = topic_of(name)
    return "jezero.Message" if topic is None else f"jezero.{topic.struct.__name__}"


@cache
def json_schema(name: str) -> bytes:
    """JSON Schema of a channel's messages, as viewers read it.

    Foxglove refuses a channel whose schema has references, alternatives, or an array in an array. So an optional field
    has the schema of its value, though it may be null, and fields that can't be described in this way are left out of
    the schema; their values are in the messages all the same.
    """
    if name in _FOXGLOVE:
        schema = foxglove.json_schema(_FOXGLOVE[name])
    else:
        topic = topic_of(name)
        if topic is None:
            return _ANY_OBJECT
        schema = msgspec.json.schema(topic.type)
    return msgspec.json.encode(_simplified(schema, schema.get("$defs", {})))


def _simplified(node: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any] | None:
    """Schema of one value without references and alternatives; None if there is no such schema."""
    while "$ref" in node:
        node = definitions[node["$ref"].rpartition("/")[2]]
    if "anyOf" in node:
        values = [each for each in node["anyOf"] if each.get("type") != "null"]
        return _simplified(values[0], definitions) if len(values) == 1 else None
    if "enum" in node:
        kinds = {type(value) for value in node["enum"]}
        return {**node, "type": "string" if kinds == {str} else "integer"} if kinds in ({str}, {int}) else None
    match node.get("type"):
        case "object":
            fields = {key: _simplified(field, definitions) for key, field in node.get("properties", {}).items()}
            kept = {key: field for key, field in fields.items() if field is not None}
            others = ("$defs", "properties", "additionalProperties")
            return {**{key: value for key, value in node.items() if key not in others}, "properties": kept}
        case "array":
            return _simplified_array(node, definitions)
        case str():
            return node
    return None


def _simplified_array(node: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any] | None:
    items = [_simplified(item, definitions) for item in node.get("prefixItems") or [node.get("items") or {}]]
    first = items[0]
    if first is None or first["type"] == "array":
        return None
    if any(item is None or item["type"] != first["type"] for item in items):
        return None
    kept = {key: value for key, value in node.items() if key != "prefixItems"}
    return {**kept, "items": first if all(item == first for item in items) else {"type": first["type"]}}
