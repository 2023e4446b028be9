"""Follows one goal from its request to its end, as a client sees it; for the SDK and the mission service.

The caller sends the requests, and passes in their replies, their ends without a reply, and the time of any clock that
never steps.
"""

from collections.abc import Iterator
from typing import Any, Literal

from jezero.schemas.actions import Accepted, CancelReply, Feedback, Rejected, Result, ResultReply
from jezero.schemas.units import NS_PER_S

SENDS_MAX, SEND_PERIOD_NS = 7, 5 * NS_PER_S
"""A goal without a reply is sent again, because a gap in the connection may have lost it: the server flies it once. It
may have to plan for 30 s first."""
ASK_PERIOD_NS = NS_PER_S // 2
"""Silence of an accepted goal, which sends feedback ten times a second, after which its result is requested."""
GoalRequest = Literal["goal", "result", "cancel"]
GoalReply = Accepted | Rejected | Feedback[Any] | Result[Any] | ResultReply | CancelReply


class GoalFollower:
    """Judges the replies to the requests about one goal, and decides which request is due.

    Args:
        unknown_max: a goal that no server knows this many times in a row is lost: its server has ended.
        gap_max_s: longest gap in the connection, with the time in which servers connect again; None: any.
        accepted: the goal flies already.

    Attributes:
        accepted: whether its server has accepted the goal.
        canceling: whether `cancel` was called.
        gap: whether the connection had a gap since the last reply.
        end: the reply that has ended the goal; the error of the last request if it is lost, or was never accepted; None
            before. `CancelReply` ends a goal that its server has never got: if it still arrives, the server refuses it.
    """

    def __init__(self, *, unknown_max: int, gap_max_s: float | None, accepted: bool = False) -> None:
        self.accepted = accepted
        self.canceling = self.gap = False
        self.end: Result[Any] | Rejected | CancelReply | str | None = None
        self._unknown_max, self._gap_max_s = unknown_max, gap_max_s
        self._sends = self._unknown = self._heard_ns = self._due_ns = self._cancel_due_ns = 0

    def cancel(self) -> None:
        """Cancel the goal: the request is due now, and again until the goal has ended."""
        self.canceling, self._cancel_due_ns = True, 0

    def due(self, now_ns: int) -> Iterator[GoalRequest]:
        """Requests that are to be sent now: the goal (again), `Cancel`, `GetResult`, or none."""
        if self.end is None and self.canceling and now_ns >= self._cancel_due_ns:
            self._cancel_due_ns = now_ns + ASK_PERIOD_NS
            yield "cancel"
        if self.end is not None or now_ns < self._due_ns or (self.canceling and not self.accepted):
            return
        if self.accepted:
            self._due_ns = now_ns + ASK_PERIOD_NS
            yield "result"
        elif self._sends < SENDS_MAX:
            self._sends, self._due_ns = self._sends + 1, now_ns + SEND_PERIOD_NS
            yield "goal"
        else:
            self.end = "timeout"

    def on_reply(self, now_ns: int, reply: GoalReply) -> None:
        """Judge a reply; a `ResultReply` with a result is passed as that `Result`."""
        if self.end is not None:
            return
        if isinstance(reply, CancelReply | Rejected):
            if not self.accepted and not (isinstance(reply, CancelReply) and reply.canceled):
                self.end = reply
            return
        self.accepted, self.gap, self._unknown = True, False, 0
        self._heard_ns, self._due_ns = now_ns, now_ns + ASK_PERIOD_NS
        if isinstance(reply, Result):
            self.end = reply

    def on_silence(self, now_ns: int, request: GoalRequest, error: str, *, gap: bool = False) -> None:
        """Judge the end of a request without a reply, or without another one.

        Args:
            gap: whether that may be for a gap in the connection, and says nothing about the server.
        """
        if self.end is not None:
            return
        if not self.accepted:
            self.end = None if gap else error
        elif request == "goal":
            self._heard_ns = self._due_ns = now_ns
        elif request == "result":
            self.gap, self._unknown = self.gap or gap, self._unknown + (not gap)
            lost = self._unknown >= self._unknown_max
            if self.gap and self._gap_max_s is not None:
                lost = now_ns - self._heard_ns > self._gap_max_s * NS_PER_S
            self.end = error if lost else None
