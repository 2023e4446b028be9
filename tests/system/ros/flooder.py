"""Floods a bridge from its first line of input until it is killed: `flooder.py NAMESPACE requests|images`.

`requests`: goal poses, goals, services and parameters, as many as the processor gives. Each would do no harm if it came
once: the goals are refused while another one flies, the rest confirms nothing and changes nothing. `images`: a hundred
subscribers. Runs in a ROS environment. Prints a line when it is ready, then how many of each kind were sent and
received, once a second.
"""

import json
import sys
import time
from collections import Counter
from importlib import import_module
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile, ReliabilityPolicy

PoseStamped: Any = import_module("geometry_msgs.msg").PoseStamped
Image: Any = import_module("sensor_msgs.msg").Image
GoTo: Any = import_module("jezero_interfaces.action").GoTo
Kill: Any = import_module("jezero_interfaces.srv").Kill
SUBSCRIBERS = 100
PENDING_MAX = 20
"""Requests of each kind that wait for their responses."""
SHOW_PERIOD_S = 1.0


class Flood:
    def __init__(self, node: Node, namespace: str) -> None:
        self.counts: Counter[str] = Counter()
        self._pending: Counter[str] = Counter()
        self._poses = node.create_publisher(PoseStamped, f"/{namespace}/goal_pose", 10)
        self._go_to = ActionClient(node, GoTo, f"/{namespace}/go_to")
        self._kill = node.create_client(Kill, f"/{namespace}/kill")
        self._parameters = AsyncParameterClient(node, f"/{namespace}/jezero_bridge")
        self._go_to.wait_for_server(60.0)
        self._kill.wait_for_service(60.0)
        self._parameters.wait_for_services(60.0)
        self._pose = PoseStamped()
        self._pose.header.frame_id = f"{namespace}/map"
        self._pose.pose.position.x = 50.0
        self._goal = GoTo.Goal()
        self._goal.target_m.x, self._goal.target_m.z = -50.0, 3.0

    def send(self) -> None:
        """Send one of each kind, but for requests of which too many wait."""
        self._poses.publish(self._pose)
        self.counts["goal_pose"] += 1
        self._ask("go_to", lambda: self._go_to.send_goal_async(self._goal))
        self._ask("kill", lambda: self._kill.call_async(Kill.Request()))
        values = [Parameter("estimator.use_uwb", value=True)]
        self._ask("parameters", lambda: self._parameters.set_parameters(values))

    def _ask(self, kind: str, send: Any) -> None:
        if self._pending[kind] >= PENDING_MAX:
            return
        self._pending[kind] += 1
        self.counts[kind] += 1
        send().add_done_callback(lambda done: self._on_done(kind, done))

    def _on_done(self, kind: str, done: Any) -> None:
        self._pending[kind] -= 1
        self.counts[f"{kind} replied"] += 1
        self.counts[f"{kind} accepted"] += bool(getattr(done.result(), "accepted", False))


def main() -> None:
    namespace, what = sys.argv[1:]
    rclpy.init()
    node = Node("flooder")
    counts: Counter[str] = Counter()
    flood = Flood(node, namespace) if what == "requests" else None
    if flood is None:
        quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

        def on_image(message: Any) -> None:
            counts["images"] += 1

        name = f"/{namespace}/camera/image_raw"
        images = [node.create_subscription(Image, name, on_image, quality) for _ in range(SUBSCRIBERS)]
        while not all(each.get_publisher_count() for each in images):
            rclpy.spin_once(node, timeout_sec=0.1)
        counts["subscribers"] = len(images)
    print("{}", flush=True)
    sys.stdin.readline()
    shown_s = 0.0
    while True:
        if flood is not None:
            flood.send()
        rclpy.spin_once(node, timeout_sec=0.0 if flood is not None else 0.1)
        if time.monotonic() - shown_s > SHOW_PERIOD_S:
            shown_s = time.monotonic()
            print(json.dumps(counts if flood is None else flood.counts), flush=True)


main()
