"""The bridge as a ROS node: publishes what the vehicle publishes, and passes requests of ROS on. Imports rclpy.

Each topic of jezero has a thread of its own, which waits for messages, converts them and publishes them: a subscriber
in ROS that is slow or stuck delays nobody. Images are large, and fetched only while somebody subscribes to them.
"""

import os
import signal
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock as RosClock
from rclpy.clock_type import ClockType
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.client.errors import JezeroError, Unreachable
from jezero.client.subscription import Subscription
from jezero.client.vehicle import Vehicle
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.state import Clock, Status
from jezero.schemas.units import NS_PER_S
from jezero.services.ros2_bridge import conversions
from jezero.services.ros2_bridge.action_servers import serve_actions
from jezero.services.ros2_bridge.cmd_vel import CmdVel
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.geometry import RosMessage
from jezero.services.ros2_bridge.limits import Announcements, RequestLimit
from jezero.services.ros2_bridge.messages import MissingTypesError, build, message_class, quality_of
from jezero.services.ros2_bridge.requests import EstimatorParameters, GoalPose, serve_kill, serve_requests
from jezero.services.ros2_bridge.rover_node import RoverBridge, RoverTopics
from jezero.services.ros2_bridge.rows import ROWS, TF, Quality, RosTopic, ros_name, sources

CLOCK_HZ = 100.0
CLOCK_AHEAD_MAX_NS = NS_PER_S // 5
"""Vehicle time is not guessed for longer than this after the last clock: then its master stands still."""
DEMAND_PERIOD_S = 0.5
SPIN_S = 0.2
END_S = 1.0
"""Time in which clients of ROS get their last results."""
THREADS = 12
"""A goal in flight keeps one, and a request until the vehicle replies."""

FASTDDS_PROFILES, FASTRTPS_PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Variables that name FastDDS's settings, in its version 3 and in version 2, which Jazzy has."""
FASTDDS_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"


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
        time: vehicle time between two clocks.
    """

    def __init__(self, node: Node, uav: Vehicle, context: Context, *, uses_clock: bool = True) -> None:
        self._node, self._uav, self._context = node, uav, context
        self.invalid = 0
        self.time = VehicleTime()
        self._publishers: dict[tuple[str, str], Any] = {}
        self._rows: dict[str, list[RosTopic]] = {}
        self._images: Subscription[Any] | None = None
        self._planned = ""
        self._missing: set[str] = set()
        """Packages of types that the environment lacks."""
        for row in ROWS:
            if self._publisher(row.name, row.type, row.quality) is not None:
                self._rows.setdefault(row.source.name, []).append(row)
        if (static := self._publisher("/tf_static", TF, "latched")) is not None:
            static.publish(build(conversions.static_transforms(context, 0)))
        context.prior_of = self._prior_of
        self._plan = self._publisher("plan", "nav_msgs/msg/Path", "latched")
        self._clock = self._publisher("/clock", "rosgraph_msgs/msg/Clock", "sensor") if uses_clock else None
        for source in sources():
            if source is not topics.CAMERA:
                self._follow(source, partial(self._on_message, source.name))
        self._follow(topics.CLOCK, self.time.on_clock)
        wall = RosClock(clock_type=ClockType.STEADY_TIME)
        # Groups of their own: a request on the node's parameters may wait for the vehicle.
        own = MutuallyExclusiveCallbackGroup
        node.create_timer(DEMAND_PERIOD_S, self._follow_demand, clock=wall, callback_group=own())
        if self._clock is not None:
            node.create_timer(1.0 / CLOCK_HZ, self._publish_clock, clock=wall, callback_group=own())

    def _publisher(self, name: str, kind: str, quality: Quality) -> Any:
        """The publisher of a topic; None where the environment lacks its type, which is said once."""
        if (name, kind) not in self._publishers:
            try:
                made = self._node.create_publisher(message_class(kind), name, quality_of(quality))
            except MissingTypesError as error:
                if error.package not in self._missing:
                    self._missing.add(error.package)
                    self._node.get_logger().warning(f"{name} and all else of {error.package} is left out: {error}")
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

    def _prior_of(self, goal_id: str) -> Vec3 | None:
        """The rover's position with which a goal's lease began. Estimates don't contain it."""
        try:
            lease = self._uav.estimator_lease()
        except JezeroError:
            return None
        return None if lease is None or lease.goal_id != goal_id else lease.pos_rover_ned_m

    def _publish_clock(self) -> None:
        t_ns = self.time.now_ns()
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


