"""The goals of a recording, from the feedback that their action servers published."""

from collections.abc import Iterable
from typing import Any, NamedTuple

from jezero.schemas.actions import FeedbackMessage


class RecordedGoal(NamedTuple):
    """One goal as its feedback shows it.

    Attributes:
        goal_id: id of the goal.
        action: name of its action.
        feedback: its feedback in the order of time; at least one message.
    """

    goal_id: str
    action: str
    feedback: tuple[FeedbackMessage[Any], ...]

    @property
    def start_ns(self) -> int:
        """Vehicle time of the first feedback."""
        return self.feedback[0].t_ns

    @property
    def end_ns(self) -> int:
        """Vehicle time of the last feedback."""
        return self.feedback[-1].t_ns


def goals_of(messages: Iterable[Any]) -> list[RecordedGoal]:
    """Goals in the order of their starts.

    Args:
        messages: recorded messages in the order of time; those that are no feedback are left out.
    """
    by_goal: dict[tuple[str, str], list[FeedbackMessage[Any]]] = {}
    for message in messages:
        if isinstance(message, FeedbackMessage):
            by_goal.setdefault((message.goal_id, message.action), []).append(message)
    return [RecordedGoal(*names, tuple(feedback)) for names, feedback in by_goal.items()]
