"""The layout for Foxglove that the documentation points at."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from jezero.recording.channels import json_schema, keys_without_images
from jezero.recording.viewer_scene import FRD, FRD_TRUE, MAP, MESSAGES, ROVER, ROVER_TRUE, WORLD
from jezero.schemas.topics import CAMERA

LAYOUT = json.loads((Path(__file__).parents[2] / "docs/how-to/foxglove-layout.json").read_text())
CHANNELS = {CAMERA.name, *MESSAGES, *keys_without_images()}
FRAMES = {MAP, WORLD, FRD, "camera", ROVER, FRD_TRUE, ROVER_TRUE}


def values(node: Any, name: str) -> Iterator[Any]:
    """All values with a name, at any depth."""
    if isinstance(node, dict):
        yield from (value for key, value in node.items() if key == name)
        node = list(node.values())
    if isinstance(node, list):
        for each in node:
            yield from values(each, name)


def panels(node: Any) -> set[str]:
    return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])


def test_each_panel_is_shown() -> None:
    assert panels(LAYOUT["layout"]) == LAYOUT["configById"].keys()


def test_it_shows_channels_and_frames_that_recordings_have() -> None:
    shown = {topic for each in values(LAYOUT, "topics") for topic in each}
    shown |= {*values(LAYOUT, "imageTopic"), *values(LAYOUT, "calibrationTopic"), *values(LAYOUT, "followTopic")}
    assert {"viewer/scene", "sensor/camera", "viewer/location"} <= shown <= CHANNELS
    frames = {*values(LAYOUT, "followTf"), *values(LAYOUT, "fixedFrame"), *values(LAYOUT, "frameId")}
    frames |= {name.removeprefix("frame:") for each in values(LAYOUT["configById"], "transforms") for name in each}
    assert frames - {"axisSize", "labelSize"} == FRAMES


@pytest.mark.parametrize("path", [path for each in values(LAYOUT, "paths") for path in values(each, "value")])
def test_each_curve_shows_a_field_of_its_channel(path: str) -> None:
    channel, _, field = path.rpartition(".")
    assert channel in CHANNELS
    name, index = re.fullmatch(r"(\w+)(?:\[(\d)\])?", field).groups()  # type: ignore[union-attr]
    schema = json.loads(json_schema(channel))["properties"][name]
    assert schema["type"] == ("array" if index else "string")
    assert index is None or int(index) < schema["maxItems"]
