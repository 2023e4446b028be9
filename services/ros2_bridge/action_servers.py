"""The vehicle's actions as action servers of ROS: each goal becomes a goal of jezero's client, by whose rules it flies.

ROS rejects a goal without a word, so that the reason goes to the topic `refusals`.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from jezero.client.actions import described
from jezero.client.errors import Canceled, EndedError, JezeroError, TimedOut
from jezero.client.goal import Goal
from jezero.client.goal_sender import action_named
from jezero.client.vehicle import Vehicle
from jezero.schemas.rows import Action
from jezero.services.ros2_bridge.fields import ROS_ACTIONS, from_ros, interface_name, to_ros
from jezero.services.ros2_bridge.limits import RequestLimit
from jezero.services.ros2_bridge.messages import fill, message_class

POLL_S = 0.1
"""Longest time until a request to cancel a goal is noticed."""
FLY_ACTION = "fly_action"
"""Action for every action of jezero, with fields as JSON."""
Refuse = Callable[[str, str], None]
"""Publishes what was refused, and why."""


@dataclass(frozen=True)
class Conversion:
    """How goals, feedback and results of one action server are converted.

    Attributes:
        send: sends a goal of ROS to the vehicle; raises the errors of `Vehicle.send`.
        feedback: fields in ROS of a feedback.
        result: fields in ROS of a result.
    """

    send: Callable[[Any], Goal[Any, Any]]
    feedback: Callable[[Any], Mapping[str, Any]]
    result: Callable[[Any], Mapping[str, Any]]


def serve_actions(node: Node, uav: Vehicle, limit: RequestLimit, refuse: Refuse, is_ending: Callable[[], bool]) -> None:
    """Make an action server for each action of `ROS_ACTIONS`, and one for any action.

    Args:
        limit: of the goals that reach the vehicle.
        is_ending: whether the bridge is about to end: then its clients get the result `lost`, and goals fly on.

    Raises:
        MissingTypesError: jezero_interfaces is not in this ROS environment.
    """
    for name, action in ROS_ACTIONS.items():
        _Server(node, name, _conversion(uav, action), limit, refuse, is_ending)
    any_action = Conversion(
        lambda goal: _send_any(uav, goal.action, goal.goal_json),
        lambda feedback: {"feedback_json": _json(feedback)},
        lambda result: {"result_json": _json(result)},
    )
    _Server(node, FLY_ACTION, any_action, limit, refuse, is_ending)


def _conversion(uav: Vehicle, action: Action[Any]) -> Conversion:
    return Conversion(lambda goal: uav.send(action, **from_ros(action.goal_type, goal)), to_ros, to_ros)


def _send_any(uav: Vehicle, name: str, goal_json: str) -> Goal[Any, Any]:
    """Send a goal to an action by its name, also to one that only the stack has installed."""
    try:
        fields = msgspec.json.decode(goal_json or "{}", type=dict[str, Any])
    except msgspec.DecodeError as error:
        raise ValueError(f"goal_json is not a JSON object: {error}") from None
    try:
        action = action_named(name)
    except ValueError:
        found = {description.name: description for description in uav.actions.descriptions()}
        if name not in found:
            raise
        action = described(found[name])
    return uav.send(action, **fields)


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()


class _Server:
    """One action server.

    Args:
        name: of the action in ROS, below the vehicle's namespace; its type follows from it.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        conversion: Conversion,
        limit: RequestLimit,
        refuse: Refuse,
        is_ending: Callable[[], bool],
    ) -> None:
        self._name, self._conversion, self._refuse, self._is_ending = name, conversion, refuse, is_ending
        self._limit = limit
        self._type = message_class(f"jezero_interfaces/action/{interface_name(name)}")
        self._accepted: dict[int, Goal[Any, Any]] = {}
        """Goals that fly already, by the identity of their request: rclpy passes that on to `_execute`."""
        ActionServer(
            node,
            self._type,
            name,
            self._execute,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=self._on_goal,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
        )

    def _on_goal(self, request: Any) -> GoalResponse:
        if reason := self._limit.refusal(time.monotonic()):
            self._refuse(self._name, reason)
            return GoalResponse.REJECT
        try:
            goal = self._conversion.send(request)
        except (JezeroError, ValueError) as error:
            self._refuse(self._name, str(error))
            return GoalResponse.REJECT
        self._accepted[id(request)] = goal
        return GoalResponse.ACCEPT

    def _execute(self, handle: ServerGoalHandle) -> Any:
        """Follow a goal until its end, or until the bridge ends."""
        goal = self._accepted.pop(id(handle.request))
        try:
            self._follow(handle, goal)
            value = goal.result(POLL_S)
        except TimedOut:
            handle.abort()
            return self._result("lost", "the bridge to ROS ends, and the goal may still run", None)
        except EndedError as end:
            is_canceled = isinstance(end, Canceled)
            # Only a goal that a client of ROS has canceled may end as canceled there.
            if is_canceled and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            return self._result("canceled" if is_canceled else "aborted", end.reason, end.result)
        except JezeroError as error:
            handle.abort()
            return self._result("lost", str(error), None)
        handle.succeed()
        return self._result("succeeded", "", value)

    def _follow(self, handle: ServerGoalHandle, goal: Goal[Any, Any]) -> None:
        """Publish the goal's feedback until it ends, and cancel it when a client of ROS asks for that."""
        is_canceled = False
        while not self._is_ending():
            if handle.is_cancel_requested and not is_canceled:
                is_canceled = True
                goal.cancel()
            try:
                feedback = goal.next_feedback(POLL_S)
            except TimedOut:
                continue
            if feedback is None:
                return
            fields = dict(self._conversion.feedback(feedback))
            fields["remaining_s"] = [] if goal.remaining_s is None else [goal.remaining_s]
            fields["paused"] = goal.paused
            handle.publish_feedback(fill(self._type.Feedback(), fields))

    def _result(self, outcome: str, reason: str, value: Any) -> Any:
        fields = {} if value is None else dict(self._conversion.result(value))
        return fill(self._type.Result(), fields | {"outcome": outcome, "outcome_reason": reason})
