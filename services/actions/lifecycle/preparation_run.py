"""The preparation of one goal, which a process of its own carries out while the server goes on."""

from collections.abc import Iterator
from typing import Any, ClassVar

from jezero.runtime.service import BackgroundTask, CancelTask, Inbox, Output, Publish
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.schemas.topics import feedback_of
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import Preparation, Prepared, Refusal, VehicleState

PREPARE_TIMEOUT_S = 20.0
"""Time-out of a preparation: clients wait 30 s for the acceptance of a goal."""
FEEDBACK_PERIOD_NS = 100_000_000


class PreparationRun:
    """One preparation from its begin to its outcome or its end by a cancel.

    Args:
        state: of the vehicle at the begin.
    """

    name: ClassVar = "preparing"

    def __init__(
        self, t_ns: int, action: Action[Any], goal_id: str, preparation: Preparation, state: VehicleState
    ) -> None:
        self._action = action
        self._goal_id = goal_id
        self._preparation = preparation
        self._state = state
        self._tag = f"{goal_id}/prepare/{t_ns}"
        self._deadline_ns = t_ns + int(PREPARE_TIMEOUT_S * NS_PER_S)
        self._feedback_due_ns = t_ns

    def begin(self) -> Iterator[Output]:
        """Start the work."""
        yield BackgroundTask(self._preparation.work(self._state), self._tag)

    def end(self) -> Iterator[Output]:
        """End the work, whose outcome nobody wants any more."""
        yield CancelTask(self._tag)

    def outcome(self, t_ns: int, inbox: Inbox) -> Prepared | Refusal | None:
        """Outcome of the work; None while it lasts."""
        response = next((response for response in inbox.responses if response.tag == self._tag), None)
        if response is None:
            return self._too_long() if t_ns > self._deadline_ns else None
        if response.error is not None:
            return Refusal(f"{self._action.name} failed in prepare: {response.error}")
        return self._preparation.start(response.payload)

    def feedback(self, t_ns: int, state: VehicleState, status: Status | None) -> Iterator[Output]:
        """Publish that the goal is being prepared, ten times a second."""
        content = None
        if self._preparation.feedback is not None and t_ns >= self._feedback_due_ns:
            content = self._preparation.feedback(state)
        if content is None:
            return
        self._feedback_due_ns = t_ns + FEEDBACK_PERIOD_NS
        message = FeedbackMessage(
            t_ns=t_ns,
            goal_id=self._goal_id,
            action=self._action.name,
            code=-1 if status is None else status.code,
            feedback=content,
        )
        yield Publish(feedback_of(self._action), message)

    def _too_long(self) -> Refusal:
        advice = self._preparation.too_long
        reason = f"the goal could not be planned within {PREPARE_TIMEOUT_S:g} s"
        return Refusal(f"{reason}: {advice}" if advice else reason)
