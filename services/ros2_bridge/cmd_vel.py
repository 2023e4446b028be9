"""The topic `cmd_vel` of the bridge: velocities from ROS fly the vehicle."""

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock as RosClock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from jezero.client.errors import JezeroError
from jezero.client.vehicle import Vehicle
from jezero.client.velocity import VelocityGoal
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.messages import message_class
from jezero.services.ros2_bridge.velocity import TYPES, Velocity, header_refusal, velocity_from

TOPIC = "cmd_vel"
QUALITY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Best effort hears both kinds of publishers, and the newest command is the only one of use."""
PERIOD_S = 0.1
SILENCE_S = 1.0
"""The goal ends after this time without a message; the vehicle has stopped after half of this time. The next message is
the first one of another stream."""
RELEASE_FIRST = "it flies by the next stream: stop sending for a second, or send a zero once"


class CmdVel:
    """Flies by the twists that are published on `cmd_vel`.

    The first twist of a stream starts a goal of `fly_velocity`, which the vehicle refuses unless it hovers and nothing
    else flies it. A stream ends with a second without messages, or with a zero. It starts one goal only, so that
    nobody's hover or abort is overridden by a stick that is still held.

    Args:
        now_ns: vehicle time; None while it is unknown.
    """

    def __init__(
        self,
        node: Node,
        uav: Vehicle,
        context: Context,
        refuse: Callable[[str, str], None],
        now_ns: Callable[[], int | None],
    ) -> None:
        self._node, self._uav, self._refuse, self._now_ns = node, uav, refuse, now_ns
        self._frames = (context.frame("base_link"), "base_link")
        self._goal: VelocityGoal | None = None
        self._heard_s = -SILENCE_S
        self._has_started = False
        """Whether the present stream has started a goal, or was refused."""
        self._subscription: Any = None
        self._type = ""
        self._group = MutuallyExclusiveCallbackGroup()
        """Messages and the timer share a goal."""
        wall = RosClock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD_S, self._on_timer, clock=wall, callback_group=self._group)

    def _on_timer(self) -> None:
        self._follow_type()
        if time.monotonic() - self._heard_s > SILENCE_S:
            self._has_started = False
            if self._goal is not None:
                self._end_goal(self._goal)

    def _follow_type(self) -> None:
        """Subscribe by the type that is published: a topic of ROS has one type, and both are in use for this one."""
        topic = self._node.resolve_topic_name(TOPIC)
        found = sorted({each.topic_type for each in self._node.get_publishers_info_by_topic(topic)} & {*TYPES})
        if self._type in found or not found:
            return
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription, self._type = None, ""
        on_message = partial(self._on_message, found[0])
        kind = message_class(found[0])
        # The executor keeps the subscription of the other type for a moment, and the topic with its type.
        with suppress(RuntimeError):
            self._subscription = self._node.create_subscription(
                kind, TOPIC, on_message, QUALITY, callback_group=self._group
            )
            self._type = found[0]

    def _on_message(self, kind: str, message: Any) -> None:
        self._heard_s = time.monotonic()
        is_stamped = kind == TYPES[1]
        try:
            if is_stamped and (refusal := header_refusal(message.header, self._frames, self._now_ns())):
                raise ValueError(refusal)
            self._fly(velocity_from(message.twist if is_stamped else message))
        except (JezeroError, ValueError) as error:
            self._refuse(TOPIC, str(error))

    def _fly(self, velocity: Velocity) -> None:
        if self._goal is None:
            if velocity.is_zero:
                self._has_started = False
                return
            if self._has_started:
                return
            self._has_started = True
            try:
                self._goal = self._uav.fly_velocity()
            except JezeroError as error:
                self._refuse(TOPIC, f"{error}; {RELEASE_FIRST}")
                return
        try:
            self._goal.send(velocity.forward_mps, velocity.right_mps, velocity.up_mps, velocity.yaw_rate_rps)
        except JezeroError as error:
            self._goal = None
            self._refuse(TOPIC, f"{error}; {RELEASE_FIRST}")

    def _end_goal(self, goal: VelocityGoal) -> None:
        """Let the vehicle come to rest, which takes some calls; a new message flies on."""
        try:
            if goal.try_finish():
                self._goal = None
        except JezeroError as error:
            self._goal = None
            self._refuse(TOPIC, str(error))
