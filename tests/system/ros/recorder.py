"""Prints what arrives on topics of ROS as it is: `recorder.py TYPE=TOPIC[=latched]...`, until its input is closed.

Runs in a ROS environment. A line is a JSON object with topic, the time of arrival by the clock of the wall, and the
message in CDR, base64.
"""

import base64
import json
import sys
import threading
import time
from functools import partial
from importlib import import_module

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile


def show(topic: str, data: bytes) -> None:
    print(json.dumps({"topic": topic, "t_ns": time.time_ns(), "data": base64.b64encode(data).decode()}), flush=True)


def main() -> None:
    rclpy.init()
    node = Node("recorder")
    for each in sys.argv[1:]:
        kind, topic, *latched = each.split("=")
        package, _, name = kind.split("/")
        message_class = getattr(import_module(f"{package}.msg"), name)
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=100, durability=durability)
        node.create_subscription(message_class, topic, partial(show, topic), quality, raw=True)
    closed = threading.Event()

    def wait_for_end() -> None:
        sys.stdin.read()
        closed.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    while not closed.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)


main()
