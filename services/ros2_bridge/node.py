"""The bridge as a ROS node: publishes what the vehicle publishes, as ROS 2 has it. Imports rclpy.

Each topic of jezero has a thread of its own, which waits for messages, converts them and publishes them: a subscriber
in ROS that is slow or stuck delays nobody. Images are large, and fetched only while somebody subscribes to them.
"""

import threading
import time
from collections.abc import Callable
from functools import lru_cache, partial
from importlib import import_module
from typing import Any

import rclpy
from rclpy.clock import Clock as RosClock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from jezero.base.vehicle_config import VehicleConfig
from jezero.client.errors import JezeroError, Unreachable
from jezero.client.subscription import Subscription
from jezero.client.vehicle import Vehicle
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.state import Clock, Status
from jezero.schemas.units import NS_PER_S
from jezero.services.ros2_bridge import conversions
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.geometry import RosMessage
from jezero.services.ros2_bridge.rows import DEPTH, ROWS, TF, Quality, Row, ros_name, sources

CLOCK_HZ = 100.0
CLOCK_AHEAD_MAX_NS = NS_PER_S // 5
"""Vehicle time is not guessed for longer than this after the last clock: then its master stands still."""
DEMAND_PERIOD_S = 0.5


class MissingTypesError(Exception):
    """A package of message types isn't there; the text says which one."""


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
        raise MissingTypesError(f"{name} is not in this ROS environment: install the package {package}") from None


def build(message: RosMessage) -> Any:
    """The message of rclpy."""
    ros = message_class(message.type)()
    for name, value in message.fields.items():
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


class VehicleTime:
    """Vehicle time between two clocks, by this computer's monotonic clock."""

    def __init__(self) -> None:
        self._clock: tuple[Clock, int] | None = None
        self._published_ns = -1
        self._epoch_id = 0

    def on_clock(self, clock: Clock) -> None:
        self._clock = (clock, time.monotonic_ns())

    def now_ns(self) -> int | None:
        """Vehicle time, which never goes back within an epoch; None before the first clock."""
        if self._clock is None:
            return None
        clock, arrival_ns = self._clock
        t_ns = clock.t_ns + min(time.monotonic_ns() - arrival_ns, CLOCK_AHEAD_MAX_NS)
        if clock.epoch_id == self._epoch_id:
            t_ns = max(t_ns, self._published_ns)
        self._epoch_id, self._published_ns = clock.epoch_id, t_ns
        return t_ns


class Bridge:
    """Publishes one vehicle in ROS.

    Args:
        node: the ROS node, in the vehicle's namespace.
        uav: the connection to the vehicle.
        context: what conversions need.
        uses_clock: whether `/clock` is published.

    Attributes:
        invalid: number of messages that could not be decoded.
    """

    def __init__(self, node: Node, uav: Vehicle, context: Context, *, uses_clock: bool = True) -> None:
        self._node, self._uav, self._context = node, uav, context
        self.invalid = 0
        self._time = VehicleTime()
        self._publishers: dict[tuple[str, str], Any] = {}
        self._rows: dict[str, list[Row]] = {}
        self._images: Subscription[Any] | None = None
        self._planned = ""
        for row in ROWS:
            if self._publisher(row.name, row.type, row.quality) is not None:
                self._rows.setdefault(row.source.name, []).append(row)
        if (static := self._publisher("/tf_static", TF, "latched")) is not None:
            static.publish(build(conversions.static_transforms(context, 0)))
        self._plan = self._publisher("plan", "nav_msgs/msg/Path", "latched")
        self._clock = self._publisher("/clock", "rosgraph_msgs/msg/Clock", "sensor") if uses_clock else None
        for source in sources():
            if source is not topics.CAMERA:
                self._follow(source, partial(self._on_message, source.name))
        self._follow(topics.CLOCK, self._time.on_clock)
        wall = RosClock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(DEMAND_PERIOD_S, self._follow_demand, clock=wall)
        if self._clock is not None:
            node.create_timer(1.0 / CLOCK_HZ, self._publish_clock, clock=wall)

    def _publisher(self, name: str, kind: str, quality: Quality) -> Any:
        """The publisher of a topic; None where the environment lacks its type, which is said once."""
        if (name, kind) not in self._publishers:
            try:
                made = self._node.create_publisher(message_class(kind), name, quality_of(quality))
            except MissingTypesError as error:
                self._node.get_logger().warning(f"{name} is left out: {error}")
                made = None
            self._publishers[name, kind] = made
        return self._publishers[name, kind]

    def _follow(self, source: Topic[Any], on_message: Callable[[Any], None]) -> Subscription[Any]:
        """Call a function with each message of a topic, in a thread of its own, until the subscription is closed."""
        subscription = self._uav.subscribe(source)

        def run() -> None:
            while True:
                try:
                    message = subscription.next()
                except Unreachable:
                    return
                except JezeroError:
                    self.invalid += 1
                    continue
                if not rclpy.ok():
                    return
                on_message(message)

        threading.Thread(target=run, name=f"jezero {source.name}", daemon=True).start()
        return subscription

    def _on_message(self, source: str, message: Any) -> None:
        self._context.notice(message)
        for row in self._rows.get(source, ()):
            made = row.convert(message, self._context)
            if made is not None:
                self._publishers[row.name, row.type].publish(build(made))
        if isinstance(message, Status) and message.goal_id != self._planned and self._plan is not None:
            self._planned = message.goal_id
            self._publish_plan(message)

    def _publish_clock(self) -> None:
        t_ns = self._time.now_ns()
        if t_ns is not None and self._clock is not None:
            self._clock.publish(build(conversions.clock(t_ns)))

    def _follow_demand(self) -> None:
        """Fetch images while somebody subscribes to them."""
        wanted = any(
            self._publishers[row.name, row.type].get_subscription_count() for row in self._rows[topics.CAMERA.name]
        )
        if wanted and self._images is None:
            self._images = self._follow(topics.CAMERA, partial(self._on_message, topics.CAMERA.name))
        elif not wanted and self._images is not None:
            self._images.close()
            self._images = None

    def _publish_plan(self, status: Status) -> None:
        """Publish the way of the goal in charge; without a goal an empty one."""
        try:
            running = self._uav.actions.running() if status.goal_id else None
        except JezeroError:
            running = None
        way_ned_m = () if running is None else running.path_ned_m
        self._plan.publish(build(conversions.path(status.t_ns, way_ned_m, self._context)))


def run_bridge(uav: Vehicle, vehicle: str, config: VehicleConfig, *, uses_clock: bool) -> None:
    """Run the bridge until Ctrl+C or SIGTERM.

    Args:
        uav: the connection to the vehicle.
        vehicle: its name.
        config: its dimensions.
        uses_clock: whether `/clock` is published.
    """
    rclpy.init()
    name = ros_name(vehicle)
    node = Node("jezero_bridge", namespace=name)
    try:
        Bridge(node, uav, Context(name, config), uses_clock=uses_clock)
        node.get_logger().info(f"{vehicle} is in /{name}")
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
