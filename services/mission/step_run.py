"""One try of one step: a goal from its request to its result, or a wait."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Literal

import msgspec

from jezero.base.codec import BadPayloadError, decode
from jezero.runtime.service import Call, Inbox, Output, Response
from jezero.schemas.actions import Cancel, CancelReply, GetResult, Pause, PauseReply, Rejected, ResultReply, Resume
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action
from jezero.schemas.topics import RESULT
from jezero.schemas.units import NS_PER_S

SENDS_MAX, SEND_TIMEOUT_S = 7, 5.0
"""A goal without a reply is sent again, because a gap in the connection may have lost it: the server flies it once. It
may have to plan for 30 s first."""
POLL_PERIOD_NS = NS_PER_S // 2
REPLY_TIMEOUT_S = 1.0
TIMEOUT = "timeout"
"""Error of a call that nobody has answered in time, be it for a gap in the connection."""
UNKNOWN_MAX = 4
"""A goal that no server knows this many times in a row was forgotten: its server was restarted."""

End = Literal["succeeded", "failed", "canceled"]


class StepEnd(msgspec.Struct, frozen=True):
    """End of one try.

    Attributes:
        end: how it ended; `canceled` on a request of any client.
        reason: why it didn't succeed, for people.
        rest: fields of the goal that does what is still missing; None where nobody knows.
    """

    end: End
    reason: str = ""
    rest: dict[str, Any] | None = None


class _Result(msgspec.Struct):
    """The fields of any action's result that the mission uses."""

    outcome: Literal["succeeded", "canceled", "aborted"]
    reason: str = ""
    result: dict[str, Any] | None = None


class Wait:
    """A wait.

    Args:
        duration_s: its duration; a pause is not part of it.
    """

    goal_id = ""

    def __init__(self, t_ns: int, duration_s: float) -> None:
        self._left_ns = int(duration_s * NS_PER_S)
        self._t_ns = t_ns
        self._canceled = False

    def step(self, t_ns: int, inbox: Inbox, *, paused: bool) -> Iterator[Output]:
        """Let the time pass."""
        if not paused:
            self._left_ns -= max(t_ns - self._t_ns, 0)
        self._t_ns = t_ns
        yield from ()

    @property
    def left_s(self) -> float:
        """Rest of the wait."""
        return max(self._left_ns, 0) / NS_PER_S

    def cancel(self) -> Iterator[Output]:
        """End the wait."""
        self._canceled = True
        yield from ()

    @property
    def ended(self) -> StepEnd | None:
        """The end; None before."""
        if self._canceled:
            return StepEnd("canceled")
        return StepEnd("succeeded") if self._left_ns <= 0 else None


