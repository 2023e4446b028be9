"""Services, parameters and the topic `goal_pose` of the bridge: requests from ROS to the vehicle."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from msgspec.structs import replace
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from jezero.base.frames import add, ned_from_enu, yaw_from_quat
from jezero.client.errors import JezeroError
from jezero.client.goal import Goal
from jezero.client.vehicle import Vehicle
from jezero.schemas.estimate import SetParameters
from jezero.schemas.topics import SET_PARAMETERS
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.exact import to_exact, type_name
from jezero.services.ros2_bridge.fields import POINT, RosField, ros_fields
from jezero.services.ros2_bridge.geometry import attitude
from jezero.services.ros2_bridge.limits import POSE_PERIOD_S, RequestLimit
from jezero.services.ros2_bridge.messages import MissingTypesError, build, message_class, quality_of
from jezero.services.ros2_bridge.rows import ABORT, HOVER, KILL, RETURN_HOME, RosService, exact_name

Refuse = Callable[[str, str], None]
"""Publishes what was refused, and why."""
FOLLOW_PERIOD_S = 1.0
PREFIX = "estimator."
"""Begins the names of the estimator's parameters."""


class _Point(NamedTuple):
    """A parameter that is a position."""

    x: float
    y: float
    z: float


def serve_requests(node: Node, uav: Vehicle, limit: RequestLimit) -> None:
    """Make the services `hover`, `abort` and `return_home`.

    Args:
        limit: of the goals that reach the vehicle; services that end a goal have limits of their own.
    """

    def hover(request: Any) -> str:
        uav.hover()
        return "the vehicle hovers"

    def abort(request: Any) -> str:
        return "the vehicle hovers" if uav.abort("a client of ROS asked for it").hovering else "the goal has ended"

    def return_home(request: Any) -> str:
        return f"goal {uav.return_home().goal_id} flies home"

    _serve(node, HOVER, hover, RequestLimit())
    _serve(node, ABORT, abort, RequestLimit())
    _serve(node, RETURN_HOME, return_home, limit)


def serve_kill(node: Node, uav: Vehicle) -> None:
    """Make the service `kill`.

    Raises:
        MissingTypesError: jezero_interfaces is not in this ROS environment.
    """

    def kill(request: Any) -> str:
        uav.kill(confirm=request.confirm, vehicle=request.vehicle)
        return "the motors are off"

    _serve(node, KILL, kill, RequestLimit())


def _serve(node: Node, service: RosService, ask: Callable[[Any], str], limit: RequestLimit) -> None:
    """Make a service whose response is a success with a sentence, or a failure with its reason."""

    def on_request(request: Any, response: Any) -> Any:
        if reason := limit.refusal(time.monotonic()):
            response.message, response.success = reason, False
            return response
        try:
            response.message = ask(request)
            response.success = True
        except JezeroError as error:
            response.message, response.success = str(error), False
        return response

    node.create_service(message_class(service.type), service.name, on_request, callback_group=ReentrantCallbackGroup())


