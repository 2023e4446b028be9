"""Prints messages of ROS topics as JSON lines: `listener.py SECONDS RELIABILITY TYPE=TOPIC...` in a ROS environment."""

import json
import sys
import time
from functools import partial
from importlib import import_module
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def plain(value: Any) -> Any:
    """A message as dictionaries, lists and numbers; bytes and arrays as lists."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, str | int | float | bool):
        return value
    return [plain(each) for each in value[:100]]


def show(topic: str, message: Any) -> None:
    print(json.dumps({"topic": topic, "message": plain(message)}), flush=True)


def main() -> None:
    seconds, reliability, *wanted = sys.argv[1:]
    rclpy.init()
    node = Node("listener")
    for each in wanted:
        kind, topic = each.split("=")
        package, _, name = kind.split("/")
        quality = QoSProfile(
            depth=50,
            reliability=ReliabilityPolicy[reliability],
            durability=DurabilityPolicy.TRANSIENT_LOCAL if "fence" in topic else DurabilityPolicy.VOLATILE,
        )
        message_class = getattr(import_module(f"{package}.msg"), name)
        node.create_subscription(message_class, topic, partial(show, topic), quality)
    print(json.dumps({"topic": "", "message": "listens"}), flush=True)
    end_s = time.monotonic() + float(seconds)
    while time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.1)


main()