def serve(
    node: Node,
    uav: Vehicle,
    context: Context,
    is_ending: Callable[[], bool],
    now_ns: Callable[[], int | None],
    *,
    commands: bool,
    rover: RoverTopics | None,
) -> None:
    """Make what clients of ROS request: actions, services, parameters, and the topic `goal_pose`.

    What this ROS environment or the vehicle lacks is left out, which is logged in one sentence.

    Args:
        is_ending: whether the bridge is about to end.
        now_ns: vehicle time; None while it is unknown.
        commands: whether messages on `goal_pose` and `cmd_vel` fly the vehicle.
        rover: the rover in ROS; None for none.
    """
    log = node.get_logger()
    refusals = node.create_publisher(message_class("std_msgs/msg/String"), "refusals", quality_of("state"))

    announcements = Announcements()

    def refuse(what: str, reason: str) -> None:
        if not announcements.is_due(what, reason, time.monotonic()):
            return
        log.warning(f"{what} was refused: {reason}")
        refusals.publish(build(RosMessage("std_msgs/msg/String", {"data": f"{what}: {reason}"})))

    limit = RequestLimit()
    serve_requests(node, uav, limit)
    try:
        serve_kill(node, uav)
        serve_actions(node, uav, limit, refuse, is_ending)
    except MissingTypesError as error:
        log.warning(f"actions and the service kill are left out: {error} (deploy/ros2 of jezero)")
    try:
        EstimatorParameters(node, uav, context, limit)
    except JezeroError as error:
        log.warning(f"the estimator's parameters are left out: {error}")
    if commands:
        GoalPose(node, uav, context, refuse)
        CmdVel(node, uav, context, refuse, now_ns)
    if rover is not None:
        passed_on = RoverBridge(node, rover, refuse, now_ns)
        uav.subscribe(topics.ROVER_COMMAND, passed_on.on_command)


def _make_room_for_images() -> None:
    """Let FastDDS pass images through shared memory, unless the user has chosen its settings."""
    if not any(name in os.environ for name in (FASTDDS_PROFILES, FASTRTPS_PROFILES, FASTDDS_TRANSPORTS)):
        variable = FASTRTPS_PROFILES if os.environ.get("ROS_DISTRO") == "jazzy" else FASTDDS_PROFILES
        os.environ[variable] = str(Path(__file__).with_name("fastdds.xml"))


def run_bridge(
    uav: Vehicle,
    vehicle: str,
    config: VehicleConfig,
    *,
    uses_clock: bool,
    commands: bool,
    rover: RoverTopics | None,
) -> None:
    """Run the bridge until Ctrl+C or SIGTERM.

    Args:
        uav: the connection to the vehicle.
        vehicle: its name.
        config: its dimensions.
        uses_clock: whether `/clock` is published.
        commands: as in `serve`.
        rover: as in `serve`.
    """
    ending = threading.Event()
    _make_room_for_images()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: ending.set())
    name = ros_name(vehicle)
    node = Node("jezero_bridge", namespace=name)
    context = Context(name, config)
    executor = MultiThreadedExecutor(THREADS)
    executor.add_node(node)
    try:
        bridge = Bridge(node, uav, context, uses_clock=uses_clock)
        serve(node, uav, context, ending.is_set, bridge.time.now_ns, commands=commands, rover=rover)
        node.get_logger().info(f"{vehicle} is in /{name}")
        while not ending.is_set():
            executor.spin_once(SPIN_S)
        end_s = time.monotonic() + END_S
        while time.monotonic() < end_s:
            executor.spin_once(SPIN_S)
    finally:
        rclpy.try_shutdown()
