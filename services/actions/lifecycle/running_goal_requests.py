"""Replies to the requests about a goal that runs: pause, resume and modify."""

from collections.abc import Iterator, Mapping
from typing import Any

from jezero.runtime.service import Inbox, Output, Reply, Request
from jezero.schemas.actions import Modify, ModifyReply, Pause, PauseReply, Result, Resume, ResumeReply
from jezero.schemas.rows import Action
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.goal_run import GoalRun
from jezero.services.actions.lifecycle.guard import GuardedPlanner

EXPIRY_S = 30.0
"""An older request has no effect: what it was for may be over."""
AHEAD_MAX_S = 1.0
"""A request that was issued farther in the future is from before a restart of the vehicle."""


class RunningGoalRequests:
    """Handles the requests of one action server that pause, resume and modify its goal.

    A request may arrive late, or twice: one that is older than the last of its kind has no effect.
    """

    def __init__(self, action: Action[Any], planner: GuardedPlanner) -> None:
        self._action = action
        self._planner = planner
        self._paused = ("", 0)
        """Id of the last goal that was paused or resumed, and issue time of that request."""
        self._modified = ("", 0)
        """Id of the last goal that was modified, and issue time of that request."""

    def handle(
        self, t_ns: int, inbox: Inbox, run: GoalRun | None, results: Mapping[str, Result[Any]]
    ) -> Iterator[Output]:
        """Reply to the requests that arrived."""
        for request in inbox.requests(self._action.pause):
            reason = self._pause_reason(t_ns, request.payload, inbox, run, results)
            yield Reply(request.request_id, PauseReply(paused=not reason, reason=reason))
        for request in inbox.requests(self._action.resume):
            reason = self._pause_reason(t_ns, request.payload, inbox, run, results)
            yield Reply(request.request_id, ResumeReply(resumed=not reason, reason=reason))
        for request in inbox.requests(self._action.modify):
            if reason := self._modify_reason(t_ns, request, inbox, run, results):
                yield Reply(request.request_id, ModifyReply(modified=False, reason=reason))

    def _pause_reason(
        self,
        t_ns: int,
        wanted: Pause | Resume,
        inbox: Inbox,
        run: GoalRun | None,
        results: Mapping[str, Result[Any]],
    ) -> str:
        """Pause or resume; returns the reason why that is impossible, or ""."""
        if run is None or run.goal_id != wanted.goal_id or run.plan_only:
            return not_running_reason(wanted.goal_id, results, self._action.name)
        if stale := _staleness(t_ns, wanted.issued_t_ns, _last_ns(self._paused, run.goal_id)):
            return stale
        reason = run.pause(t_ns, inbox) if isinstance(wanted, Pause) else run.resume()
        if not reason:
            self._paused = (run.goal_id, t_ns if wanted.issued_t_ns is None else wanted.issued_t_ns)
        return reason

    def _modify_reason(
        self, t_ns: int, request: Request, inbox: Inbox, run: GoalRun | None, results: Mapping[str, Result[Any]]
    ) -> str:
        """Begin to modify; returns the reason why that is impossible, or "" where the goal's run will reply."""
        wanted: Modify = request.payload
        if run is None or run.goal_id != wanted.goal_id or run.plan_only:
            return not_running_reason(wanted.goal_id, results, self._action.name)
        if stale := _staleness(t_ns, wanted.issued_t_ns, _last_ns(self._modified, run.goal_id)):
            return stale
        reason = run.modify(t_ns, request, self._planner, inbox)
        if not reason:
            self._modified = (run.goal_id, t_ns if wanted.issued_t_ns is None else wanted.issued_t_ns)
        return reason


def _last_ns(last: tuple[str, int], goal_id: str) -> int:
    """Issue time of the last request, if it was for this goal."""
    return last[1] if last[0] == goal_id else 0


def not_running_reason(goal_id: str, results: Mapping[str, Result[Any]], action: str) -> str:
    """Reason why nothing can be done with a goal that doesn't run."""
    if goal_id in results:
        return f"the goal has already {results[goal_id].outcome}"
    return f"no goal {goal_id} is known to {action}"


def _staleness(t_ns: int, issued_t_ns: int | None, last_ns: int) -> str:
    """Reason why a request is too old or from before a restart, or ""."""
    if issued_t_ns is None:
        return ""
    age_s = (t_ns - issued_t_ns) / NS_PER_S
    if age_s > EXPIRY_S:
        return f"the request is {age_s:.0f} s old and expired after {EXPIRY_S:g} s: send it again"
    if age_s < -AHEAD_MAX_S:
        return f"the request was issued {-age_s:.0f} s in the future: the vehicle restarted, send it again"
    return "a newer request came before this one" if issued_t_ns < last_ns else ""
