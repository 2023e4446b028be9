"""Foxglove's messages and schemas: against Foxglove's own library, and the rules of its reader of JSON Schema."""

import json
from typing import Any

import msgspec
import pytest

from jezero.recording import foxglove
from jezero.recording.channels import json_schema, keys_without_images
from jezero.recording.images import HEADERS
from jezero.recording.viewer_scene import MESSAGES
from jezero.schemas.topics import CAMERA

STRUCTS = [each for each in vars(foxglove).values() if isinstance(each, type) and issubclass(each, msgspec.Struct)]
CHANNELS = [CAMERA.name, HEADERS, *MESSAGES, *(key for key in keys_without_images() if "*" not in key), "health/camera"]


@pytest.mark.parametrize("struct", STRUCTS, ids=lambda struct: str(struct.__name__))
def test_each_message_has_fields_of_foxgloves_message_of_the_same_name(struct: type[msgspec.Struct]) -> None:
    messages = pytest.importorskip("foxglove.messages")
    name = {"Time": "Timestamp"}.get(struct.__name__, struct.__name__)
    signature = getattr(messages, name).__text_signature__
    fields = {word.split("=")[0].strip(" *()") for word in signature.split(",")}
    assert set(struct.__struct_fields__) <= fields


@pytest.mark.parametrize("channel", CHANNELS)
def test_foxglove_reads_each_schema(channel: str) -> None:
    read(json.loads(json_schema(channel)))


def read(schema: dict[str, Any]) -> None:
    """Read a schema as Foxglove's parser does, which raises for what it doesn't know, and then shows no message.

    Source: `parseJsonSchema` of the last open version of Foxglove, which Lichtblick goes on with.
    """
    assert schema["type"] == "object"
    for field in schema["properties"].values():
        value = field["items"] if field["type"] == "array" else field
        if value["type"] == "object":
            read(value)
        else:
            assert value["type"] in ("boolean", "string", "number", "integer")
            assert value.get("contentEncoding") in ((None, "base64") if value is field else (None,))


def test_an_optional_field_has_the_schema_of_its_value() -> None:
    fields = json.loads(json_schema("status"))["properties"]
    assert fields["odometry"]["properties"]["pos_uav_ned_m"]["items"]["type"] == "number"
    assert fields["battery"]["properties"]["remaining"]["type"] == "number"


def test_a_field_that_foxglove_cannot_describe_is_left_out_of_the_schema() -> None:
    corners = json.loads(json_schema("sensor/tag_corners"))["properties"]["tags"]["items"]
    assert corners["properties"].keys() == {"tag_id"}
    assert "additionalProperties" not in corners


def test_times_are_split_into_seconds_and_nanoseconds() -> None:
    assert foxglove.time_of(3_000_000_007) == foxglove.Time(3, 7)


def test_viewers_know_a_message_by_the_name_of_its_schema() -> None:
    assert foxglove.schema_name(foxglove.SceneUpdate) == "foxglove.SceneUpdate"
    assert json.loads(json_schema("viewer/scene"))["title"] == "foxglove.SceneUpdate"
