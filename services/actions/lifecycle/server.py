"""An action server: accepts goals, runs one at a time, and replies to cancels and requests for results."""

from collections import deque
from collections.abc import Iterator
from typing import Any

import msgspec

from jezero.runtime.service import Health, Inbox, Output, Reply, Request, SetRate, Spec, Subscribe
from jezero.schemas.actions import Accepted, CancelReply, PlanReply, Rejected, Result, ResultReply, RunningGoal
from jezero.schemas.goals import Goal
from jezero.schemas.images import GetImage
from jezero.schemas.rows import Action
from jezero.schemas.state import STATUS_WORDS, Status, StatusCode
from jezero.schemas.topics import (
    ACQUIRE,
    ALTIMETER,
    CAMERA_PITCH,
    CLOCK,
    FENCE,
    LEASE,
    ODOMETRY,
    RELATIVE,
    RELEASE,
    RESULT,
    ROVER_ESTIMATE,
    SETPOINT,
    STATUS,
    feedback_of,
)
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.goal_run import GoalRun
from jezero.services.actions.lifecycle.guard import GuardedPlanner
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.running_goal_requests import RunningGoalRequests, not_running_reason
from jezero.services.actions.lifecycle.vehicle_view import STATUS_AGE_MAX_S, hovering_at, is_fresh
from jezero.services.actions.motion.behaviour import Plan, Planner, Refusal
from jezero.services.actions.motion.capture import CAPTURE_INPUTS
from jezero.services.actions.motion.limits import beyond_limits

EXPIRY_S = 30.0
"""Older goals are refused: what they were for may be over."""
RESULTS_MAX = 100
GOAL_AHEAD_MAX_NS = NS_PER_S
"""A goal that was issued farther in the future is from before a restart of the vehicle."""
PLAN_ONLY = "plan_from_ned_m is for requests for a plan: a goal is flown from where the vehicle is"
CANCELED_EARLY = "the goal was canceled before it arrived: send it again with another goal_id"
UNWATCHED = "on_client_loss has no effect: the goal names no client whose liveliness could be watched"


