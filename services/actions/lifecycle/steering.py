"""The commands that steer a goal while it is flown: those of its own client, in their order."""

from typing import Any

import msgspec

from jezero.runtime.service import Inbox
from jezero.schemas.commands import VelocityCommand
from jezero.schemas.rows import Action, Topic
from jezero.schemas.units import NS_PER_S

AGE_MAX_S, LEAD_MAX_S = 0.5, 0.3
"""A command is taken up to this age, and with a stamp that is this far ahead: clocks of two computers are mapped."""


class Steering:
    """Takes the commands for one goal.

    Only clients with a pilot's rights can publish them. A command names its goal, so that no forgotten joystick steers
    the next flight, or that of another client.

    Args:
        goal_id: id of the goal.
        topic: that the commands come from.

    Attributes:
        refusal: why the newest command was refused; "" when it was taken.
    """

    def __init__(self, goal_id: str, topic: Topic[VelocityCommand]) -> None:
        self.topic = topic
        self.refusal = ""
        self._goal_id = goal_id
        self._newest: VelocityCommand | None = None

    @classmethod
    def of(cls, goal_id: str, action: Action[Any]) -> "Steering | None":
        """The steering of a goal of an action; None for an action whose goals nobody steers."""
        return None if action.steered_by is None else cls(goal_id, action.steered_by)

    def update(self, t_ns: int, inbox: Inbox) -> None:
        """Take the commands that have come; one that was overtaken by a newer one has no effect."""
        for command in inbox.new(self.topic):
            self.refusal = self._refusal(t_ns, command)
            if not self.refusal and (self._newest is None or command.t_ns >= self._newest.t_ns):
                self._newest = command

    def command(self, behind_ns: int) -> VelocityCommand | None:
        """The newest command; None before the first one.

        Args:
            behind_ns: vehicle time minus the goal's own time, in which the command's time is given.
        """
        if self._newest is None or behind_ns == 0:
            return self._newest
        return msgspec.structs.replace(self._newest, t_ns=max(self._newest.t_ns - behind_ns, 0))

    def _refusal(self, t_ns: int, command: VelocityCommand) -> str:
        age_s = (t_ns - command.t_ns) / NS_PER_S
        if command.goal_id != self._goal_id:
            return f"a velocity command is for goal {command.goal_id}, and {self._goal_id} flies"
        if age_s > AGE_MAX_S:
            return f"a velocity command is {age_s:.1f} s old, more than {AGE_MAX_S:g} s: stamp it with vehicle time"
        if age_s < -LEAD_MAX_S:
            return f"a velocity command is {-age_s:.1f} s ahead of vehicle time: stamp it with vehicle time"
        return ""