class EstimatorParameters:
    """The estimator's parameters as parameters of the node, which follow changes that others make.

    Bags get them as whole messages, one for each change that is seen.

    Args:
        context: has the newest version of the parameters.
        limit: of the changes that reach the vehicle.

    Raises:
        JezeroError: the estimator does not reply.
    """

    def __init__(self, node: Node, uav: Vehicle, context: Context, limit: RequestLimit) -> None:
        self._node, self._uav, self._context, self._limit = node, uav, context, limit
        self._version = context.parameters_version
        self._follower: int | None = None
        """Thread that sets the node's parameters to what the estimator has already."""
        self._fields = {PREFIX + field.name: field for field in ros_fields(SetParameters)}
        self._publisher: Any = None
        with suppress(MissingTypesError):  # without jezero_interfaces there are no whole messages
            kind = message_class(type_name(SetParameters))
            self._publisher = node.create_publisher(kind, exact_name(SET_PARAMETERS), quality_of("latched"))
        self._published = SetParameters()
        values = uav.estimator_parameters()
        self._publish(values)
        for name, field in self._fields.items():
            node.declare_parameter(name, _parameter_value(field, getattr(values, field.source)))
        node.add_on_set_parameters_callback(self._on_set)
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(FOLLOW_PERIOD_S, self._follow, clock=wall, callback_group=MutuallyExclusiveCallbackGroup())

    def _follow(self) -> None:
        """Take over what others have changed."""
        version = self._context.parameters_version
        if version == self._version:
            return
        try:
            values = self._uav.estimator_parameters()
        except JezeroError:
            return
        self._publish(values)
        found = {name: _parameter_value(field, getattr(values, field.source)) for name, field in self._fields.items()}
        self._follower = threading.get_ident()
        self._node.set_parameters(
            [Parameter(name, value=value) for name, value in found.items() if value is not Parameter.Type.DOUBLE_ARRAY]
        )
        self._follower, self._version = None, version

    def _publish(self, values: SetParameters) -> None:
        """Publish all parameters, but for a prior position that is an old one: it would restart the filter."""
        if self._publisher is not None:
            is_old = values.pos_rover_ned_m == self._published.pos_rover_ned_m
            self._publisher.publish(build(to_exact(replace(values, pos_rover_ned_m=None) if is_old else values)))
            self._published = values

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        """Set the estimator's parameters among those that are set, all or none."""
        if threading.get_ident() == self._follower:
            return SetParametersResult(successful=True)
        given = {self._fields[p.name]: p.value for p in parameters if p.name in self._fields}
        if given and (reason := self._limit.refusal(time.monotonic())):
            return SetParametersResult(successful=False, reason=reason)
        try:
            if given:
                values = {field.source: _value(field, value) for field, value in given.items()}
                self._uav.set_estimator_parameters(**values)
        except (JezeroError, ValueError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _parameter_value(field: RosField, value: Any) -> Any:
    if field.rule.type != POINT:
        return value
    if value is None:
        return Parameter.Type.DOUBLE_ARRAY
    return list(field.rule.to_ros(value).fields.values())


def _value(field: RosField, value: Any) -> Any:
    """Value of a parameter in jezero.

    Raises:
        ValueError: a position has not three numbers.
    """
    if field.rule.type != POINT:
        return value
    if len(value) != 3:
        raise ValueError(f"{PREFIX}{field.name} has {len(value)} numbers: expected east, north and up")
    return field.rule.from_ros(_Point(*value))


class GoalPose:
    """Flies to the pose of each message on `goal_pose`, as RViz publishes it.

    A pose without a height, as RViz draws it, keeps the present height; one without an orientation the heading. A pose
    that arrives during the flight to the last one changes the target of that flight. Of poses that arrive faster than
    they are flown to, the newest is taken: the subscription keeps only that one until this thread is ready.
    """

    def __init__(self, node: Node, uav: Vehicle, context: Context, refuse: Refuse) -> None:
        self._uav, self._context, self._refuse = uav, context, refuse
        self._goal: Goal[Any, Any] | None = None
        kind = message_class("geometry_msgs/msg/PoseStamped")
        node.create_subscription(kind, "goal_pose", self._on_pose, 1, callback_group=MutuallyExclusiveCallbackGroup())

    def _on_pose(self, message: Any) -> None:
        frame = self._context.frame("map")
        try:
            if message.header.frame_id != frame:
                raise ValueError(f"its frame is {message.header.frame_id!r}: expected {frame}")
            self._fly(message.pose)
        except (JezeroError, ValueError) as error:
            self._refuse("goal_pose", str(error))
        time.sleep(POSE_PERIOD_S)

    def _fly(self, pose: Any) -> None:
        at, q = pose.position, pose.orientation
        # The pose is that of `base_link`, which is above the position that jezero's goals have.
        below_m = (0.0, 0.0, self._context.config.airframe.height_stand_m)
        target_ned_m = add(ned_from_enu((at.x, at.y, at.z)), below_m)
        if at.z == 0.0:
            target_ned_m = (*target_ned_m[:2], self._uav.odometry().pos_uav_ned_m[2])
        yaw_rad = None
        if any((q.x, q.y, q.z)) or q.w:
            yaw_rad = yaw_from_quat(attitude(q))
        if self._goal is not None and self._uav.status().goal_id == self._goal.goal_id:
            self._goal.modify(target_ned_m=target_ned_m, yaw_rad=yaw_rad)
        else:
            self._goal = self._uav.go_to(*target_ned_m, yaw_rad=yaw_rad)
