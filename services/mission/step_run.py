"""One try of one step: a goal from its request to its result, or a wait."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Literal

import msgspec

from jezero.base.codec import BadPayloadError, decode
from jezero.base.goal_follower import GoalFollower, GoalRequest
from jezero.runtime.service import Call, Inbox, Output, Response
from jezero.schemas.actions import Cancel, GetResult, Pause, PauseReply, Result, ResultReply, Resume
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action, Endpoint
from jezero.schemas.struct import Payload
from jezero.schemas.topics import RESULT
from jezero.schemas.units import NS_PER_S

STREAM_TIMEOUT_S, REPLY_TIMEOUT_S = 86_400.0, 1.0
TIMEOUT = "timeout"
"""Error of a call that nobody has answered in time, be it for a gap in the connection."""
UNKNOWN_MAX = 4
"""A restarted router may have a second until all servers are connected to it again."""

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
    """

    def __init__(self, action: Action[Any], goal: Goal | str) -> None:
        self.goal_id = goal if isinstance(goal, str) else goal.goal_id
        self._action = action
        self._calls: dict[GoalRequest, Call] = {
            "result": self._call(RESULT, GetResult(goal_id=self.goal_id), "result"),
            "cancel": self._call(action.cancel, Cancel(goal_id=self.goal_id), "cancel"),
        }
        if not isinstance(goal, str):
            self._calls["goal"] = Call(action.endpoint, goal, f"{goal.goal_id}/goal", STREAM_TIMEOUT_S, streamed=True)
        self._follower = GoalFollower(unknown_max=UNKNOWN_MAX, gap_max_s=None, accepted="goal" not in self._calls)
        self._t_ns = 0
        self._resumes = False
        """A resume was requested, and its reply is awaited."""

    def step(self, t_ns: int, inbox: Inbox, *, paused: bool) -> Iterator[Output]:
        """Process the replies, and send what is due."""
        self._t_ns = t_ns
        for response in inbox.responses:
            if response.tag == f"{self.goal_id}/resume" and self._resumes:
                self._resumes = False
                if response.payload is None and self._follower.end is None:  # else the goal would hover on
                    yield from self.resume()
            for request, call in self._calls.items():
                if response.tag == call.tag:
                    self._on_response(request, response)
        yield from self._due()

    def cancel(self) -> Iterator[Output]:
        """End the goal; its result follows."""
        self._resumes = False
        self._follower.cancel()
        yield from self._due()

    def pause(self) -> Iterator[Output]:
        """Ask for a pause; `pause_reply` has the outcome."""
        self._resumes = False
        yield self._call(self._action.pause, Pause(goal_id=self.goal_id), "pause")

    def pause_reply(self, inbox: Inbox) -> PauseReply | None:
        """Outcome of the request for a pause; None while there is none."""
        for response in inbox.responses:
            if response.tag == f"{self.goal_id}/pause":
                silent = PauseReply(paused=False, reason=f"{self._action.name} did not reply ({response.error})")
                return response.payload if isinstance(response.payload, PauseReply) else silent
        return None

    def resume(self) -> Iterator[Output]:
        """End the pause; the request is sent again when it was lost."""
        self._resumes = True
        yield self._call(self._action.resume, Resume(goal_id=self.goal_id), "resume")

    @property
    def ended(self) -> StepEnd | None:
        """The end; None before."""
        end, name = self._follower.end, self._action.name
        if end is None:
            return None
        if isinstance(end, Result):
            rest = msgspec.to_builtins(getattr(end.result, "resume", None))
            return StepEnd("failed" if end.outcome == "aborted" else end.outcome, end.reason, _without_ids(rest))
        if self._follower.accepted:
            return StepEnd("failed", f"{name} doesn't know the goal any more: it was restarted")
        silent = f"{name} did not reply ({end}): is its service running? (jezero ps)"
        reason = silent if isinstance(end, str) else end.reason
        return StepEnd("canceled" if self._follower.canceling else "failed", reason)

    def _call(self, endpoint: Endpoint[Any, Any], payload: Payload, word: str) -> Call:
        return Call(endpoint, payload, f"{self.goal_id}/{word}", REPLY_TIMEOUT_S)

    def _due(self) -> Iterator[Output]:
        yield from (self._calls[request] for request in self._follower.due(self._t_ns))

    def _on_response(self, request: GoalRequest, response: Response) -> None:
        reply = response.payload
        if reply is None:
            self._follower.on_silence(self._t_ns, request, response.error or "", gap=response.error == TIMEOUT)
            return
        if isinstance(reply, ResultReply) and reply.result is not None:
            with suppress(BadPayloadError):  # else the next reply has the result
                reply = decode(Result[self._action.result_type], reply.result.encode())  # type: ignore[name-defined]
        self._follower.on_reply(self._t_ns, reply)


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
