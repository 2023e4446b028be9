"""A client of ROS that does what it reads: one JSON object a line, in a ROS environment; it prints events likewise.

`{"do": "send", "type": "jezero_interfaces/action/GoTo", "name": "/uav1/go_to", "goal": {...}}`, `cancel` (the last
goal), `call` (a service), `publish`, `stream` (publish again and again, until `release`), `subscribe`, `parameters`
(set them), `get` (one parameter).
"""

import json
import sys
import threading
import time
from functools import partial
from importlib import import_module
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile

SERVER_TIMEOUT_S = 60.0


def class_of(kind: str) -> Any:
    package, folder, name = kind.split("/")
    return getattr(import_module(f"{package}.{folder}"), name)


def plain(value: Any) -> Any:
    """A message as dictionaries, lists and numbers."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, str | int | float | bool):
        return value
    return [plain(each) for each in value]


def filled(message: Any, fields: dict[str, Any]) -> Any:
    """A message with these fields; a list of dictionaries is a sequence of points."""
    for name, value in fields.items():
        if isinstance(value, dict):
            filled(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            point = class_of("geometry_msgs/msg/Point")
            setattr(message, name, [filled(point(), each) for each in value])
        else:
            setattr(message, name, value)
    return message


def show(event: str, **fields: Any) -> None:
    print(json.dumps({"event": event, **fields}), flush=True)


class Actor:
    def __init__(self) -> None:
        self.node = Node("actor")
        self._clients: dict[str, Any] = {}
        self._handle: Any = None
        self._released = threading.Event()

    def send(self, type: str, name: str, goal: dict[str, Any]) -> None:
        kind = class_of(type)
        client = self._clients.setdefault(name, ActionClient(self.node, kind, name))
        if not client.wait_for_server(SERVER_TIMEOUT_S):
            show("accepted", accepted=False, reason=f"there is no {name}")
            return
        sent = client.send_goal_async(filled(kind.Goal(), goal), feedback_callback=self._on_feedback)
        sent.add_done_callback(self._on_accepted)

    def _on_feedback(self, message: Any) -> None:
        show("feedback", feedback=plain(message.feedback))

    def _on_accepted(self, future: Any) -> None:
        self._handle = future.result()
        show("accepted", accepted=self._handle.accepted)
        if self._handle.accepted:
            self._handle.get_result_async().add_done_callback(
                lambda done: show("result", status=done.result().status, result=plain(done.result().result))
            )

    def cancel(self) -> None:
        self._handle.cancel_goal_async().add_done_callback(
            lambda done: show("canceling", count=len(done.result().goals_canceling))
        )

    def call(self, type: str, name: str, request: dict[str, Any]) -> None:
        kind = class_of(type)
        client = self._clients.setdefault(name, self.node.create_client(kind, name))
        if not client.wait_for_service(SERVER_TIMEOUT_S):
            show("response", response={"success": False, "message": f"there is no {name}"})
            return
        client.call_async(filled(kind.Request(), request)).add_done_callback(
            lambda done: show("response", response=plain(done.result()))
        )

    def publish(self, type: str, name: str, message: dict[str, Any]) -> None:
        kind = class_of(type)
        publisher = self._clients.setdefault(name, self.node.create_publisher(kind, name, 1))
        publisher.publish(filled(kind(), message))

    def stream(self, type: str, name: str, message: dict[str, Any]) -> None:
        """Publish a message twenty times a second, in a thread."""
        kind = class_of(type)
        publisher = self.node.create_publisher(kind, name, 1)
        self._released.clear()

        def run() -> None:
            while not self._released.wait(0.05):
                publisher.publish(filled(kind(), message))
            self.node.destroy_publisher(publisher)
            show("released")

        threading.Thread(target=run, daemon=True).start()

    def release(self) -> None:
        self._released.set()

    def subscribe(self, type: str, name: str, latched: bool = False) -> None:
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=100, durability=durability)
        on_message = partial(self._on_message, name)
        subscription = self.node.create_subscription(class_of(type), name, on_message, quality)
        self._clients[f"{name} in"] = subscription
        deadline_s = time.monotonic() + SERVER_TIMEOUT_S
        while not subscription.get_publisher_count() and time.monotonic() < deadline_s:
            time.sleep(0.05)

    def _on_message(self, name: str, message: Any) -> None:
        show(name, message=plain(message))

    def parameters(self, node: str, values: dict[str, Any]) -> None:
        client = AsyncParameterClient(self.node, node)
        if not client.wait_for_services(SERVER_TIMEOUT_S):
            show("set", results=[], reason=f"there is no {node}")
            return
        given = [Parameter(name, value=value) for name, value in values.items()]
        client.set_parameters(given).add_done_callback(lambda done: show("set", results=plain(done.result().results)))

    def get(self, node: str, name: str) -> None:
        client = AsyncParameterClient(self.node, node)
        client.get_parameters([name]).add_done_callback(lambda done: show("value", values=plain(done.result().values)))


def main() -> None:
    rclpy.init()
    actor = Actor()
    threading.Thread(target=rclpy.spin, args=(actor.node,), daemon=True).start()
    show("ready")
    for line in sys.stdin:
        words = json.loads(line)
        getattr(actor, words.pop("do"))(**words)
    rclpy.try_shutdown()


main()
