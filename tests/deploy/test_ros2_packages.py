"""The packages for ROS 2 fit the bridge; tests/system/ros builds them."""

import re
from pathlib import Path
from typing import Any

import click
import pytest
import yaml

from jezero.cli.ros2 import bridge
from jezero.services.ros2_bridge.rows import ROWS

PACKAGES = Path(__file__).parents[2] / "deploy" / "ros2"
LAYOUT = yaml.safe_load((PACKAGES / "jezero_bringup" / "rviz" / "vehicle.rviz").read_text())["Visualization Manager"]
DISPLAYS = [display for display in LAYOUT["Displays"] if "Topic" in display]
QUALITIES = {row.name: row.quality for row in ROWS} | {"plan": "latched"}


@pytest.mark.parametrize("display", DISPLAYS, ids=lambda display: display["Name"])
def test_rviz_subscribes_to_a_topic_with_its_quality_of_service(display: dict[str, Any]) -> None:
    topic = display["Topic"]
    quality = QUALITIES[topic["Value"].removeprefix("/uav1/")]
    assert (topic["Reliability Policy"] == "Best Effort") == (quality == "sensor")
    assert (topic["Durability Policy"] == "Transient Local") == (quality == "latched")


def test_rviz_sends_its_goals_where_the_bridge_expects_them() -> None:
    (tool,) = (tool for tool in LAYOUT["Tools"] if "Topic" in tool)
    assert tool["Topic"]["Value"] == "/uav1/goal_pose"
    assert LAYOUT["Global Options"]["Fixed Frame"] == "uav1/map"


def test_the_launch_file_uses_options_that_the_bridge_has() -> None:
    text = (PACKAGES / "jezero_bringup" / "launch" / "bridge.launch.py").read_text()
    named = set(re.findall(r'"(--[a-z-]+)"', text)) - {"--ros-args"}
    assert isinstance(bridge, click.Command)
    known = {word for option in bridge.params for word in (*option.opts, *option.secondary_opts)}
    assert named == {"--vehicle", "--router", "--commands", "--no-clock"}
    assert named <= known
