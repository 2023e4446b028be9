"""The server of one action, and the life of its goals, in the order in which a goal lives it.

`ActionServer` handles the requests of clients: it refuses a goal or lets it begin, runs one at a time, and keeps the
results. `GoalRun` is the life of one goal:

    new -> admitting -> checking -> preparing -> acquiring -> flying -> releasing -> over

A goal is admitting, checking or preparing where it needs that. It is accepted when the bridge has given it control, and
ends exactly once. A goal that is only planned ends before acquiring. While a goal flies, it can be paused
(`PauseControl`) and its fields can change (`Modification`).
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Literal

import msgspec

from jezero.base.frames import Vec3, add, geodetic_from_ned
from jezero.base.mistakes import mistake, own_fields, unknown
from jezero.base.vehicle_config import BatteryConfig
from jezero.runtime.service import (
    BackgroundTask,
    Call,
    CancelTask,
    Health,
    Inbox,
    Output,
    Publish,
    Reply,
    Request,
    Response,
    SetRate,
    Spec,
    Subscribe,
)
from jezero.schemas.actions import (
    Accepted,
    CancelReply,
    Feedback,
    FeedbackMessage,
    Modify,
    ModifyReply,
    Pause,
    PauseReply,
    PlannedCoverage,
    PlanReply,
    Rejected,
    Result,
    ResultReply,
    Resume,
    ResumeReply,
    RunningGoal,
)
from jezero.schemas.commands import Acquire, AcquireReply, CameraPitch, Release, ReleaseReply, Setpoint
from jezero.schemas.goals import Goal, ImagesFeedback, LandFeedback, MoveFeedback
from jezero.schemas.images import GetImage
from jezero.schemas.rows import Action
from jezero.schemas.state import STATUS_WORDS, Odometry, Status, StatusCode
from jezero.schemas.struct import TEXT_MAX, Payload
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
from jezero.services.actions.lifecycle.guard import GuardedPlanner
from jezero.services.actions.lifecycle.leases import STATUS_AGE_MAX_S, ControlLease, SelectionLease
from jezero.services.actions.lifecycle.pause_control import PauseControl
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.protection import FlightProtection, battery_refusal, fence_refusal
from jezero.services.actions.lifecycle.steering import Steering
from jezero.services.actions.lifecycle.vehicle_view import ODOMETRY_AGE_MAX_S, VehicleView, hovering_at, is_fresh
from jezero.services.actions.motion.behaviour import (
    Behaviour,
    Done,
    Move,
    Plan,
    Planner,
    Preparation,
    Prepared,
    Refusal,
    Remaining,
    Start,
    VehicleState,
    path_of,
    pause_refusal_of,
    remaining_of,
)
from jezero.services.actions.motion.capture import CAPTURE_INPUTS
from jezero.services.actions.motion.limits import high_or_far_refusal

EXPIRY_S = 30.0
"""Older goals and requests have no effect: what they were for may be over."""
AHEAD_MAX_S = 1.0
"""A goal or request that was issued farther in the future is from before a restart of the vehicle."""
RESULTS_MAX = 100
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
            on_demand=(
                *(ODOMETRY, RELATIVE, ROVER_ESTIMATE),
                *(CAPTURE_INPUTS if takes else (ALTIMETER,)),
                *(() if action.steered_by is None else (action.steered_by,)),
            ),
            outputs=(SETPOINT, feedback_of(action), *((CAMERA_PITCH,) if takes or action.points_camera else ())),
            serves=(*action.endpoints, RESULT),
            calls=(ACQUIRE, RELEASE, LEASE),
            triggers=(ODOMETRY.name, RELATIVE.name, RESULT.name, *(endpoint.name for endpoint in action.endpoints)),
            rate_hz=config.lifecycle.step_rate_hz,
            watches="client",
            made_with={"name": action.name, "boot_id": boot_id, "config": config},
        )
        self._planner = GuardedPlanner(action, planner, self.spec)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Step the goal that runs, then handle the requests that arrived."""
        run, action = self._run, self._action
        if run is not None:
            yield from run.step(t_ns, inbox)
            if run.stage == "over":
                yield from self._end(run)
        for request in inbox.requests(action.endpoint):
            yield from self._handle_goal(t_ns, request, inbox)
        for request in inbox.requests(action.plan):
            yield from self._handle_plan_request(t_ns, request, inbox)
        self._handle_departures(inbox)
        yield from self._handle_changes(t_ns, inbox)
        yield from self._handle_questions(inbox)
        health = self._health_now(t_ns, inbox)
        if health != self._health:
            self._health = health
            yield health

    def _health_now(self, t_ns: int, inbox: Inbox) -> Health:
        status = inbox.latest(STATUS)
        if status is None:
            return Health("starting", "waiting for the vehicle's status")
        if not is_fresh(status, t_ns, STATUS_AGE_MAX_S):
            return Health("degraded", "the vehicle's status doesn't arrive any more")
        if self._run is not None:
            return Health("ok", f"{self._run.stage} a goal")
        return Health("ok", "ready for a goal")

    # -- a goal arrives: it is refused, or begins --

    def _handle_goal(self, t_ns: int, request: Request, inbox: Inbox) -> Iterator[Output]:
        goal: Goal = request.payload
        status = inbox.latest(STATUS)
        code = None if status is None else status.code
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
            yield Reply(request.request_id, Rejected(goal_id=goal.goal_id, reason=CANCELED_EARLY, code=code))
            return
        plan = self._plan_of(t_ns, goal, status) if goal.plan_from_ned_m is None else Refusal(PLAN_ONLY)
        if isinstance(plan, Refusal):
            yield Reply(request.request_id, Rejected(goal_id=goal.goal_id, reason=plan.reason, code=code))
            return
        yield from self._begin(t_ns, request, plan, inbox)

    def _handle_plan_request(self, t_ns: int, request: Request, inbox: Inbox) -> Iterator[Output]:
        status, start_ned_m = inbox.latest(STATUS), request.payload.plan_from_ned_m
        beyond = "" if start_ned_m is None else high_or_far_refusal(start_ned_m, self._config.vehicle.limits)
        if status is not None and start_ned_m is not None:
            status = hovering_at(status, start_ned_m)
        plan = Refusal(f"plan_from_ned_m: {beyond}") if beyond else self._plan_of(t_ns, request.payload, status)
        if isinstance(plan, Refusal):
            code = None if status is None else status.code
            yield Reply(request.request_id, PlanReply(accepted=False, reason=plan.reason, code=code))
            return
        yield from self._begin(t_ns, request, plan, inbox, plan_only=True)

    def _plan_of(self, t_ns: int, goal: Goal, status: Status | None) -> Plan | Refusal:
        refusal = self._refusal(t_ns, goal, status)
        if refusal or status is None:
            return Refusal(refusal)
        return self._planner.plan(goal, status)

    def _refusal(self, t_ns: int, goal: Goal, status: Status | None) -> str:
        """Reason why no goal at all can start now, or ""."""
        if status is None:
            return "the vehicle's status is unknown: is vehicle_bridge running?"
        if not is_fresh(status, t_ns, STATUS_AGE_MAX_S):
            return f"the vehicle's status is {(t_ns - status.t_ns) / NS_PER_S:.1f} s old: is vehicle_bridge running?"
        if stale := _stale_refusal("goal", t_ns, goal.issued_t_ns):
            return stale
        if self._run is not None:
            return _busy_refusal(self._run, self._action.name, status)
        if status.odometry is None:
            return f"the vehicle's position is unknown: {status.not_ready_reason or 'no odometry yet'}"
        return ""

    def _begin(
        self, t_ns: int, request: Request, plan: Plan, inbox: Inbox, *, plan_only: bool = False
    ) -> Iterator[Output]:
        """Begin the life of a goal, or of one that is only planned."""
        goal: Goal = request.payload
        status = inbox.latest(STATUS)
        unwatched = goal.on_client_loss == "cancel" and not request.client_id
        self._goals_made += 1
        made_id = f"{self._action.name}-{self._boot_id:x}-{self._goals_made}"
        self._run = GoalRun(
            t_ns,
            action=self._action,
            goal=goal,
            goal_id=made_id if plan_only else goal.goal_id or made_id,
            plan=plan,
            warning=_joined(plan.warning, UNWATCHED if unwatched else ""),
            config=self._config,
            epoch_id=0 if status is None else status.epoch_id,  # without a status there is no plan
            pictures=self._pictures,
            plan_only=plan_only,
        )
        yield from self._run.attach(request)
        yield from self._run.begin(t_ns, inbox)
        if self._run.stage == "over":  # or whoever sends the same goal in this step too would wait in vain
            yield from self._end(self._run)

    # -- requests about a goal --

    def _handle_changes(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Handle the requests that end, pause or change a goal."""
        action = self._action
        for request in inbox.requests(action.cancel):
            yield Reply(request.request_id, self._cancel_reply(request.payload.goal_id, request.client_id))
        for request in inbox.requests(action.pause):
            reason = self._change("pause", t_ns, request.payload, lambda run: run.pause(t_ns, inbox))
            yield Reply(request.request_id, PauseReply(paused=not reason, reason=reason))
        for request in inbox.requests(action.resume):
            reason = self._change("pause", t_ns, request.payload, GoalRun.resume)
            yield Reply(request.request_id, ResumeReply(resumed=not reason, reason=reason))
        for request in inbox.requests(action.modify):
            modify = partial(GoalRun.modify, t_ns=t_ns, wanted=request, planner=self._planner, inbox=inbox)
            if reason := self._change("modify", t_ns, request.payload, modify):  # else the goal's run replies later
                yield Reply(request.request_id, ModifyReply(modified=False, reason=reason))

    def _handle_questions(self, inbox: Inbox) -> Iterator[Output]:
        """Reply to the requests that have no effect."""
        action = self._action
        for request in inbox.requests(RESULT):
            yield Reply(request.request_id, self._result_reply(request.payload.goal_id))
        for request in inbox.requests(action.describe):
            yield Reply(request.request_id, action.description)
        for request in inbox.requests(action.running):
            yield Reply(request.request_id, self._flown_goal())
        if self._pictures is not None:
            for request in inbox.requests(action.image):
                wanted: GetImage = request.payload
                yield Reply(request.request_id, self._pictures.get(wanted.goal_id, wanted.index))

    def _handle_departures(self, inbox: Inbox) -> None:
        run = self._run
        if run is None or not run.clients:
            return
        run.clients = [client for client in run.clients if client not in inbox.departed]
        if not run.clients and (run.plan_only or run.goal.on_client_loss == "cancel"):
            run.cancel("its client vanished")

    def _cancel_reply(self, goal_id: str, client_id: str) -> CancelReply:
        """Cancel a goal for whoever asks; a client that did not send it is named to those who did."""
        if self._run is not None and self._run.goal_id == goal_id:
            another = bool(client_id) and client_id not in self._run.clients
            if self._run.cancel(f"canceled by another client, {client_id}" if another else "canceled by a client"):
                return CancelReply(canceled=True)
            return CancelReply(canceled=False, reason="the goal is ending already")
        if goal_id not in self._results:
            self._canceled_early.append(goal_id)
        return CancelReply(canceled=False, reason=self._not_running_refusal(goal_id))

    def _change(
        self,
        kind: Literal["pause", "modify"],
        t_ns: int,
        wanted: Pause | Resume | Modify,
        change: Callable[["GoalRun"], str],
    ) -> str:
        """Pause, resume or modify the goal; returns the reason why that is impossible, or ""."""
        run = self._run
        if run is None or run.goal_id != wanted.goal_id or run.plan_only:
            return self._not_running_refusal(wanted.goal_id)
        if stale := _stale_refusal("request", t_ns, wanted.issued_t_ns, run.requested_ns[kind]):
            return stale
        reason = change(run)
        if not reason:
            run.requested_ns[kind] = t_ns if wanted.issued_t_ns is None else wanted.issued_t_ns
        return reason

    def _not_running_refusal(self, goal_id: str) -> str:
        """Reason why nothing can be done with a goal that doesn't run."""
        if goal_id in self._results:
            outcome = self._results[goal_id].outcome
            return f"the goal {'has' if outcome == 'succeeded' else 'was'} already {outcome}"
        return f"no goal {goal_id} is known to {self._action.name}"

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

    # -- the end of a goal, and its result --

    def _end(self, run: "GoalRun") -> Iterator[Output]:
        self._run = None
        if run.result is not None:
            self._keep(run.result)
        yield Subscribe(())
        yield SetRate(None)

    def _keep(self, result: Result[Any]) -> None:
        self._results[result.goal_id] = result
        if len(self._results) > RESULTS_MAX:
            del self._results[next(iter(self._results))]

    def _result_reply(self, goal_id: str) -> ResultReply | None:
        """Reply to a request for a result; None without one, because another action's server may know the goal."""
        name = self._action.name
        if self._run is not None and self._run.goal_id == goal_id:
            return ResultReply(goal_id=goal_id, action=name, running=True)
        result = self._results.get(goal_id)
        if result is None:
            return None
        return ResultReply(goal_id=goal_id, action=name, running=False, result=msgspec.json.encode(result).decode())


def _busy_refusal(run: "GoalRun", action: str, status: Status) -> str:
    """Reason why a goal can't start beside the present one."""
    if run.plan_only:
        return "busy: another goal is being planned; try again in a second"
    words = (
        f"another goal {action.replace('_', ' ')} is running, and the vehicle {STATUS_WORDS[StatusCode(status.code)]}"
    )
    return f"busy: {words}; cancel it or wait for its result"


def _stale_refusal(noun: str, t_ns: int, issued_t_ns: int | None, last_ns: int = 0) -> str:
    """Reason why a goal or a request is too old, from before a restart, or overtaken by a newer one, or "".

    Args:
        last_ns: issue time of the last request of this kind. A request may arrive late, or twice: one that is older
            than the last one has no effect.
    """
    if issued_t_ns is None:
        return ""
    age_s = (t_ns - issued_t_ns) / NS_PER_S
    if age_s > EXPIRY_S:
        return f"the {noun} is {age_s:.0f} s old and expired after {EXPIRY_S:g} s: send it again"
    if age_s < -AHEAD_MAX_S:
        return f"the {noun} was issued {-age_s:.0f} s in the future: the vehicle restarted, send it again"
    return "a newer request came before this one" if issued_t_ns < last_ns else ""


ACQUIRE_TIMEOUT_S = 1.0
"""Time-out of the bridge's reply; the bridge refuses older requests."""
CHECK_TIMEOUT_S = 1.5
"""Time-out of the inputs of a goal whose inputs are checked before it is accepted."""
NO_REPLY = "the vehicle bridge did not reply"
POSITION_LOST = "the vehicle's position is not known any more: is vehicle_bridge running?"
POSITION_CORRECTED = "the autopilot corrected its position while the flight was planned: send the goal again"
POSITION_UNKNOWN = "the vehicle's position is unknown"
SETPOINT_RATE_HZ = 50.0
"""Rate while a goal runs; a plan may ask for more setpoints."""
SETPOINT_RATE_MIN_HZ = 25.0
"""Rate while no odometry comes: at the start of a goal, and after the bridge has stood still for a moment."""
FIRST_SETPOINT_HZ = 100.0
"""The first setpoint follows the acceptance and the first feedback after 10 ms: a client that waits for these would
otherwise share the processors with the services that the setpoint wakes."""
CAMERA_PITCH_PERIOD_NS = 45_000_000
"""A little less than the period of `command/camera_pitch`, because steps don't come evenly."""
FEEDBACK_PERIOD_NS = 100_000_000
RELEASE_HOVER_TIMEOUT_S, RELEASE_DISARM_TIMEOUT_S = 6.0, 12.0
"""Time-outs of one reply to a release that hovers or disarms; the release is sent again after it."""
RELEASE_GIVE_UP_S = 20.0
"""Longest wait for the bridge's reply to a release; then the goal ends without it."""
RELEASE_RETRY_S = 0.2
Stage = Literal["new", "admitting", "checking", "preparing", "acquiring", "flying", "releasing", "over"]


class GoalRun:
    """The life of one goal.

    Args:
        t_ns: time of its arrival.
        epoch_id: of the vehicle that the goal is for.
        pictures: store of the pictures, for actions that take some.
        plan_only: reply with duration and length of the flight instead of flying.

    Attributes:
        stage: of its life.
        action: that the goal is for.
        goal: as it was sent, or with the fields that have changed since.
        goal_id: its id.
        config: settings of all actions.
        clients: that sent it and are still connected.
        capture: the pictures that it takes, if it does.
        plan_only: whether it is only planned.
        requested_ns: issue times of the last requests that changed it, by their kind; a resume counts as a pause.
        behaviour: that flies it; there is one from the stage `acquiring` on.
        coverage: plan of an area coverage, as soon as there is one.
        path_ned_m: (n, 3) corners of the way that was planned last, as soon as there is one.
        result: its result; None until it is over, and for a goal that was rejected.
    """

    def __init__(
        self,
        t_ns: int,
        *,
        action: Action[Any],
        goal: Goal,
        goal_id: str,
        plan: Plan,
        warning: str,
        config: ActionsConfig,
        epoch_id: int,
        pictures: PictureStore | None = None,
        plan_only: bool = False,
    ) -> None:
        self.stage: Stage = "new"
        self.action = action
        self.goal = goal
        self.goal_id = goal_id
        self.config = config
        self.clients: list[str] = []
        self.capture = plan.capture
        self.plan_only = plan_only
        self.requested_ns = {"pause": 0, "modify": 0}
        self.behaviour: Behaviour
        self.coverage = plan.coverage
        self.path_ned_m: tuple[Vec3, ...] = ()
        self.result: Result[Any] | None = None
        self._arrived_ns = t_ns
        self._plan = plan
        self._accepted = Accepted(goal_id=goal_id, warning=warning)
        self._pictures = pictures
        self._inputs = tuple(
            dict.fromkeys((ALTIMETER, *plan.inputs, *(() if plan.capture is None else CAPTURE_INPUTS)))
        )
        """Topics that the goal subscribes to besides odometry."""
        self._control = ControlLease(epoch_id)
        self._selection = None if plan.selection is None or plan_only else SelectionLease(goal_id, plan.selection)
        self._view = VehicleView(
            epoch_id, self._selection, self._inputs, goal.plan_from_ned_m, Steering.of(goal_id, action)
        )
        self._protection: FlightProtection
        """Made with the behaviour."""
        self._pause = PauseControl(t_ns, config.move.accel_mps2)
        self._preparation: PreparationRun | None = None
        self._modification: Modification | None = None
        self._changes = 0
        """Number of changes of the goal in force so far."""
        self._cancel_reason = ""
        self._watchers: list[int] = []
        """Ids of the requests that get replies."""
        self._tag = ""
        """Tag of the call to the bridge whose reply is awaited."""
        self._deadline_ns = 0
        """Deadline of the reply or event that the present stage waits for."""
        self._move: Move | None = None
        """The last setpoint of the behaviour."""
        self._sequence = 0
        self._setpoint_ns = 0
        self._pitch_due_ns = 0
        self._first_step = True
        self._first_feedback: Feedback[Any] | None = None
        """Feedback of the behaviour's start, until something newer arrives."""
        self._feedback_due_ns = 0
        self._done = Done("aborted")
        """End of the behaviour, while control is released."""
        self._releases = 0
        """Number of calls that release control so far."""
        self._release_due_ns: int | None = None

    @property
    def is_flown(self) -> bool:
        """Whether the goal has been accepted and has not ended."""
        return self.stage in ("flying", "releasing")

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the present stage."""
        self._store_pictures(t_ns, inbox)
        self._view.update(t_ns, inbox)
        if self.stage == "admitting":
            yield from self._await_admission(t_ns, inbox)
        elif self.stage == "checking":
            yield from self._await_inputs(t_ns, inbox)
        elif self.stage == "preparing" and self._preparation is not None:
            yield from self._await_preparation(t_ns, inbox, self._preparation)
        elif self.stage == "acquiring":
            yield from self._await_control(t_ns, inbox)
        elif self.stage == "flying":
            yield from self._fly(t_ns, inbox)
        elif self.stage == "releasing":
            yield from self._await_release(t_ns, inbox)
        if self._modification is not None:
            yield from self._modification.step(t_ns, inbox)

    # -- new: who sent it, and whether it may go on --

    def attach(self, request: Request) -> Iterator[Output]:
        """Add a watcher: the sender of this goal, or a second one when the goal was sent twice."""
        self._watchers.append(request.request_id)
        if request.client_id and request.client_id not in self.clients:
            self.clients.append(request.client_id)
        if self.is_flown:
            yield Reply(request.request_id, self._accepted, final=False)

    def begin(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Begin with the acquisition of control; ask the bridge first where something else takes time before that.

        So a goal that the bridge would refuse anyway is refused with that reason, and not with a missing input.
        """
        if self.goal.plan_from_ned_m is not None:  # what the bridge says of the vehicle as it is now doesn't matter
            yield from self._check(t_ns, inbox)
            return
        immediate = self._plan.check_inputs is None and not isinstance(self._plan.start, Preparation)
        if immediate and not self.plan_only:
            yield from self._prepare(t_ns, inbox)
            return
        self.stage = "admitting"
        yield self._call_acquire(t_ns, "admit", check_only=True)

    def _call_acquire(self, t_ns: int, word: str, *, check_only: bool = False) -> Call:
        """Request control from the bridge, or only whether the goal would get it."""
        self._tag = f"{self.goal_id}/{word}/{t_ns}"
        self._deadline_ns = t_ns + int((ACQUIRE_TIMEOUT_S + 0.5) * NS_PER_S)  # somewhat after the call's own time-out
        request = Acquire(
            goal_id=self.goal_id,
            action=self.action.name,
            do_takeoff=self._plan.do_takeoff,
            issued_t_ns=t_ns,
            goal_t_ns=self._arrived_ns,
            goal_issued_t_ns=self.goal.issued_t_ns,
            override=self._plan.override,
            check_only=check_only,
        )
        return Call(ACQUIRE, request, self._tag, ACQUIRE_TIMEOUT_S)

    def _grant(self, t_ns: int, inbox: Inbox) -> AcquireReply | Refusal | None:
        """The bridge's reply to the call; None while it may come."""
        response = _response_to(inbox, self._tag)
        if response is None:
            return Refusal(NO_REPLY) if t_ns > self._deadline_ns else None
        reply: AcquireReply | None = response.payload
        if reply is None:
            return Refusal(f"{NO_REPLY}: {response.error}")
        return reply if reply.granted else Refusal(reply.reason)

    def _await_admission(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on when the bridge would grant control."""
        grant = self._grant(t_ns, inbox)
        if self._cancel_reason:
            yield from self.reject(self._cancel_reason, inbox)
        elif isinstance(grant, Refusal):
            yield from self.reject(grant.reason, inbox)
        elif grant is not None:
            yield from self._check(t_ns, inbox)

    def reject(self, reason: str, inbox: Inbox, *, input_missing: bool = False) -> Iterator[Output]:
        """End a goal that hasn't been accepted yet."""
        status = inbox.latest(STATUS)
        code = None if status is None else status.code
        refused: Payload = Rejected(goal_id=self.goal_id, reason=reason, code=code)
        if self.plan_only:
            refused = PlanReply(accepted=False, reason=reason, code=code, input_missing=input_missing)
        yield from (Reply(watcher, refused) for watcher in self._watchers)
        if self.stage == "preparing" and self._preparation is not None:
            yield self._preparation.end()
        self.stage = "over"

    # -- checking: the inputs that the goal needs have come --

    def _check(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Wait for the inputs, where they decide about the goal or about its plan."""
        if self._plan.check_inputs is None and not (self.plan_only and self._plan.inputs):
            yield from self._prepare(t_ns, inbox)
            return
        self.stage = "checking"
        self._deadline_ns = t_ns + int(CHECK_TIMEOUT_S * NS_PER_S)
        yield Subscribe((ODOMETRY, *self._inputs))

    def _await_inputs(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on or refuse as soon as every input has come, or the time for it is over."""
        if self._cancel_reason:
            yield from self.reject(self._cancel_reason, inbox)
            return
        odometry = self._view.odometry(inbox)
        complete = all(inbox.latest(topic) is not None for topic in self._plan.inputs)
        complete = complete and (self.capture is None or not self.capture.refusal())
        if not (complete and odometry is not None) and t_ns <= self._deadline_ns:
            return
        if odometry is None:
            yield from self.reject(POSITION_LOST, inbox)
            return
        self._view.begin(odometry)
        check = self._plan.check_inputs
        reason = "" if check is None else check(self._state(t_ns, inbox, odometry))
        yield from self.reject(reason, inbox, input_missing=True) if reason else self._prepare(t_ns, inbox)

    # -- preparing: work that takes too long for a step --

    def _prepare(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Start the preparation, if the goal needs one, else acquire control."""
        start = self._plan.start
        if not isinstance(start, Preparation):
            yield from self._acquire(t_ns, inbox, start)
            return
        odometry = self._view.odometry(inbox)
        if odometry is None:
            yield from self.reject(POSITION_LOST, inbox)
            return
        self.stage = "preparing"
        self._view.begin(odometry)
        state = self._state(t_ns, inbox, odometry)
        self._preparation = PreparationRun(t_ns, self.action, self.goal_id, start, state)
        yield self._preparation.begin()

    def _await_preparation(self, t_ns: int, inbox: Inbox, preparation: "PreparationRun") -> Iterator[Output]:
        """Go on or refuse when the work is done; a cancel doesn't wait for it."""
        if self._cancel_reason:
            yield from self.reject(self._cancel_reason, inbox)
            return
        odometry, outcome = self._view.odometry(inbox), preparation.outcome(t_ns, inbox)
        if isinstance(outcome, Refusal):
            yield from self.reject(outcome.reason, inbox)
        elif outcome is not None:
            self._warn(outcome.warning)
            self.coverage = outcome.coverage
            yield from self._acquire(t_ns, inbox, outcome.start)
        elif odometry is not None:
            yield from preparation.feedback(t_ns, self._state(t_ns, inbox, odometry), inbox.latest(STATUS))

    def _warn(self, warning: str) -> None:
        """Add a warning to the acceptance of the goal."""
        self._accepted = msgspec.structs.replace(self._accepted, warning=_joined(self._accepted.warning, warning))

    # -- acquiring: the behaviour starts, and the bridge gives it control --

    def _acquire(self, t_ns: int, inbox: Inbox, start: Start) -> Iterator[Output]:
        """Start the behaviour, whose first step knows how long the flight is, and request control from the bridge.

        A goal that is only planned ends here.
        """
        odometry = self._view.odometry(inbox)
        if odometry is None:  # there was some when the goal arrived
            yield from self.reject(POSITION_LOST, inbox)
            return
        self._view.begin(odometry)
        if any(self._view.shift(odometry)):
            yield from self.reject(POSITION_CORRECTED, inbox)
            return
        self._protection = FlightProtection(self.config.vehicle, odometry, lands=self._plan.lands)
        self._pause = PauseControl(t_ns, self.config.move.accel_mps2)
        state = self._state(t_ns, inbox, odometry)
        self.behaviour = start(t_ns, state)
        move = self.behaviour.step(t_ns, state)
        planned = move if isinstance(move, Done) else remaining_of(self.behaviour, state)
        if isinstance(move, Move):
            self._first_feedback = self._feedback(t_ns, move, odometry, inbox)
        refusal = _battery_refusal(planned, self._plan, inbox, self.config.vehicle.battery)
        self.path_ned_m = path_of(self.behaviour, state)
        if refusal := refusal or fence_refusal(self.path_ned_m, self._plan, inbox):
            yield from self.reject(refusal, inbox)
            return
        if self.plan_only:
            yield from self._reply_with_plan(planned, inbox)
            return
        yield self._call_acquire(t_ns, "acquire")
        self.stage = "acquiring"

    def _reply_with_plan(self, planned: Remaining | Done | None, inbox: Inbox) -> Iterator[Output]:
        """End a goal that is only planned."""
        if isinstance(planned, Done):
            yield from self.reject(planned.reason or "the goal would end at once", inbox)
            return
        status = inbox.latest(STATUS)
        battery, consumption = None if status is None else status.battery, self.config.vehicle.battery
        reply = PlanReply(
            accepted=True,
            code=None if status is None else status.code,
            warning=self._accepted.warning,
            duration_s=None if planned is None else planned.time_s,
            distance_m=None if planned is None else planned.distance_m,
            battery_used=None if planned is None else consumption.used(planned.hover_s or planned.time_s),
            battery_remaining=None if battery is None else battery.remaining,
            battery_critical=None if battery is None else battery.critical,
            coverage=self.coverage,
            path_ned_m=self.path_ned_m,
        )
        yield from (Reply(watcher, reply) for watcher in self._watchers)
        self.stage = "over"

    def _await_control(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Accept the goal and fly when the bridge has given control."""
        grant = self._grant(t_ns, inbox)
        if isinstance(grant, Refusal):
            yield from self.reject(grant.reason, inbox)
        elif grant is None:
            self._first_feedback = None  # something newer has come before control was given
        else:
            self._warn(grant.warning)
            yield from (Reply(watcher, self._accepted, final=False) for watcher in self._watchers)
            self._control.begin(grant, t_ns)
            self.stage = "flying"
            if self._first_feedback is not None and not self._cancel_reason:
                yield from self._send_feedback(t_ns, self._first_feedback)
            yield SetRate(FIRST_SETPOINT_HZ)

    # -- flying: each new state becomes a setpoint --

    def _fly(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """End the goal where something demands it, else publish the next setpoint when it is due."""
        odometry = self._view.odometry(inbox)
        if lost := self._control.loss_reason(t_ns, inbox):
            yield from self._finish(t_ns, inbox, Done("aborted", lost))
        elif self._cancel_reason:
            yield from self._release(t_ns, Done("canceled", self._cancel_reason), inbox)
        elif odometry is None or not is_fresh(odometry, t_ns, ODOMETRY_AGE_MAX_S):
            reason = f"{POSITION_UNKNOWN}: no odometry for {ODOMETRY_AGE_MAX_S:g} s"
            yield from self._release(t_ns, Done("aborted", reason), inbox)
        elif self.capture is not None and (problem := self.capture.problem(t_ns)):
            yield from self._release(t_ns, Done("aborted", problem), inbox)
        else:
            if self._selection is not None:
                yield from self._selection.renew(t_ns, inbox, self._view.shift(odometry))
            new_state = bool(inbox.new(ODOMETRY)) or bool(inbox.new(RELATIVE))
            rate_hz = self._plan.rate_hz or SETPOINT_RATE_HZ
            if new_state or (t_ns - self._setpoint_ns) * rate_hz >= NS_PER_S:
                yield from self._step_behaviour(t_ns, inbox, odometry)
        if self._first_step:
            self._first_step = False
            yield SetRate(self._plan.rate_hz or SETPOINT_RATE_MIN_HZ)
            yield Subscribe((ODOMETRY, *self._inputs, *self._view.steered_by))

    def _step_behaviour(self, t_ns: int, inbox: Inbox, odometry: Odometry) -> Iterator[Output]:
        """Publish the behaviour's next setpoint and, when it is due, feedback; release control at its end."""
        state = self._state(t_ns, inbox, odometry)
        move = self._pause.step(t_ns, self.behaviour, state)
        if self.capture is not None:
            self.capture.behind_ns = self._pause.behind_ns
        if isinstance(move, Move) and (problem := self._protection.problem(t_ns, odometry, state, move)):
            move = Done("aborted", problem)
        if isinstance(move, Done):
            yield from self._release(t_ns, move, inbox)
            return
        self._move = move
        yield self._setpoint(t_ns, move, odometry, state.shift_ned_m)
        if move.pitch_camera_rad is not None and t_ns >= self._pitch_due_ns:
            self._pitch_due_ns = t_ns + CAMERA_PITCH_PERIOD_NS
            axes = CameraPitch(t_ns=t_ns, pitch_camera_rad=move.pitch_camera_rad, roll_camera_rad=move.roll_camera_rad)
            yield Publish(CAMERA_PITCH, axes)
        if t_ns >= self._feedback_due_ns:
            yield from self._send_feedback(t_ns, self._feedback(t_ns, move, odometry, inbox))

    def _state(self, t_ns: int, inbox: Inbox, odometry: Odometry) -> VehicleState:
        return self._view.state(t_ns, inbox, odometry, self._pause.behind_ns)

    def _setpoint(self, t_ns: int, move: Move, odometry: Odometry, shift_ned_m: Vec3) -> Publish:
        self._setpoint_ns = t_ns
        self._sequence += 1
        setpoint = Setpoint(
            t_ns=t_ns,
            control_id=self._control.id,
            sequence=self._sequence,
            phase=move.phase,
            reset_counter=odometry.reset_counter,
            pos_ned_m=None if move.pos_ned_m is None else add(move.pos_ned_m, shift_ned_m),
            vel_ned_mps=move.vel_ned_mps,
            acc_ned_mps2=move.acc_ned_mps2,
            yaw_rad=move.yaw_rad,
            yaw_rate_rps=move.yaw_rate_rps,
            paused=self._pause.paused,
        )
        return Publish(SETPOINT, setpoint)

    def _feedback(self, t_ns: int, move: Move, odometry: Odometry, inbox: Inbox) -> Feedback[Any]:
        """Feedback of the behaviour's step, with what the behaviour doesn't know."""
        rest = remaining_of(self.behaviour, self._state(t_ns, inbox, odometry))
        status, content = inbox.latest(STATUS), move.feedback
        if isinstance(content, MoveFeedback | LandFeedback | ImagesFeedback) and content.frame == "world":
            content = msgspec.structs.replace(content, pos_uav_ned_m=odometry.pos_uav_ned_m)
        if isinstance(content, ImagesFeedback) and self.capture is not None:
            taken, planned, images = self.capture.taken, self.capture.planned, self.capture.unreported_images()
            content = msgspec.structs.replace(content, taken=taken, planned=planned, images=images)
        return Feedback(
            goal_id=self.goal_id,
            t_ns=t_ns,
            code=-1 if status is None else status.code,
            feedback=content,
            remaining_s=None if rest is None else rest.time_s,
            paused=self._pause.paused,
            changes=self._changes,
        )

    def _send_feedback(self, t_ns: int, feedback: Feedback[Any]) -> Iterator[Output]:
        """Send feedback to all watchers and on the topic; the next one is due one period after this one was."""
        yield from (Reply(watcher, feedback, final=False) for watcher in self._watchers)
        is_late = t_ns - self._feedback_due_ns >= FEEDBACK_PERIOD_NS
        self._feedback_due_ns = (t_ns if is_late else self._feedback_due_ns) + FEEDBACK_PERIOD_NS
        message = FeedbackMessage(
            t_ns=feedback.t_ns,
            goal_id=feedback.goal_id,
            action=self.action.name,
            code=feedback.code,
            feedback=feedback.feedback,
            remaining_s=feedback.remaining_s,
            paused=feedback.paused,
            changes=feedback.changes,
        )
        yield Publish(feedback_of(self.action), message)

    def _store_pictures(self, t_ns: int, inbox: Inbox) -> None:
        """Write the pictures that have come to the disk at once, so that none stays in memory."""
        if self.capture is None or self._pictures is None:
            return
        for shot in self.capture.update(t_ns, inbox):
            try:
                self._pictures.keep(shot.reply(self.goal_id))
            except OSError as error:
                self.capture.fail(f"they can't be stored: {error.strerror or error}")

    # -- flying: pause, and change of its fields --

    def pause(self, t_ns: int, inbox: Inbox) -> str:
        """Pause as soon as the vehicle has braked; returns the reason why the goal can't be paused, or ""."""
        if not self._takes_changes:
            return self._not_flying_refusal
        odometry = self._view.odometry(inbox)
        if odometry is None:
            return POSITION_UNKNOWN
        refusal = pause_refusal_of(self.behaviour, self._state(t_ns, inbox, odometry))
        if refusal and not self._pause.wanted:
            return refusal
        self._pause.wanted = True
        return ""

    def resume(self) -> str:
        """Go on with a paused goal; returns the reason why it can't go on, or ""."""
        if not self._takes_changes:
            return self._not_flying_refusal
        was_wanted, self._pause.wanted = self._pause.wanted, False
        return "" if was_wanted else "the goal is not paused"

    def modify(self, t_ns: int, wanted: Request, planner: GuardedPlanner, inbox: Inbox) -> str:
        """Change fields of the goal; returns the reason why they can't change, or "" where the reply follows later."""
        status = inbox.latest(STATUS)
        if not self._takes_changes or status is None:
            return self._not_flying_refusal
        if self._modification is not None:
            return "the goal is being modified: send the request again in a moment"
        goal = changed_goal(self.action, self.goal, wanted.payload.fields)
        if isinstance(goal, Refusal):
            return goal.reason
        first = planner.replan(goal, status, self.behaviour)
        if isinstance(first, Refusal):
            return first.reason
        if isinstance(refusal := self.brake(t_ns, inbox), Refusal):
            return refusal.reason
        self._modification = Modification(self, wanted.request_id, goal, planner)
        return ""

    @property
    def _takes_changes(self) -> bool:
        """Whether the goal can be paused or modified."""
        return self.stage == "flying" and not self._cancel_reason

    @property
    def _not_flying_refusal(self) -> str:
        """Reason why the goal can be neither paused nor modified."""
        ends = self._cancel_reason or self.stage in ("releasing", "over")
        return "the goal is ending already" if ends else "the goal does not fly yet"

    def brake(self, t_ns: int, inbox: Inbox) -> VehicleState | Refusal | None:
        """Stop for a change of the goal; returns the state at rest, None until the vehicle has stopped."""
        odometry = self._view.odometry(inbox)
        if odometry is None:
            return Refusal(POSITION_UNKNOWN)
        state = self._state(t_ns, inbox, odometry)
        if not self._pause.hovers and (refusal := pause_refusal_of(self.behaviour, state)):
            return Refusal(refusal)
        self._pause.changing = True
        waits = self.capture is not None and self.capture.is_waiting
        if not self._pause.hovers or waits or self._move is None:
            return None
        held_ned_m = self._move.pos_ned_m if self._move.frame is None else None
        return state if held_ned_m is None else msgspec.structs.replace(state, pos_uav_ned_m=held_ned_m)

    def goal_time_ns(self, t_ns: int) -> int:
        """The goal's own time, which stands still in a pause, at a time of the vehicle."""
        return t_ns - self._pause.behind_ns

    def go_on_changed(
        self, goal: Goal, behaviour: Behaviour, path_ned_m: tuple[Vec3, ...], coverage: PlannedCoverage | None
    ) -> None:
        """Go on with changed fields after the stop for the change."""
        self.goal, self.behaviour, self.path_ned_m, self.coverage = goal, behaviour, path_ned_m, coverage
        self._changes += 1
        self.go_on_unchanged()

    def go_on_unchanged(self) -> None:
        """Go on after the stop for a change that was refused."""
        self._pause.changing = False
        self._modification = None

    # -- the end: cancel, release of control, result --

    def cancel(self, reason: str) -> bool:
        """End the goal at the next step; returns False when it is ending already."""
        if self.stage in ("releasing", "over"):
            return False
        self._cancel_reason = reason
        return True

    def _release(self, t_ns: int, done: Done, inbox: Inbox) -> Iterator[Output]:
        """Release control; the goal ends when the bridge has confirmed it."""
        odometry = self._view.odometry(inbox)
        if self._move is not None and odometry is not None and self.capture is not None:
            # Feedback that is not due yet, because no later one would report the last pictures.
            yield from self._send_feedback(t_ns, self._feedback(t_ns, self._move, odometry, inbox))
        self.stage = "releasing"
        self._done = done
        self._deadline_ns = t_ns + int(RELEASE_GIVE_UP_S * NS_PER_S)
        yield self._call_release(t_ns, inbox)

    def _call_release(self, t_ns: int, inbox: Inbox) -> Call:
        self._releases += 1
        self._release_due_ns = None
        self._tag = f"{self.goal_id}/release/{self._releases}/{t_ns}"
        done, odometry = self._done, self._view.odometry(inbox)
        hover_pos_ned_m = done.hover_pos_ned_m
        if hover_pos_ned_m is not None and odometry is not None:
            hover_pos_ned_m = add(hover_pos_ned_m, self._view.shift(odometry))
        release = Release(
            control_id=self._control.id,
            outcome=done.outcome,
            then=done.then,
            hover_pos_ned_m=hover_pos_ned_m,
            reset_counter=0 if odometry is None else odometry.reset_counter,
            reason=done.reason,
        )
        timeout_s = RELEASE_HOVER_TIMEOUT_S if done.then == "hover" else RELEASE_DISARM_TIMEOUT_S
        return Call(RELEASE, release, self._tag, timeout_s)

    def _await_release(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """End by the bridge's reply, or without one where none can come; until then, release again or hold on."""
        response = _response_to(inbox, self._tag)
        ended: Done | None = None
        if response is not None and response.payload is not None:
            ended = self._end_by_reply(response.payload, t_ns, inbox)
        elif response is not None:
            self._release_due_ns = t_ns + int(RELEASE_RETRY_S * NS_PER_S)
        if ended is None:
            ended = self._end_without_reply(t_ns, inbox)
        if ended is not None:
            yield from self._finish(t_ns, inbox, ended)
            return
        if self._release_due_ns is not None and t_ns >= self._release_due_ns:
            yield self._call_release(t_ns, inbox)
        status, odometry = inbox.latest(STATUS), self._view.odometry(inbox)
        still_ours = status is not None and self._control.is_ours(status)
        if self._done.outcome == "succeeded" and still_ours and self._move is not None and odometry is not None:
            yield self._setpoint(t_ns, self._move, odometry, self._view.shift(odometry))

    def _end_by_reply(self, reply: ReleaseReply, t_ns: int, inbox: Inbox) -> Done:
        """End by the bridge's reply to a release; a refused release makes a success an abort."""
        done = self._done
        if reply.released or (self._releases > 1 and self._is_settled(t_ns, inbox)):
            return done
        outcome = "aborted" if done.outcome == "succeeded" else done.outcome
        return Done(outcome, _joined(done.reason, reply.reason))

    def _is_settled(self, t_ns: int, inbox: Inbox) -> bool:
        """Whether the vehicle is in the state that the release requested, because only its reply was lost."""
        status, done = inbox.latest(STATUS), self._done
        if status is None or not is_fresh(status, t_ns, STATUS_AGE_MAX_S) or self._control.is_ours(status):
            return False
        if done.outcome == "succeeded":
            return status.code == (StatusCode.HOVER if done.then == "hover" else StatusCode.IDLE)
        return status.code in (StatusCode.IDLE, StatusCode.HOVER)

    def _end_without_reply(self, t_ns: int, inbox: Inbox) -> Done | None:
        """End when no reply can come any more, because the bridge restarted or is silent; None: a reply may come."""
        reason = self._control.bridge_loss_reason(t_ns, inbox)
        if t_ns > self._deadline_ns:
            reason = reason or "the vehicle bridge did not confirm the end of the goal"
        if not reason:
            return None
        return Done("aborted", _joined(self._done.reason, reason))

    def _finish(self, t_ns: int, inbox: Inbox, done: Done) -> Iterator[Output]:
        """End the goal with its result."""
        self.stage = "over"
        if self._selection is not None:
            yield from self._selection.end(t_ns)
        odometry = self._view.odometry(inbox)
        pos_uav_ned_m = (0.0, 0.0, 0.0) if odometry is None else odometry.pos_uav_ned_m
        self.result = Result(
            goal_id=self.goal_id,
            t_ns=t_ns,
            outcome=done.outcome,
            reason=done.reason,
            result=self.behaviour.result(done.outcome == "succeeded", pos_uav_ned_m),
            position_deg=_position_deg(odometry),
        )
        yield from (Reply(watcher, self.result) for watcher in self._watchers)


def _battery_refusal(rest: Remaining | Done | None, plan: Plan, inbox: Inbox, battery: BatteryConfig) -> str:
    """Reason why the battery doesn't hold the rest of a flight, or ""; a flight of unknown duration isn't judged."""
    status = inbox.latest(STATUS)
    if plan.lands or status is None or not isinstance(rest, Remaining):
        return ""
    return battery_refusal(rest.time_s, plan.landing_from_m, status.battery, battery)


def _joined(*sentences: str) -> str:
    """Sentences for people as one text, as long as a message may have it."""
    return "; ".join(filter(None, sentences))[:TEXT_MAX]


def _response_to(inbox: Inbox, tag: str) -> Response | None:
    """Response to the call or task with a tag; None while there is none."""
    return next((response for response in inbox.responses if response.tag == tag), None)


def _position_deg(odometry: Odometry | None) -> Vec3 | None:
    """Latitude, longitude and altitude of the vehicle; None while the origin is unknown."""
    if odometry is None or odometry.origin_deg is None:
        return None
    return geodetic_from_ned(odometry.pos_uav_ned_m, odometry.origin_deg)


PREPARE_TIMEOUT_S = 20.0
"""Time-out of a preparation: clients wait 30 s for the acceptance of a goal."""


class PreparationRun:
    """The preparation of one goal, which a process of its own carries out while the server goes on.

    Args:
        state: of the vehicle at the begin.
    """

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

    def begin(self) -> BackgroundTask:
        """Start the work."""
        return BackgroundTask(self._preparation.work(self._state), self._tag)

    def end(self) -> CancelTask:
        """End the work, whose outcome nobody wants any more."""
        return CancelTask(self._tag)

    def outcome(self, t_ns: int, inbox: Inbox) -> Prepared | Refusal | None:
        """Outcome of the work; None while it lasts."""
        response = _response_to(inbox, self._tag)
        if response is None:
            return self._too_long() if t_ns > self._deadline_ns else None
        if response.error is not None:
            return Refusal(f"{self._action.name} failed in prepare: {response.error}")
        return self._preparation.start(response.payload)

    def _too_long(self) -> Refusal:
        advice = self._preparation.too_long
        reason = f"the goal could not be planned within {PREPARE_TIMEOUT_S:g} s"
        return Refusal(f"{reason}: {advice}" if advice else reason)

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


class Modification:
    """One change of a goal's fields while it is flown, from its request to its reply.

    The vehicle brakes. The changed goal is planned from there, with the checks of a new goal, and goes on by the new
    plan; when it is refused, the old one goes on. So nothing jumps, whatever changes.

    Args:
        run: of the goal.
        request_id: of the request.
        goal: with the changed fields.
    """

    def __init__(self, run: GoalRun, request_id: int, goal: Goal, planner: GuardedPlanner) -> None:
        self._run = run
        self._request_id = request_id
        self._goal = goal
        self._planner = planner
        self._preparing: tuple[Plan, PreparationRun] | None = None
        self._taken = 0
        """Number of pictures when the plan was made."""

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the change; the goal has made its own step before."""
        if self._run.stage != "flying":
            yield from self._refuse("the goal has ended")
            return
        state = self._run.brake(t_ns, inbox)
        if isinstance(state, Refusal):
            yield from self._refuse(state.reason)
            return
        if state is None:
            return
        if self._preparing is not None and self._pictures_taken() != self._taken:
            # A point was passed while the vehicle came to rest: the plan would take its picture again.
            yield self._preparing[1].end()
            self._preparing = None
        if self._preparing is None:
            yield from self._replan(t_ns, inbox, state)
        else:
            yield from self._await_preparation(t_ns, inbox, state, *self._preparing)

    def _pictures_taken(self) -> int:
        return 0 if self._run.capture is None else self._run.capture.taken

    def _replan(self, t_ns: int, inbox: Inbox, state: VehicleState) -> Iterator[Output]:
        """Plan from where the vehicle hovers, at once or in the background."""
        run, status = self._run, inbox.latest(STATUS)
        self._taken = self._pictures_taken()
        if status is None:
            yield from self._refuse("the vehicle's status is unknown")
            return
        plan = self._planner.replan(self._goal, status, run.behaviour)
        if isinstance(plan, Plan) and plan.check_inputs is not None and (reason := plan.check_inputs(state)):
            plan = Refusal(reason)
        if isinstance(plan, Refusal):
            yield from self._refuse(plan.reason)
        elif isinstance(plan.start, Preparation):
            preparation = PreparationRun(t_ns, run.action, run.goal_id, plan.start, state)
            self._preparing = plan, preparation
            yield preparation.begin()
        else:
            prepared = Prepared(plan.start, plan.warning, plan.coverage)
            yield from self._take_over(t_ns, inbox, state, plan, prepared)

    def _await_preparation(
        self, t_ns: int, inbox: Inbox, state: VehicleState, plan: Plan, preparation: PreparationRun
    ) -> Iterator[Output]:
        outcome = preparation.outcome(t_ns, inbox)
        if isinstance(outcome, Refusal):
            yield from self._refuse(outcome.reason)
        elif outcome is not None:
            yield from self._take_over(t_ns, inbox, state, plan, outcome)

    def _take_over(
        self, t_ns: int, inbox: Inbox, state: VehicleState, plan: Plan, prepared: Prepared
    ) -> Iterator[Output]:
        """Start the new behaviour, if its way stays inside the fence and the battery holds its flight."""
        run = self._run
        behaviour = prepared.start(run.goal_time_ns(t_ns), state)
        path_ned_m = tuple(add(point_m, state.shift_ned_m) for point_m in path_of(behaviour, state))
        refusal, battery = fence_refusal(path_ned_m, plan, inbox), run.config.vehicle.battery
        if refusal := refusal or _battery_refusal(remaining_of(behaviour, state), plan, inbox, battery):
            yield from self._refuse(refusal)
            return
        run.go_on_changed(self._goal, behaviour, path_ned_m, prepared.coverage)
        yield Reply(self._request_id, ModifyReply(modified=True, warning=prepared.warning))

    def _refuse(self, reason: str) -> Iterator[Output]:
        """Go on with the old fields."""
        self._run.go_on_unchanged()
        if self._preparing is not None:
            yield self._preparing[1].end()
        yield Reply(self._request_id, ModifyReply(modified=False, reason=reason))


def changed_goal(action: Action[Any], goal: Goal, fields: Mapping[str, Any]) -> Goal | Refusal:
    """The goal with other values in some fields, or the reason why these can't change."""
    can = f"{action.name} can change {', '.join(action.changeable)}" if action.changeable else ""
    can = can or f"no field of {action.name} can change"
    if not fields:
        return Refusal(f"no field is given: while it is flown, {can}")
    for name in fields:
        if name not in goal.__struct_fields__:
            no_field = unknown("field", name, own_fields(action.goal_type))
            return Refusal(f"{action.name}: {no_field}; while it is flown, {can}")
        if name not in action.changeable:
            return Refusal(f"{name} can't change while the goal is flown: {can}")
    try:
        changed: Goal = msgspec.convert({**msgspec.to_builtins(goal), **fields}, action.goal_type)
    except msgspec.ValidationError as error:
        return Refusal(f"{action.name}: {mistake(error, action.goal_type)}")
    return changed
