"""Feedback of one goal: as replies to those who sent it, and on the action's topic."""

from collections.abc import Iterator
from typing import Any

import msgspec

from jezero.runtime.service import Output, Publish, Reply
from jezero.schemas.actions import Feedback, FeedbackMessage
from jezero.schemas.goals import ImagesFeedback, LandFeedback, MoveFeedback
from jezero.schemas.state import Odometry, Status
from jezero.schemas.topics import feedback_of
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.goal_context import GoalContext
from jezero.services.actions.motion.behaviour import Move, Remaining

FEEDBACK_RATE_HZ = 10.0


class GoalFeedback:
    """Makes and sends the feedback of one goal."""

    def __init__(self, context: GoalContext) -> None:
        self._action = context.action
        self._topic = feedback_of(context.action)
        self._goal_id = context.goal_id
        self._capture = context.plan.capture
        self._watchers = context.watchers
        self._due_ns = 0

    def is_due(self, t_ns: int) -> bool:
        """Whether the period since the last feedback is over."""
        return t_ns >= self._due_ns

    def make(
        self,
        t_ns: int,
        move: Move,
        odometry: Odometry,
        status: Status | None,
        rest: Remaining | None,
        *,
        paused: bool,
        changes: int,
    ) -> Feedback[Any]:
        """Feedback of the behaviour's step, with what the behaviour doesn't know.

        Args:
            rest: rest of the flight; None where it is unknown.
            paused: whether the goal is paused, and the vehicle hovers.
            changes: number of changes of the goal's fields so far.
        """
        content = move.feedback
        if isinstance(content, MoveFeedback | LandFeedback | ImagesFeedback) and content.frame == "world":
            content = msgspec.structs.replace(content, pos_uav_ned_m=odometry.pos_uav_ned_m)
        if isinstance(content, ImagesFeedback) and self._capture is not None:
            taken, planned, images = self._capture.taken, self._capture.planned, self._capture.unreported_images()
            content = msgspec.structs.replace(content, taken=taken, planned=planned, images=images)
        return Feedback(
            goal_id=self._goal_id,
            t_ns=t_ns,
            code=-1 if status is None else status.code,
            feedback=content,
            remaining_s=None if rest is None else rest.time_s,
            paused=paused,
            changes=changes,
        )

    def send(self, t_ns: int, feedback: Feedback[Any]) -> Iterator[Output]:
        """Send feedback to all watchers; the next one is due one period after this one was."""
        yield from (Reply(watcher, feedback, final=False) for watcher in self._watchers)
        period_ns = int(NS_PER_S / FEEDBACK_RATE_HZ)
        late_ns = t_ns - self._due_ns
        self._due_ns = (self._due_ns if late_ns < period_ns else t_ns) + period_ns
        message = FeedbackMessage(
            t_ns=feedback.t_ns,
            goal_id=feedback.goal_id,
            action=self._action.name,
            code=feedback.code,
            feedback=feedback.feedback,
            remaining_s=feedback.remaining_s,
            paused=feedback.paused,
            changes=feedback.changes,
        )
        yield Publish(self._topic, message)
