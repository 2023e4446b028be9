"""The packages for ROS 2 fit the bridge; tests/system/ros builds them."""

import re
from collections.abc import Iterator, Mapping
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml

from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.state import Odometry
from jezero.services.ros2_bridge.conversions import Context, vehicle_transforms
from jezero.services.ros2_bridge.rows import ROWS

PACKAGES = Path(__file__).parents[2] / "deploy" / "ros2"
LAYOUT = yaml.safe_load((PACKAGES / "jezero_bringup" / "rviz" / "vehicle.rviz").read_text())["Visualization Manager"]
DISPLAYS = LAYOUT["Displays"]
SUBSCRIBED = [display for display in DISPLAYS if "Topic" in display]
PUBLISHED = {row.name: (row.type, row.quality) for row in ROWS} | {"plan": ("nav_msgs/msg/Path", "latched")}
COMMON = {"Class": str, "Name": str, "Enabled": bool}
QUALITY = {
    "Value": str,
    "Depth": int,
    "History Policy": ("Keep Last", "Keep All", "System Default"),
    "Reliability Policy": ("Best Effort", "Reliable", "System Default"),
    "Durability Policy": ("Transient Local", "Volatile", "System Default"),
}
COLOR = re.compile(r"\d{1,3}; \d{1,3}; \d{1,3}")
COVARIANCE = {"Value": bool, "Position": {"Value": bool}, "Orientation": {"Value": bool}}


class Known(NamedTuple):
    """What RViz knows of a class.

    Attributes:
        message: type of the messages that it subscribes to; "" for none.
        properties: the allowed values of those that the layout sets: a type, a pattern, several values, or children.
    """

    message: str
    properties: Mapping[str, Any]


RVIZ: dict[str, Known] = {
    "Grid": Known("", {"Cell Size": float, "Plane Cell Count": int, "Reference Frame": str}),
    "TF": Known("", {"Show Names": bool, "Marker Scale": float}),
    "Odometry": Known(
        "nav_msgs/msg/Odometry", {"Keep": int, "Shape": {"Value": ("Arrow", "Axes")}, "Covariance": COVARIANCE}
    ),
    "Path": Known("nav_msgs/msg/Path", {"Color": COLOR}),
    "Marker": Known("visualization_msgs/msg/Marker", {}),
    "MarkerArray": Known("visualization_msgs/msg/MarkerArray", {}),
    "PoseWithCovariance": Known(
        "geometry_msgs/msg/PoseWithCovarianceStamped", {"Shape": ("Arrow", "Axes"), "Covariance": COVARIANCE}
    ),
    "Range": Known("sensor_msgs/msg/Range", {}),
    "Image": Known("sensor_msgs/msg/Image", {}),
}
"""Displays of the layout. RViz ignores a property that it does not know without a word. Source: RViz 14 (Jazzy),
`plugins_description.xml` and the displays of rviz_default_plugins, `qos_profile_property.cpp` of rviz_common."""


def mistakes(config: Mapping[str, Any], known: Mapping[str, Any], where: str) -> Iterator[str]:
    """Properties that RViz does not know, or whose value it would not take."""
    for name, value in config.items():
        path = f"{where}/{name}"
        allowed = known.get(name)
        if isinstance(value, dict) and isinstance(allowed, dict):
            yield from mistakes(value, allowed, path)
        elif isinstance(allowed, re.Pattern):
            fits = allowed.fullmatch(value) is not None
            yield from () if fits else (f"{path}: {value}",)
        elif isinstance(allowed, tuple):
            yield from () if value in allowed else (f"{path}: {value}",)
        elif not (type(value) is allowed or (allowed is float and type(value) is int)):
            yield f"{path}: {value}"


@pytest.mark.parametrize("display", DISPLAYS, ids=lambda display: display["Name"])
def test_rviz_knows_each_display_and_its_properties(display: dict[str, Any]) -> None:
    package, kind = display["Class"].split("/")
    assert package == "rviz_default_plugins"
    known = RVIZ[kind]
    assert ("Topic" in display) == bool(known.message)
    assert list(mistakes(display, {**COMMON, **known.properties, "Topic": QUALITY}, display["Name"])) == []


def test_a_property_that_rviz_does_not_know_is_found() -> None:
    wrong = {"Cell Sise": 1, "Cell Size": "1", "Shape": {"Value": "Axis"}, "Keep": 1, "Color": "red"}
    known = {"Cell Size": float, "Shape": {"Value": ("Axes",)}, "Keep": int, "Color": COLOR}
    assert list(mistakes(wrong, known, "")) == ["/Cell Sise: 1", "/Cell Size: 1", "/Shape/Value: Axis", "/Color: red"]


@pytest.mark.parametrize("display", SUBSCRIBED, ids=lambda display: display["Name"])
def test_rviz_subscribes_to_a_topic_of_the_bridge_with_its_type_and_quality_of_service(display: dict[str, Any]) -> None:
    topic = display["Topic"]
    kind, quality = PUBLISHED[topic["Value"].removeprefix("/uav1/")]
    assert kind == RVIZ[display["Class"].split("/")[1]].message
    assert (topic["Reliability Policy"] == "Best Effort") == (quality == "sensor")
    assert (topic["Durability Policy"] == "Transient Local") == (quality == "latched")


def test_rviz_draws_in_frames_that_are_in_tf() -> None:
    here = Odometry(
        t_ns=1,
        epoch_id=1,
        pos_uav_ned_m=(0.0, 0.0, 0.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
    )
    transforms = vehicle_transforms(here, Context("uav1", VehicleConfig())).fields["transforms"]
    frames = {each.fields["header"].fields["frame_id"] for each in transforms}
    assert LAYOUT["Global Options"]["Fixed Frame"] in frames
    assert {display["Reference Frame"] for display in DISPLAYS if "Reference Frame" in display} <= frames


def test_rviz_shows_no_uncertainty_that_nobody_knows() -> None:
    """The bridge says a million for each variance that is unknown; RViz would fill its view with it."""
    for display in SUBSCRIBED:
        if "Covariance" in RVIZ[display["Class"].split("/")[1]].properties:
            covariance = display["Covariance"]
            assert not covariance["Value"] or not covariance["Orientation"]["Value"], display["Name"]


def test_rviz_sends_its_goals_where_the_bridge_expects_them() -> None:
    classes = {f"rviz_default_plugins/{name}" for name in ("MoveCamera", "Select", "SetGoal")}
    assert {tool["Class"] for tool in LAYOUT["Tools"]} == classes
    (tool,) = (tool for tool in LAYOUT["Tools"] if "Topic" in tool)
    assert tool["Class"] == "rviz_default_plugins/SetGoal"
    assert tool["Topic"] == {"Value": "/uav1/goal_pose"}


def test_rviz_looks_from_above() -> None:
    view = LAYOUT["Views"]["Current"]
    known = {"Class": str, "Distance": float, "Pitch": float, "Yaw": float, "Target Frame": ("<Fixed Frame>",)}
    assert view["Class"] == "rviz_default_plugins/Orbit"
    assert list(mistakes(view, known, "")) == []
    assert 0.0 < view["Pitch"] < radians(90.0)
