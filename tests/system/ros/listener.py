"""Prints messages of ROS topics as JSON lines: `listener.py SECONDS RELIABILITY TYPE=TOPIC...` in a ROS environment.

It listens for SECONDS, and longer until each topic has been heard, at most LISTEN_MAX_S: a busy machine needs a while
to make connections.
"""

import json
import sys
import time
from functools import partial
from importlib import import_module
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LISTEN_MAX_S = 90.0
LATCHED = ("path", "fence")
"""Parts of the names of latched topics: a subscriber that comes late gets their last message."""


def plain(value: Any) -> Any:
    """A message as dictionaries, lists and numbers; bytes and arrays as lists."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, str | int | float | bool):
        return value
    return [plain(each) for each in value[:100]]


def show(silent: set[str], topic: str, message: Any) -> None:
    silent.discard(topic)
    print(json.dumps({"topic": topic, "message": plain(message)}), flush=True)


def main() -> None:
    seconds, reliability, *wanted = sys.argv[1:]
    rclpy.init()
    node = Node("listener")
    silent: set[str] = set()
    for each in wanted:
        kind, topic = each.split("=")
        package, _, name = kind.split("/")
        quality = QoSProfile(
            depth=50,
            reliability=ReliabilityPolicy[reliability],
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if any(name in topic for name in LATCHED)
            else DurabilityPolicy.VOLATILE,
        )
        silent.add(topic)
        message_class = getattr(import_module(f"{package}.msg"), name)
        node.create_subscription(message_class, topic, partial(show, silent, topic), quality)
    print(json.dumps({"topic": "", "message": "listens"}), flush=True)
    begin_s = time.monotonic()
    while (listened_s := time.monotonic() - begin_s) < float(seconds) or (silent and listened_s < LISTEN_MAX_S):
        rclpy.spin_once(node, timeout_sec=0.1)


main()
