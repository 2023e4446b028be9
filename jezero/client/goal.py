"""An accepted goal: its feedback, its result and its cancellation."""

import time
from collections.abc import Iterator, Mapping
from typing import Any, Generic, TypeVar, cast

from jezero.base.codec import encode
from jezero.base.goal_follower import GoalFollower
from jezero.base.zenoh_client import FIRST
from jezero.client.errors import Aborted, Canceled, JezeroError, Refused, TimedOut, Unreachable
from jezero.client.session import Connection, ReplyArrivals, decode, decoder
from jezero.client.status import watch_status
from jezero.schemas.actions import (
    Accepted,
    Cancel,
    CancelReply,
    Feedback,
    GetResult,
    Modify,
    ModifyReply,
    Pause,
    PauseReply,
    Rejected,
    Result,
    ResultReply,
    Resume,
    ResumeReply,
)
from jezero.schemas.goals import Goal as GoalPayload
from jezero.schemas.rows import Action
from jezero.schemas.topics import RESULT

F = TypeVar("F")
R = TypeVar("R")

GOAL_TIMEOUT_S = 86_400.0
MODIFY_TIMEOUT_S = 30.0
"""Longest wait until the vehicle has braked and a new path is planned."""
PAUSE_TIMEOUT_S = 30.0
"""Longest wait until the vehicle hovers: a landing that pauses climbs to the height of its approach first."""
RECOVER_S = 5.0
"""Time until all servers are connected again after a restart of the router."""
POLL_S, UNKNOWN_MAX = 0.3, 2


