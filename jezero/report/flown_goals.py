"""The goals of a log that take images: where the vehicle flew, and the images."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from jezero.recording import Entry
from jezero.recording.goals import feedback_by_goal
from jezero.schemas import topics
from jezero.schemas.images import Image
from jezero.schemas.rows import Action
from jezero.schemas.state import Odometry, Truth


@dataclass(frozen=True)
class FlownGoal:
    """One goal that takes images, from its first feedback in flight to its last one.

    Attributes:
        odometry: the vehicle's own state; at least two messages.
        truth: the true state; empty in a recording without truth.
        images: images in the feedback; empty for a goal with `stream_images` = false.
        planned: number of images that the goal would take.
    """

    odometry: Sequence[Odometry]
    truth: Sequence[Truth]
    images: Sequence[Image]
    planned: int

    @property
    def pictures_text(self) -> str:
        """Number of images, for the head of a figure."""
        if self.images:
            return f"{len(self.images)} of {self.planned} pictures"
        return f"{self.planned} pictures planned, none in the feedback"


def flown_goals(entries: Sequence[Entry], action: Action[Any]) -> Iterator[FlownGoal]:
    """The goals of one action that the vehicle has flown, in their order; also those that were aborted."""
    feedback_topic = topics.feedback_of(action).name
    odometry = [entry.message for entry in entries if entry.topic == topics.ODOMETRY.name]
    truth = [entry.message for entry in entries if entry.topic == topics.TRUTH.name]
    for feedback in feedback_by_goal(entry.message for entry in entries if entry.topic == feedback_topic):
        flying = [message for message in feedback if message.feedback.phase == "flying"]
        if not flying:
            continue
        start_ns, end_ns = flying[0].t_ns, flying[-1].t_ns
        flown = [message for message in odometry if start_ns <= message.t_ns <= end_ns]
        if len(flown) > 1:
            yield FlownGoal(
                odometry=flown,
                truth=[message for message in truth if start_ns <= message.t_ns <= end_ns],
                images=[image for message in flying for image in message.feedback.images],
                planned=flying[-1].feedback.planned,
            )