class ActionServer:
    """The service of one action.

    Args:
        planner: plans the action's goals.
        boot_id: differs between two runs, so that ids of goals do too.
        pictures: store of the pictures, for actions that take some; by default in a temporary folder.
    """

    def __init__(
        self,
        action: Action[Any],
        planner: Planner,
        config: ActionsConfig,
        boot_id: int,
        pictures: PictureStore | None = None,
    ) -> None:
        self._action = action
        self._endpoint = action.endpoint
        self._plan = action.plan
        self._cancel = action.cancel
        self._planner = GuardedPlanner(action.name, planner)
        self._running = RunningGoalRequests(action, self._planner)
        self._config = config
        self._boot_id = boot_id
        self._pictures = (pictures or PictureStore()) if action.takes_pictures else None
        self._goals_made = 0
        self._run: GoalRun | None = None
        self._results: dict[str, Result[Any]] = {}
        self._canceled_early: deque[str] = deque(maxlen=RESULTS_MAX)
        """Ids of goals whose cancel came before them, as after a gap in a connection."""
        self._health: Health | None = None
        takes = action.takes_pictures
        self.spec = Spec(
            name=action.name,
            inputs=(STATUS, CLOCK, FENCE),
            on_demand=(ODOMETRY, RELATIVE, ROVER_ESTIMATE, *(CAPTURE_INPUTS if takes else (ALTIMETER,))),
            outputs=(SETPOINT, feedback_of(action), *((CAMERA_PITCH,) if takes else ())),
            serves=(*action.endpoints, RESULT),
            calls=(ACQUIRE, RELEASE, LEASE),
            triggers=(ODOMETRY.name, RELATIVE.name, RESULT.name, *(endpoint.name for endpoint in action.endpoints)),
            rate_hz=config.lifecycle.step_rate_hz,
            watches="client",
            made_with={"name": action.name, "boot_id": boot_id, "config": config},
        )

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Step the goal that runs, then handle the requests that arrived."""
        run = self._run
        if run is not None:
            yield from run.step(t_ns, inbox)
            if run.stage == "over":
                yield from self._end(run)
        for request in inbox.requests(self._endpoint):
            yield from self._handle_goal(t_ns, request, inbox)
        for request in inbox.requests(self._plan):
            yield from self._handle_plan_request(t_ns, request, inbox)
        self._handle_departures(inbox)
        for request in inbox.requests(self._cancel):
            yield Reply(request.request_id, self._cancel_reply(request.payload.goal_id, request.client_id))
        yield from self._running.handle(t_ns, inbox, self._run, self._results)
        for request in inbox.requests(RESULT):
            yield Reply(request.request_id, self._result_reply(request.payload.goal_id))
        for request in inbox.requests(self._action.describe):
            yield Reply(request.request_id, self._action.description)
        for request in inbox.requests(self._action.running):
            yield Reply(request.request_id, self._flown_goal())
        if self._pictures is not None:
            for request in inbox.requests(self._action.image):
                wanted: GetImage = request.payload
                yield Reply(request.request_id, self._pictures.get(wanted.goal_id, wanted.index))
        health = self._health_now(t_ns, inbox)
        if health != self._health:
            self._health = health
            yield health

    def _end(self, run: GoalRun) -> Iterator[Output]:
        self._run = None
        if run.result is not None:
            self._keep(run.result)
        yield Subscribe(())
        yield SetRate(None)

    def _keep(self, result: Result[Any]) -> None:
        self._results[result.goal_id] = result
        if len(self._results) > RESULTS_MAX:
            del self._results[next(iter(self._results))]

    # -- goals --

    def _handle_goal(self, t_ns: int, request: Request, inbox: Inbox) -> Iterator[Output]:
        goal: Goal = request.payload
        status = inbox.latest(STATUS)
        if self._run is not None and self._run.plan_only:
            # Somebody wants to fly: whoever only asks for a plan asks again.
            yield from self._run.reject("another goal came first: ask for the plan again", inbox)
            yield from self._end(self._run)
        if self._run is not None and goal.goal_id and goal.goal_id == self._run.goal_id:
            yield from self._run.attach(request)
            return
        if goal.goal_id in self._results:
            yield Reply(request.request_id, Accepted(goal_id=goal.goal_id), final=False)
            yield Reply(request.request_id, self._results[goal.goal_id])
            return
        if goal.goal_id in self._canceled_early:
            code = None if status is None else status.code
            yield Reply(request.request_id, Rejected(goal_id=goal.goal_id, reason=CANCELED_EARLY, code=code))
            return
        plan = self._plan_of(t_ns, goal, status) if goal.plan_from_ned_m is None else Refusal(PLAN_ONLY)
        if isinstance(plan, Refusal) or status is None:
            code, reason = (None if status is None else status.code), plan.reason if isinstance(plan, Refusal) else ""
            yield Reply(request.request_id, Rejected(goal_id=goal.goal_id, reason=reason, code=code))
            return
        yield from self._begin(t_ns, request, plan, status, inbox)

    def _handle_plan_request(self, t_ns: int, request: Request, inbox: Inbox) -> Iterator[Output]:
        status, start_ned_m = inbox.latest(STATUS), request.payload.plan_from_ned_m
        beyond = "" if start_ned_m is None else beyond_limits(start_ned_m, self._config.vehicle.limits)
        if status is not None and start_ned_m is not None:
            status = hovering_at(status, start_ned_m)
        plan = Refusal(f"plan_from_ned_m: {beyond}") if beyond else self._plan_of(t_ns, request.payload, status)
        if isinstance(plan, Refusal) or status is None:
            code, reason = (None if status is None else status.code), plan.reason if isinstance(plan, Refusal) else ""
            yield Reply(request.request_id, PlanReply(accepted=False, reason=reason, code=code))
            return
        yield from self._begin(t_ns, request, plan, status, inbox, plan_only=True)

    def _plan_of(self, t_ns: int, goal: Goal, status: Status | None) -> Plan | Refusal:
        refusal = self._refusal(t_ns, goal, status)
        if refusal or status is None:
            return Refusal(refusal)
        return self._planner.plan(goal, status)

    def _begin(
        self, t_ns: int, request: Request, plan: Plan, status: Status, inbox: Inbox, *, plan_only: bool = False
    ) -> Iterator[Output]:
        """Begin the life of a goal, or of one that is only planned."""
        goal: Goal = request.payload
        unwatched = goal.on_client_loss == "cancel" and not request.client_id
        self._goals_made += 1
        made_id = f"{self._action.name}-{self._boot_id:x}-{self._goals_made}"
        self._run = GoalRun(
            action=self._action,
            goal=goal,
            goal_id=made_id if plan_only else goal.goal_id or made_id,
            plan=plan,
            warning="; ".join(text for text in (plan.warning, UNWATCHED if unwatched else "") if text),
            config=self._config,
            epoch_id=status.epoch_id,
            pictures=self._pictures,
            plan_only=plan_only,
        )
        yield from self._run.attach(request)
        yield from self._run.begin(t_ns, inbox)

    def _refusal(self, t_ns: int, goal: Goal, status: Status | None) -> str:
        """Reason why no goal at all can start now, or ""."""
        if status is None:
            return "the vehicle's status is unknown: is vehicle_bridge running?"
        if not is_fresh(status, t_ns, STATUS_AGE_MAX_S):
            return f"the vehicle's status is {(t_ns - status.t_ns) / NS_PER_S:.1f} s old: is vehicle_bridge running?"
        if stale := self._staleness(t_ns, goal):
            return stale
        if self._run is not None:
            return _busy(self._run, self._action.name, status)
        if status.odometry is None:
            return f"the vehicle's position is unknown: {status.not_ready_reason or 'no odometry yet'}"
        return ""

    def _staleness(self, t_ns: int, goal: Goal) -> str:
        """Reason why a goal is too old, or from before the vehicle restarted, or ""."""
        age_ns = 0 if goal.issued_t_ns is None else t_ns - goal.issued_t_ns
        if age_ns > EXPIRY_S * NS_PER_S:
            return f"the goal is {age_ns / NS_PER_S:.0f} s old and expired after {EXPIRY_S:g} s: send it again"
        if age_ns < -GOAL_AHEAD_MAX_NS:
            return f"the goal was issued {-age_ns / NS_PER_S:.0f} s in the future: the vehicle restarted, send it again"
        return ""

    # -- clients, cancels, results --

    def _handle_departures(self, inbox: Inbox) -> None:
        run = self._run
        if run is None or not run.clients:
            return
        run.clients = [client for client in run.clients if client not in inbox.departed]
        if not run.clients and (run.plan_only or run.goal.on_client_loss == "cancel"):
            run.cancel("its client vanished")

    def _flown_goal(self) -> RunningGoal:
        """The goal that is flown; a goal that is not accepted yet, or only planned, is none."""
        run = self._run
        if run is None or not run.is_flown:
            return RunningGoal(action=self._action.name)
        return RunningGoal(
            action=self._action.name,
            goal_id=run.goal_id,
            clients=tuple(run.clients),
            goal=msgspec.to_builtins(run.goal),
            coverage=run.coverage,
            images=() if run.capture is None else run.capture.images(),
            path_ned_m=run.path_ned_m,
        )

    def _cancel_reply(self, goal_id: str, client_id: str) -> CancelReply:
        """Cancel a goal for whoever asks; a client that did not send it is named to those who did."""
        if self._run is not None and self._run.goal_id == goal_id:
            another = bool(client_id) and client_id not in self._run.clients
            if self._run.cancel(f"canceled by another client, {client_id}" if another else "canceled by a client"):
                return CancelReply(canceled=True)
            return CancelReply(canceled=False, reason="the goal is ending already")
        if goal_id not in self._results:
            self._canceled_early.append(goal_id)
        return CancelReply(canceled=False, reason=not_running_reason(goal_id, self._results, self._action.name))

    def _result_reply(self, goal_id: str) -> ResultReply | None:
        """Reply to a request for a result; None without one, because another action's server may know the goal."""
        name = self._action.name
        if self._run is not None and self._run.goal_id == goal_id:
            return ResultReply(goal_id=goal_id, action=name, running=True)
        result = self._results.get(goal_id)
        if result is None:
            return None
        return ResultReply(goal_id=goal_id, action=name, running=False, result=msgspec.json.encode(result).decode())

    def _health_now(self, t_ns: int, inbox: Inbox) -> Health:
        status = inbox.latest(STATUS)
        if status is None:
            return Health("starting", "waiting for the vehicle's status")
        if not is_fresh(status, t_ns, STATUS_AGE_MAX_S):
            return Health("degraded", "the vehicle's status doesn't arrive any more")
        if self._run is not None:
            return Health("ok", f"{self._run.stage} a goal")
        return Health("ok", "ready for a goal")


def _busy(run: GoalRun, action: str, status: Status) -> str:
    """Reason why a goal can't start beside the present one."""
    if run.plan_only:
        return "busy: another goal is being planned; try again in a second"
    words = (
        f"another goal {action.replace('_', ' ')} is running, and the vehicle {STATUS_WORDS[StatusCode(status.code)]}"
    )
    return f"busy: {words}; cancel it or wait for its result"