class StepGoal:
    """A goal at its action server, which flies it once, however often it is sent.

    Args:
        action: the goal's action.
        goal: the goal; the id of one that flies already.

    Attributes:
        goal_id: id of the goal.
        ended: the end; None before.
    """

    def __init__(self, action: Action[Any], goal: Goal | str) -> None:
        self.goal_id = goal if isinstance(goal, str) else goal.goal_id
        self.ended: StepEnd | None = None
        self._action = action
        self._goal = None if isinstance(goal, str) else goal
        self._accepted = self._goal is None
        self._sends = 0
        """Number of times that the goal was sent."""
        self._sends_now = not self._accepted
        self._canceling = False
        self._cancels = 0
        self._poll_due_ns = 0
        self._polls = 0
        self._unknown = 0

    def step(self, t_ns: int, inbox: Inbox, *, paused: bool) -> Iterator[Output]:
        """Send the goal, then ask for its result until there is one."""
        for response in inbox.responses:
            goal_id, _, call = response.tag.partition("/")
            if goal_id == self.goal_id:
                self._on_response(call.partition("/")[0], response)
        if self.ended is not None:
            return
        if self._sends_now and self._goal is not None:
            self._sends_now = False
            self._sends += 1
            yield Call(self._action.endpoint, self._goal, f"{self.goal_id}/goal/{self._sends}", SEND_TIMEOUT_S)
        if t_ns < self._poll_due_ns:
            return
        self._poll_due_ns = t_ns + POLL_PERIOD_NS
        if self._canceling:
            yield from self.cancel()
        if self._accepted:
            self._polls += 1
            yield Call(RESULT, GetResult(goal_id=self.goal_id), f"{self.goal_id}/result/{self._polls}", REPLY_TIMEOUT_S)

    def cancel(self) -> Iterator[Output]:
        """End the goal; its result follows. The request is repeated until then."""
        self._canceling = True
        self._cancels += 1
        tag = f"{self.goal_id}/cancel/{self._cancels}"
        yield Call(self._action.cancel, Cancel(goal_id=self.goal_id), tag, REPLY_TIMEOUT_S)

    def pause(self) -> Iterator[Output]:
        """Ask for a pause; `pause_reply` has the outcome."""
        yield Call(self._action.pause, Pause(goal_id=self.goal_id), f"{self.goal_id}/pause", REPLY_TIMEOUT_S)

    def pause_reply(self, inbox: Inbox) -> PauseReply | None:
        """Outcome of the request for a pause; None while there is none."""
        for response in inbox.responses:
            if response.tag == f"{self.goal_id}/pause":
                silent = PauseReply(paused=False, reason=f"{self._action.name} did not reply ({response.error})")
                return response.payload if isinstance(response.payload, PauseReply) else silent
        return None

    def resume(self) -> Iterator[Output]:
        """End the pause."""
        yield Call(self._action.resume, Resume(goal_id=self.goal_id), f"{self.goal_id}/resume", REPLY_TIMEOUT_S)

    def _on_response(self, kind: str, response: Response) -> None:
        if kind == "goal" and not self._accepted:
            self._on_first_reply(response)
        elif kind == "cancel" and not self._accepted:
            self._on_early_cancel(response)
        elif kind == "result" and response.error != TIMEOUT:
            self._on_result(response)

    def _on_early_cancel(self, response: Response) -> None:
        """End a goal that its server has never got. If the goal still arrives, the server refuses it."""
        reply = response.payload
        if isinstance(reply, CancelReply) and not reply.canceled:
            self.ended = StepEnd("canceled", reply.reason)
        elif reply is None and response.error != TIMEOUT:
            self.ended = StepEnd("canceled", f"{self._action.name} did not reply ({response.error})")

    def _on_first_reply(self, response: Response) -> None:
        if isinstance(response.payload, Rejected):
            self.ended = StepEnd("canceled" if self._canceling else "failed", response.payload.reason)
        elif response.error == TIMEOUT and (self._canceling or self._sends < SENDS_MAX):
            self._sends_now = not self._canceling
        elif response.payload is None:
            reason = f"{self._action.name} did not reply ({response.error}): is its service running? (jezero ps)"
            self.ended = StepEnd("failed", reason)
        else:
            self._accepted = True

    def _on_result(self, response: Response) -> None:
        reply = response.payload
        if not isinstance(reply, ResultReply) or reply.goal_id != self.goal_id:
            self._unknown += 1
            if self._unknown >= UNKNOWN_MAX:
                self.ended = StepEnd("failed", f"{self._action.name} doesn't know the goal any more: it was restarted")
            return
        self._unknown = 0
        if not reply.running and reply.result is not None:
            with suppress(BadPayloadError):  # else the next reply has it
                self.ended = _end_of(decode(_Result, reply.result.encode()))


def _end_of(result: _Result) -> StepEnd:
    rest = result.result.get("resume") if result.result else None
    if result.outcome == "succeeded":
        return StepEnd("succeeded")
    end: End = "canceled" if result.outcome == "canceled" else "failed"
    return StepEnd(end, result.reason, _without_ids(rest))


def _without_ids(goal: dict[str, Any] | None) -> dict[str, Any] | None:
    """Fields of a goal without those that the mission chooses anew."""
    if goal is None:
        return None
    return {name: value for name, value in goal.items() if name not in ("goal_id", "issued_t_ns", "plan_id")}


def goal_of(action: Action[Any], fields: Mapping[str, Any], goal_id: str, t_ns: int) -> Goal:
    """The goal of a step.

    Raises:
        msgspec.ValidationError: its fields are no goal of this action.
    """
    goal: Goal = msgspec.convert({**fields, "goal_id": goal_id, "issued_t_ns": t_ns}, action.goal_type)
    return goal
