"""Prints what arrives on topics of ROS as it is: `recorder.py SECONDS TYPE=TOPIC...`, in a ROS environment.

A line is a JSON object with topic, the time of arrival by the clock of the wall, and the message in CDR, base64.
"""

import base64
import json
import sys
import time
from functools import partial
from importlib import import_module

import rclpy
from rclpy.node import Node


def show(topic: str, data: bytes) -> None:
    print(json.dumps({"topic": topic, "t_ns": time.time_ns(), "data": base64.b64encode(data).decode()}), flush=True)


def main() -> None:
    seconds, *wanted = sys.argv[1:]
    rclpy.init()
    node = Node("recorder")
    for each in wanted:
        kind, topic = each.split("=")
        package, _, name = kind.split("/")
        message_class = getattr(import_module(f"{package}.msg"), name)
        node.create_subscription(message_class, topic, partial(show, topic), 100, raw=True)
    end_s = time.monotonic() + float(seconds)
    while time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.1)


main()