class Goal(Generic[F, R]):
    """A running goal, for use by one thread.

    Attributes:
        goal_id: the goal's id; `Vehicle.result_of` takes it.
        warning: which part of the goal will not be flown as requested, or "".
        code: status code of the vehicle in the last feedback; None before.
        remaining_s: planned time to the goal's end in the last feedback; None before, and where it is unknown.
        paused: whether the goal was paused, and the vehicle hovered, in the last feedback.
    """

    def __init__(self, connection: Connection, action: Action[Any], goal: GoalPayload, timeout_s: float) -> None:
        self.goal_id = goal.goal_id
        self.warning = ""
        self.code: int | None = None
        self.remaining_s: float | None = None
        self.paused = False
        self._connection = connection
        self._action = action
        self._endpoint = action.endpoint
        self._timeout_s = timeout_s
        self._failure: JezeroError | None = None
        self._feedback_t_ns = 0
        """Vehicle time of the newest feedback."""
        self._follower = GoalFollower(unknown_max=UNKNOWN_MAX, gap_max_s=RECOVER_S)
        self._decode = decoder(self._endpoint.reply_type)
        self._arrivals = connection.stream(self._endpoint.name, encode(goal), GOAL_TIMEOUT_S)
        self._await_acceptance()

    def __repr__(self) -> str:
        end = self._follower.end
        state = end.outcome if isinstance(end, Result) else "running"
        return f"<{self._action.name} goal {self.goal_id}: {state}>"

    def feedback(self) -> Iterator[F]:
        """Yield the goal's feedback until it ends; then call `result()`."""
        while (feedback := self.next_feedback()) is not None:
            yield feedback

    def next_feedback(self, timeout_s: float | None = None) -> F | None:
        """The next feedback; None once the goal has ended.

        Args:
            timeout_s: longest wait; None waits until one comes.

        Raises:
            TimedOut: no feedback came in time; the goal continues.
        """
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._ended:
            feedback = self._next(deadline_s)
            if feedback is not None:
                return feedback
        return None

    def result(self, timeout_s: float | None = None) -> R:
        """Wait for the goal's end.

        Args:
            timeout_s: longest wait; None waits until the goal ends.

        Returns:
            The action's result.

        Raises:
            Aborted: the goal was not completed; the text is the reason.
            Canceled: the goal was canceled.
            TimedOut: the goal still runs, and continues.
            Unreachable: the action server died, or the connection is lost.
        """
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._ended:
            try:
                self._next(deadline_s)
            except TimedOut:
                raise TimedOut(self._still_runs(timeout_s)) from None
        if self._failure is not None:
            raise self._failure
        result = cast(Result[R], self._follower.end)
        if result.outcome == "aborted":
            raise Aborted(result.reason, result.result)
        if result.outcome == "canceled":
            raise Canceled(result.reason or "canceled", result.result)
        return cast(R, result.result)

    def cancel(self) -> bool:
        """Cancel the goal: the vehicle hovers, and `result()` raises `Canceled`.

        Returns:
            False if the goal had ended before.

        Raises:
            Unreachable: no action server replies.
            TimedOut: the reply is missing.
        """
        reply: CancelReply = self._connection.request(
            self._action.cancel, Cancel(goal_id=self.goal_id), self._timeout_s
        )
        return reply.canceled

    def pause(self, *, wait: bool = True) -> None:
        """Pause the goal: the vehicle brakes, and hovers until `resume`; the goal keeps control.

        Args:
            wait: return when the vehicle hovers; otherwise as soon as the server has accepted the request.

        Raises:
            Refused: the goal can't be paused now, or has ended; the text is the reason.
            Unreachable: no action server replies, or no status comes any more.
            TimedOut: the reply is missing, or the vehicle doesn't hover within 30 s.
        """
        request_pause(self._connection, self._action, self.goal_id, self._timeout_s)
        if wait:
            await_pause(self._connection, self._action, self.goal_id)

    def resume(self) -> None:
        """Go on with a paused goal; returns as soon as the server has accepted that.

        Raises:
            Refused: the goal is not paused, or has ended; the text is the reason.
            Unreachable: no action server replies.
            TimedOut: the reply is missing.
        """
        resume_goal(self._connection, self._action, self.goal_id, self._timeout_s)

    def modify(self, /, **fields: Any) -> None:
        """Change fields of the goal while it is flown: `goal.modify(speed_mps=2.0)`.

        The vehicle brakes, and goes on by the new plan. `warning` says what it will not fly as requested.

        Args:
            fields: new values by name; the action's page lists the fields that may change.

        Raises:
            Refused: the goal goes on with the old values; the text is the reason.
            ValueError: a value is NaN or infinite.
            Unreachable: no action server replies.
            TimedOut: the reply is missing.
        """
        self.warning = modify_goal(self._connection, self._action, self.goal_id, fields)

    # -- internals --

    def _await_acceptance(self) -> None:
        try:
            reply = self._decode(self._connection.first(self._arrivals, self._endpoint.name, self._timeout_s))
            if not isinstance(reply, Accepted | Rejected):
                kind = type(reply).__name__
                raise JezeroError(f"{self._action.name} replied with {kind} before it accepted the goal")
        except BaseException:
            self._withdraw()
            raise
        self._follower.on_reply(time.monotonic_ns(), reply)
        if isinstance(reply, Rejected):
            raise Refused(reply.reason, reply.code)
        self.goal_id, self.warning = reply.goal_id, reply.warning

    def _withdraw(self) -> None:
        """Cancel a goal whose acceptance did not arrive; best effort."""
        if self._connection.connected and not self._arrivals.ended:
            self._connection.stream(self._action.cancel.name, encode(Cancel(goal_id=self.goal_id)), 1.0, FIRST)

    @property
    def _ended(self) -> bool:
        return self._follower.end is not None or self._failure is not None

    def _next(self, deadline_s: float | None) -> F | None:
        """Wait for one reply and process it, or find out why there is none."""
        data = self._arrivals.take(deadline_s)
        if data is None:
            self._recover(deadline_s)
            return None
        return self._process(data)

    def _process(self, data: bytes) -> F | None:
        """Process one reply: return feedback, keep the result."""
        reply = self._decode(data)
        self._follower.on_reply(time.monotonic_ns(), reply)
        if isinstance(reply, Feedback | Result):
            self._connection.set_vehicle_time(reply.t_ns, may_have_waited=True)
        if not isinstance(reply, Feedback):
            return None
        self._feedback_t_ns = reply.t_ns
        self.code, self.remaining_s, self.paused = reply.code, reply.remaining_s, reply.paused
        return cast(F, reply.feedback)

    def _recover(self, deadline_s: float | None) -> None:
        """Find the result after the replies ended without one: the server died, or a connection was lost."""
        follower = self._follower
        follower.on_silence(time.monotonic_ns(), "goal", "no reply")
        while not self._ended:
            if deadline_s is not None and time.monotonic() > deadline_s:
                raise TimedOut("no result in time")
            reply = request_result(self._connection, self.goal_id) if self._connection.connected else None
            # After the request, which may end because a link does. Bridge and action servers are on one computer.
            in_reach = self._connection.connected and (reply is not None or self._connection.sees_bridge())
            if reply is None:
                follower.on_silence(time.monotonic_ns(), "result", "no reply", gap=not in_reach)
            elif reply.result is None:
                follower.on_reply(time.monotonic_ns(), reply)
            else:
                result = decode(Result[self._action.result_type], reply.result.encode())  # type: ignore[name-defined]
                follower.on_reply(time.monotonic_ns(), result)
            if isinstance(follower.end, str) or (self._connection.closed and not in_reach):
                self._failure = Unreachable(self._lost(in_reach))
            if not self._ended:
                time.sleep(POLL_S)

    def _still_runs(self, timeout_s: float | None) -> str:
        """Error text for a wait that was too short."""
        return f"{self._action.name} still runs after {timeout_s:g} s"

    def _lost(self, in_reach: bool) -> str:
        """Error text for a goal that no server knows, or whose connection was closed, lost, or lost and restored."""
        if in_reach and self._follower.gap:
            return f"the connection was lost, and no action server knows goal {self.goal_id}: its server died too"
        if in_reach:
            name = self._action.name
            return f"the {name} server died or lost its router; the vehicle hovers (`jezero ps`, uav.status())"
        reason = self._connection.loss_reason() or self._connection.hidden_reason()
        reason = reason or f"the link to {self._connection.vehicle} is lost (`jezero ps`)"
        return f"{reason}; goal {self.goal_id} may still run"


