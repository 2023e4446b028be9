"""Messages of rclpy from those that conversions make, their classes, and the quality of service of topics."""

from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from jezero.services.ros2_bridge.geometry import RosMessage
from jezero.services.ros2_bridge.rows import DEPTH, Quality


class MissingTypesError(Exception):
    """A package of message types isn't there; the text says which one.

    Attributes:
        package: the package.
    """

    def __init__(self, name: str, package: str) -> None:
        super().__init__(f"{name} is not in this ROS environment: install the package {package}")
        self.package = package


@lru_cache
def message_class(name: str) -> Any:
    """Class of a message type such as "nav_msgs/msg/Odometry".

    Raises:
        MissingTypesError: its package is not in this ROS environment.
    """
    package, kind, word = name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), word)
    except (ImportError, AttributeError):
        raise MissingTypesError(name, package) from None


def build(message: RosMessage) -> Any:
    """The message of rclpy."""
    return fill(message_class(message.type)(), message.fields)


def fill(ros: Any, fields: Mapping[str, Any]) -> Any:
    """Set fields of a message of rclpy; returns it."""
    for name, value in fields.items():
        setattr(ros, name, _built(value))
    return ros


def _built(value: Any) -> Any:
    if isinstance(value, RosMessage):
        return build(value)
    if isinstance(value, list):
        return [_built(each) for each in value]
    return value


def quality_of(quality: Quality) -> QoSProfile:
    """Quality of service of a topic. Source: REP 2003."""
    return QoSProfile(
        depth=DEPTH[quality],
        reliability=ReliabilityPolicy.BEST_EFFORT if quality == "sensor" else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if quality == "latched" else DurabilityPolicy.VOLATILE,
    )
