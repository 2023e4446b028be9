"""A rover of ROS beside the bridge: its odometry goes to `rover_driver`, and jezero's drive commands to it.

Only the rover's own driver has the right to publish `rover/odometry`, so the bridge sends the lines that the driver
reads. They are datagrams, which never wait.
"""

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock as RosClock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from jezero.schemas.commands import RoverCommand
from jezero.services.ros2_bridge.geometry import twist
from jezero.services.ros2_bridge.messages import build, message_class
from jezero.services.ros2_bridge.rover import DriveTwists, RoverReadings

PERIOD_S = 0.1
SILENCE_S = 2.0


@dataclass(frozen=True)
class RoverTopics:
    """Where the rover is in ROS, and how jezero gets its odometry.

    Attributes:
        odometry: topic of its nav_msgs/Odometry; "" for none.
        cmd_vel: topic on which it takes geometry_msgs/Twist; "" for none.
        driver: host and port at which `rover_driver` listens.
        heading_x_rad: as in `RoverReadings`.
    """

    odometry: str
    cmd_vel: str
    driver: tuple[str, int]
    heading_x_rad: float


class RoverBridge:
    """Passes the odometry of a rover on to jezero, and jezero's drive commands to the rover.

    Args:
        refuse: publishes what was refused, and why.
        now_ns: vehicle time; None while it is unknown.
    """

    def __init__(
        self, node: Node, topics: RoverTopics, refuse: Callable[[str, str], None], now_ns: Callable[[], int | None]
    ) -> None:
        self._topics, self._refuse, self._now_ns = topics, refuse, now_ns
        self._readings = RoverReadings(topics.heading_x_rad)
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.setblocking(False)
        self._drive, self._driving = DriveTwists(), threading.Lock()
        self._heard_s = time.monotonic()
        group = MutuallyExclusiveCallbackGroup()
        if topics.odometry:
            # Best effort hears both kinds of publishers.
            quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            kind = message_class("nav_msgs/msg/Odometry")
            node.create_subscription(kind, topics.odometry, self._on_odometry, quality, callback_group=group)
        self._publisher: Any = None
        if topics.cmd_vel:
            self._publisher = node.create_publisher(message_class("geometry_msgs/msg/Twist"), topics.cmd_vel, 10)
        wall = RosClock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD_S, self._on_timer, clock=wall, callback_group=group)

    def _on_odometry(self, message: Any) -> None:
        self._heard_s = time.monotonic()
        vehicle_ns = self._now_ns()
        clocks_ns = (time.time_ns(),) if vehicle_ns is None else (time.time_ns(), vehicle_ns)
        try:
            self._line.sendto(self._readings.line(message, clocks_ns), self._topics.driver)
        except ValueError as error:
            self._say(f"{error}; it is not passed on")
        except OSError as error:
            host, port = self._topics.driver
            self._say(f"the driver at {host}:{port} can't be reached: {error.strerror or error}")

    def on_command(self, command: RoverCommand) -> None:
        """Pass a drive command of jezero on to the rover; in any thread."""
        with self._driving:
            motion = self._drive.command(command, time.monotonic())
            if motion is not None and self._publisher is not None:
                self._publish(*motion)

    def _publish(self, forward_mps: float, turn_rps: float) -> None:
        self._publisher.publish(build(twist((forward_mps, 0.0, 0.0), (0.0, 0.0, turn_rps))))

    def _on_timer(self) -> None:
        now_s = time.monotonic()
        with self._driving:
            if self._publisher is not None and self._drive.stop(now_s):
                self._publish(0.0, 0.0)
        if self._topics.odometry and now_s - self._heard_s > SILENCE_S:
            self._say(f"nothing comes on {self._topics.odometry}: does the rover publish nav_msgs/Odometry there?")

    def _say(self, reason: str) -> None:
        self._refuse(f"rover odometry {self._topics.odometry}", reason)