def request_pause(connection: Connection, action: Action[Any], goal_id: str, timeout_s: float) -> None:
    """Ask a goal to pause, also another client's; raises `Refused` where it can't."""
    request = Pause(goal_id=goal_id, issued_t_ns=connection.vehicle_time_ns())
    reply: PauseReply = connection.request(action.pause, request, timeout_s)
    if not reply.paused:
        raise Refused(reply.reason)


def await_pause(connection: Connection, action: Action[Any], goal_id: str) -> None:
    """Wait until the vehicle hovers in a pause of a goal; raises the errors of `Goal.pause`."""
    deadline_s = time.monotonic() + PAUSE_TIMEOUT_S
    for status in watch_status(connection):
        if status.goal_id != goal_id and _has_ended(connection, goal_id):
            raise Refused(f"{action.name} ended before the vehicle hovered", status.code)
        if status.goal_id == goal_id and status.paused:
            return
        if time.monotonic() > deadline_s:
            raise TimedOut(f"{action.name} is to pause, but the vehicle doesn't hover after {PAUSE_TIMEOUT_S:g} s")


def _has_ended(connection: Connection, goal_id: str) -> bool:
    reply = request_result(connection, goal_id)
    return reply is not None and not reply.running


def resume_goal(connection: Connection, action: Action[Any], goal_id: str, timeout_s: float) -> None:
    """Resume a goal, also another client's; raises the errors of `Goal.pause`."""
    request = Resume(goal_id=goal_id, issued_t_ns=connection.vehicle_time_ns())
    reply: ResumeReply = connection.request(action.resume, request, timeout_s)
    if not reply.resumed:
        raise Refused(reply.reason)


def modify_goal(connection: Connection, action: Action[Any], goal_id: str, fields: Mapping[str, Any]) -> str:
    """Modify a goal, also another client's; returns the warning, and raises the errors of `Goal.modify`."""
    request = Modify(goal_id=goal_id, fields=dict(fields), issued_t_ns=connection.vehicle_time_ns())
    reply: ModifyReply = connection.request(action.modify, request, MODIFY_TIMEOUT_S)
    if not reply.modified:
        raise Refused(reply.reason)
    return reply.warning


def request_result(connection: Connection, goal_id: str) -> ResultReply | None:
    """State or result of a goal from the action servers; None if none of them knows it."""
    arrivals: ReplyArrivals = connection.stream(RESULT.name, encode(GetResult(goal_id=goal_id)), 0.5)
    try:
        data = connection.first_or_none(arrivals, RESULT.name, 0.5)
    except TimedOut:
        return None
    return None if data is None else cast(ResultReply, decode(RESULT.reply_type, data))
