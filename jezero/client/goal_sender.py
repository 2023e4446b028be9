"""Goals of a client: for any action by its name, also for actions that installed packages add."""

from collections.abc import Mapping
from contextlib import suppress
from itertools import count
from typing import Any, Literal

import msgspec

from jezero.base.mistakes import mistake
from jezero.base.plugins import PluginError, find_action
from jezero.client.errors import Refused, TimedOut, Unreachable
from jezero.client.goal import Goal
from jezero.client.images import ImagesGoal
from jezero.client.session import Connection
from jezero.client.status import REPLY_TIMEOUT_S, request_status
from jezero.client.velocity import VelocityGoal
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import Goal as GoalPayload
from jezero.schemas.rows import Action

OnClientLoss = Literal["continue", "cancel"]
NO_FIELDS: Mapping[str, Any] = {}
PLAN_TIMEOUT_S = 30.0
"""Longest wait for the acceptance of a goal whose path is planned first."""


def action_named(action: str | Action[Any]) -> Action[Any]:
    """The row of the topic table of an action; a row stays as it is.

    Raises:
        ValueError: there is no action of that name, or the package that adds it is broken.
    """
    try:
        return find_action(action) if isinstance(action, str) else action
    except PluginError as error:
        raise ValueError(str(error)) from error


class GoalSender:
    """Sends the goals of one connection, each with an id of its own and the vehicle time at which it was sent."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._numbers = count(1)

    def _common_fields(self, on_client_loss: OnClientLoss) -> dict[str, Any]:
        """Fields of every goal: a new id, and the present vehicle time, after which the goal expires in some seconds.

        The status is requested for that time only if no status, feedback or result has arrived within a second.
        """
        issued_t_ns = self._connection.vehicle_time_ns()
        if issued_t_ns is None:
            with suppress(Unreachable, TimedOut):
                issued_t_ns = request_status(self._connection).t_ns
        return {
            "goal_id": f"{self._connection.client_id}-{next(self._numbers)}",
            "issued_t_ns": issued_t_ns,
            "on_client_loss": on_client_loss,
        }

    def _make(self, action: Action[Any], goal: GoalPayload | None, fields: Mapping[str, Any]) -> GoalPayload:
        """A goal to send, with the fields that every goal carries."""
        if goal is not None:
            if fields or not isinstance(goal, action.goal_type):
                kind = action.goal_type.__name__
                raise ValueError(f"{action.name} takes one {kind}, or its fields as keyword arguments")
            renewed: GoalPayload = msgspec.structs.replace(goal, **self._common_fields(goal.on_client_loss))
            return renewed
        common = self._common_fields(fields.get("on_client_loss", "continue"))
        try:
            made: GoalPayload = msgspec.convert({**fields, **common}, action.goal_type)
        except msgspec.ValidationError as error:
            raise ValueError(f"{action.name}: {mistake(error, action.goal_type)}") from None
        return made

    def send(
        self, action: Action[Any], goal: GoalPayload | None, fields: Mapping[str, Any] = NO_FIELDS
    ) -> Goal[Any, Any]:
        """Send a goal; returns it when it is accepted.

        Args:
            goal: a struct of the action's goal type; or None, with the goal's own `fields`.

        Raises:
            ValueError: the goal doesn't fit the action's type; the message names the field.
        """
        if action.takes_pictures:
            return self.send_for_images(action, goal, fields)
        if action.steered_by is not None:
            return VelocityGoal(self._connection, action, self._make(action, goal, fields), REPLY_TIMEOUT_S)
        return Goal(self._connection, action, self._make(action, goal, fields), REPLY_TIMEOUT_S)

    def send_for_images(
        self, action: Action[Any], goal: GoalPayload | None, fields: Mapping[str, Any] = NO_FIELDS
    ) -> ImagesGoal:
        """Send a goal that takes pictures; returns it when it is planned and accepted. Otherwise as `send`."""
        return ImagesGoal(self._connection, action, self._make(action, goal, fields), PLAN_TIMEOUT_S)

    def plan(self, action: Action[Any], goal: GoalPayload | None, fields: Mapping[str, Any]) -> PlanReply:
        """Request the plan of a goal; arguments as of `send`.

        Raises:
            Refused: the vehicle would refuse the goal now.
            ValueError: the goal doesn't fit the action's type; the message names the field.
        """
        reply: PlanReply = self._connection.request(action.plan, self._make(action, goal, fields), PLAN_TIMEOUT_S)
        if not reply.accepted:
            raise Refused(reply.reason, reply.code, input_missing=reply.input_missing)
        return reply
