"""The actions of a stack, and the goal that is flown, whichever client sent it."""

import time
from contextlib import suppress
from typing import Any

import msgspec

from jezero.base.codec import encode
from jezero.base.plugins import PluginError, find_action
from jezero.base.zenoh_client import FIRST
from jezero.client.errors import Refused, TimedOut
from jezero.client.images import Picture, fetch_picture
from jezero.client.session import Connection, decoder
from jezero.schemas.actions import ActionDescription, Cancel, CancelReply, GetDescription, GetRunning, RunningGoal
from jezero.schemas.commands import Phase
from jezero.schemas.goals import Goal
from jezero.schemas.images import Image
from jezero.schemas.rows import Action

REPLIES_TIMEOUT_S = 1.0
CANCEL_TIMEOUT_S = 3.0


class Actions:
    """The actions of one vehicle's stack, the attribute `Vehicle.actions`. Any thread may use it.

    Actions of packages that only the stack has installed are among them: `described` makes a row of the topic table of
    such an action's description, for `Vehicle.send` and `Vehicle.plan`.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def descriptions(self) -> list[ActionDescription]:
        """The descriptions of all actions whose servers reply, sorted by name; none without a stack."""
        found = self._all("action/*/description", encode(GetDescription()), ActionDescription)
        return sorted(found, key=lambda description: str(description.name))

    def running(self) -> RunningGoal | None:
        """The goal that is flown, with its plan and the images so far; None while none is."""
        found = self._all("action/*/running", encode(GetRunning()), RunningGoal)
        return next((goal for goal in found if goal.goal_id), None)

    def cancel(self, action: str, goal_id: str) -> None:
        """Cancel a goal of any client: the vehicle hovers.

        Raises:
            Refused: the goal has ended already, or the action's server does not know it.
            Unreachable: the action's server does not reply.
            TimedOut: the reply is missing.
        """
        name = f"@action/{action}/cancel"
        arrivals = self._connection.stream(name, encode(Cancel(goal_id=goal_id)), CANCEL_TIMEOUT_S, FIRST)
        reply: CancelReply = decoder(CancelReply)(self._connection.first(arrivals, name, CANCEL_TIMEOUT_S))
        if not reply.canceled:
            raise Refused(reply.reason)

    def picture(self, action: Action[Any], goal_id: str, image: Image) -> Picture:
        """Fetch the pixels of one image of any client's goal; raises the errors of `ImagesGoal.picture`."""
        return fetch_picture(self._connection, action, goal_id, image)

    def _all(self, pattern: str, payload: bytes, kind: Any) -> list[Any]:
        """Replies of all servers with a key of this pattern."""
        read = decoder(kind)
        arrivals = self._connection.stream(pattern, payload, REPLIES_TIMEOUT_S)
        deadline_s, found = time.monotonic() + REPLIES_TIMEOUT_S, []
        with suppress(TimedOut):  # a server that is hung must not hide the others
            while (data := arrivals.take(deadline_s)) is not None:
                found.append(read(data))
        return found


def described(description: ActionDescription) -> Action[Any]:
    """The row of the topic table of an action: the installed one, else one whose goals only the server checks."""
    with suppress(PluginError):
        return find_action(description.name)
    struct = description.goal["$defs"][description.goal["$ref"].rpartition("/")[2]]
    common = {field.name for field in msgspec.structs.fields(Goal)}
    required = struct.get("required", ())
    fields: list[Any] = [
        (name, Any) if name in required else (name, Any, msgspec.UNSET)
        for name in struct["properties"]
        if name not in common
    ]
    goal_type = msgspec.defstruct(
        "DescribedGoal", fields, bases=(Goal,), frozen=True, kw_only=True, forbid_unknown_fields=True
    )
    return Action(description.name, goal_type, dict[str, Any], dict[str, Any], Phase.ACTION)
