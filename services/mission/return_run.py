"""One return that the vehicle flies by itself: ends the goal in charge, then flies `return_home`."""

from collections.abc import Iterator

from msgspec.structs import replace

from jezero.runtime.service import Call, Inbox, Output
from jezero.schemas.commands import Abort
from jezero.schemas.goals import ReturnHomeGoal
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import ABORT, RETURN_HOME, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.step_run import StepEnd, StepGoal

TRIES = 3
TRY_PERIOD_NS = 5 * NS_PER_S
"""Least time from one try to the next: a server that was restarted, or is busy for a moment, flies the next one."""
ABORT_PERIOD_NS = 2 * NS_PER_S
ABORT_TIMEOUT_S = 1.0
OTHER_CONTROL = "somebody else has control"


class ReturnRun:
    """One return.

    Args:
        return_id: start of the ids of its goals.
        reason: why the vehicle returns, for the client of the goal that is ended, and for people.
        goal: the return; it gets its id and its time when it is sent.

    Attributes:
        ended: the end; None before. `canceled` when a person or a failsafe took control.
    """

    def __init__(self, return_id: str, reason: str, goal: ReturnHomeGoal) -> None:
        self.reason = reason
        self.ended: StepEnd | None = None
        self._return_id = return_id
        self._goal = goal
        self._run: StepGoal | None = None
        self._tries = 0
        self._try_due_ns = self._abort_due_ns = 0
        self._aborting_until_ns = 0
        """No goal begins before the bridge has replied to the last request for an abort, which would end it too."""
        self._interventions: tuple[int, int] | None = None
        """Bridge's boot id and the number of interventions, when the first goal since the last abort began."""

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the return."""
        status = inbox.latest(STATUS)
        if status is None or self.ended is not None:
            return
        if self._interventions is not None:
            self._watch_interventions(status)
        if self._run is None and self.ended is None:
            yield from self._begin(t_ns, status)
            if any(response.tag == self._abort_tag for response in inbox.responses):
                self._aborting_until_ns = t_ns  # from the next step on the status has it, too
        if self._run is None or self.ended is not None:
            return
        yield from self._run.step(t_ns, inbox, paused=False)
        end = self._run.ended
        if end is not None and end.end == "failed" and self._tries < TRIES:
            self._run = None
        else:
            self.ended = end

    def _begin(self, t_ns: int, status: Status) -> Iterator[Output]:
        """Fly home as soon as the vehicle hovers; request an abort of the goal in charge until then."""
        if status.in_charge in ("external", "failsafe"):
            self.ended = StepEnd("canceled", f"{OTHER_CONTROL}: {status.text}")
        elif status.landed or not status.armed:
            self.ended = StepEnd("canceled", "the vehicle has landed")
        elif status.code == StatusCode.HOVER:
            if t_ns < max(self._try_due_ns, self._aborting_until_ns):
                return
            self._tries += 1
            self._try_due_ns = t_ns + TRY_PERIOD_NS
            self._interventions = self._interventions or (status.bridge_boot_id, status.interventions)
            goal_id = f"{self._return_id}.{self._tries}"
            self._run = StepGoal(RETURN_HOME, replace(self._goal, goal_id=goal_id, issued_t_ns=t_ns))
        elif status.in_charge == "goal" and t_ns >= self._abort_due_ns:
            self._abort_due_ns = t_ns + ABORT_PERIOD_NS
            self._aborting_until_ns = t_ns + int(ABORT_TIMEOUT_S * NS_PER_S)
            self._interventions = None  # the abort is one
            yield Call(ABORT, Abort(reason=self.reason), self._abort_tag, ABORT_TIMEOUT_S)

    @property
    def _abort_tag(self) -> str:
        return f"{self._return_id}/abort"

    def _watch_interventions(self, status: Status) -> None:
        """End the return when a person or a failsafe takes control."""
        if status.in_charge in ("external", "failsafe"):
            self.ended = StepEnd("canceled", f"{OTHER_CONTROL}: {status.text}")
            return
        if (status.bridge_boot_id, status.interventions) != self._interventions:
            self.ended = StepEnd("canceled", status.text)
