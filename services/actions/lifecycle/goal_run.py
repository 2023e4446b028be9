"""One goal from its arrival to its result: the lifecycle that all actions share.

admitting, checking and preparing where the goal needs them -> acquiring -> flying -> releasing -> over; a goal ends
exactly once. The last three are the part of `GoalFlight`. A goal that is only planned ends before acquiring.
"""

from collections.abc import Iterator
from typing import Any

from msgspec.structs import replace

from jezero.frames import Vec3
from jezero.runtime.service import Call, Inbox, Output, Reply, Request, Subscribe
from jezero.schemas.actions import Accepted, PlanReply, Rejected, Result
from jezero.schemas.commands import Acquire
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action
from jezero.schemas.struct import Payload
from jezero.schemas.topics import ACQUIRE, ALTIMETER, ODOMETRY, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.battery_reserve import battery_refusal
from jezero.services.actions.lifecycle.fence_check import fence_refusal
from jezero.services.actions.lifecycle.goal_context import GoalContext
from jezero.services.actions.lifecycle.goal_flight import GoalFlight
from jezero.services.actions.lifecycle.goal_stages import (
    ACQUIRE_TIMEOUT_S,
    Acquiring,
    Admitting,
    Checking,
    New,
    Over,
    refusal_by,
    reply_deadline_ns,
    response_to,
)
from jezero.services.actions.lifecycle.guard import GuardedPlanner
from jezero.services.actions.lifecycle.modification import Modification, changed_goal
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.preparation_run import PreparationRun
from jezero.services.actions.lifecycle.selection_lease import SelectionLease
from jezero.services.actions.lifecycle.vehicle_view import VehicleView
from jezero.services.actions.motion.behaviour import Done, Plan, Preparation, Refusal, Remaining, Start
from jezero.services.actions.motion.capture import CAPTURE_INPUTS

CHECK_TIMEOUT_S = 1.5
"""Time-out of the inputs of a goal whose inputs are checked before it is accepted."""
POSITION_LOST = "the vehicle's position is not known any more: is vehicle_bridge running?"


class GoalRun:
    """The lifecycle of one goal.

    Args:
        pictures: store of the pictures, for actions that take some.
        plan_only: reply with duration and length of the flight instead of flying.

    Attributes:
        goal: as it was sent.
        goal_id: its id.
        clients: that sent it and are still connected.
        capture: the pictures that it takes, if it does.
        plan_only: whether it is only planned.
        coverage: plan of an area coverage, as soon as there is one.
        path_ned_m: (n, 3) corners of the way that was planned last, as soon as there is one.
    """

    def __init__(
        self,
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
        self.goal = goal
        self.goal_id = goal_id
        self.clients: list[str] = []
        self.capture = plan.capture
        self.plan_only = plan_only
        self._battery = config.vehicle.battery
        self._accepted = Accepted(goal_id=goal_id, warning=warning)
        self._pictures = pictures
        self._stage: New | Admitting | Checking | PreparationRun | Acquiring | GoalFlight | Over = New()
        self.coverage = plan.coverage
        self.path_ned_m: tuple[Vec3, ...] = ()
        self._cancel_reason = ""
        self._modification: Modification | None = None
        self._arrived_ns = 0
        lease = None if plan.selection is None or plan_only else SelectionLease(goal_id, plan.selection)
        captured = () if plan.capture is None else CAPTURE_INPUTS
        inputs = tuple(dict.fromkeys((ALTIMETER, *plan.inputs, *captured)))
        self._plan = plan
        self._view = VehicleView(epoch_id, lease, inputs, goal.plan_from_ned_m)
        self._context = GoalContext(
            action=action,
            goal_id=goal_id,
            plan=plan,
            inputs=inputs,
            view=self._view,
            lease=lease,
            vehicle=config.vehicle,
            epoch_id=epoch_id,
            acceleration_mps2=config.move.accel_mps2,
        )

    @property
    def stage(self) -> str:
        """Name of the present stage; "over" at the end."""
        return self._stage.stage if isinstance(self._stage, GoalFlight) else self._stage.name

    @property
    def is_flown(self) -> bool:
        """Whether the goal has been accepted and has not ended."""
        return isinstance(self._stage, GoalFlight) and self._stage.stage != "over"

    @property
    def result(self) -> Result[Any] | None:
        """Result of a goal that is over, unless it was rejected."""
        return self._stage.result if isinstance(self._stage, GoalFlight) else None

    # -- called by the server --

    def begin(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Begin with the acquisition of control; ask the bridge first where something else takes time before that.

        So a goal that the bridge would refuse anyway is refused with that reason, and not with a missing input.
        """
        self._arrived_ns = t_ns
        if self.goal.plan_from_ned_m is not None:  # what the bridge says of the vehicle as it is now doesn't matter
            yield from self._check(t_ns, inbox)
            return
        immediate = self._plan.check_inputs is None and not isinstance(self._plan.start, Preparation)
        if immediate and not self.plan_only:
            yield from self._prepare(t_ns, inbox)
            return
        tag = f"{self.goal_id}/admit/{t_ns}"
        self._stage = Admitting(reply_deadline_ns(t_ns), tag)
        yield Call(ACQUIRE, self._request(t_ns, check_only=True), tag, ACQUIRE_TIMEOUT_S)

    def attach(self, request: Request) -> Iterator[Output]:
        """Add a watcher: the sender of this goal, or a second one when the goal was sent twice."""
        self._context.watchers.append(request.request_id)
        if request.client_id and request.client_id not in self.clients:
            self.clients.append(request.client_id)
        if isinstance(self._stage, GoalFlight):
            yield Reply(request.request_id, self._accepted, final=False)

    def cancel(self, reason: str) -> bool:
        """End the goal at the next step; returns False when it is ending already."""
        if self.stage in ("releasing", "over"):
            return False
        self._cancel_reason = reason
        return True

    def pause(self, t_ns: int, inbox: Inbox) -> str:
        """Pause the goal; returns the reason why it can't be paused, or ""."""
        stage = self._stage
        if self._cancel_reason or not isinstance(stage, GoalFlight) or stage.stage != "flying":
            return self._not_flying
        return stage.pause(t_ns, inbox)

    def resume(self) -> str:
        """Go on with a paused goal; returns the reason why it can't go on, or ""."""
        stage = self._stage
        if self._cancel_reason or not isinstance(stage, GoalFlight) or stage.stage != "flying":
            return self._not_flying
        return "" if stage.resume() else "the goal is not paused"

    def modify(self, t_ns: int, wanted: Request, planner: GuardedPlanner, inbox: Inbox) -> str:
        """Change fields of the goal; returns the reason why they can't change, or "" where the reply follows later."""
        stage, status = self._stage, inbox.latest(STATUS)
        if self._cancel_reason or not isinstance(stage, GoalFlight) or stage.stage != "flying" or status is None:
            return self._not_flying
        if self._modification is not None:
            return "the goal is being modified: send the request again in a moment"
        goal = changed_goal(self._context.action, self.goal, wanted.payload.fields)
        if isinstance(goal, Refusal):
            return goal.reason
        first = planner.replan(goal, status, stage.behaviour)
        if isinstance(first, Refusal):
            return first.reason
        if isinstance(refusal := stage.brake(t_ns, inbox), str) and refusal:
            return refusal
        self._modification = Modification(
            self._context.action, wanted.request_id, self.goal_id, goal, planner, self._battery
        )
        return ""

    def _go_on_modifying(self, t_ns: int, inbox: Inbox, flight: GoalFlight) -> Iterator[Output]:
        modification = self._modification
        if modification is None:
            return
        yield from modification.step(t_ns, inbox, flight)
        if modification.over:
            self._modification = None
            if modification.in_force:
                self.goal, self.path_ned_m = modification.goal, modification.path_ned_m

    @property
    def _not_flying(self) -> str:
        """Reason why the goal can be neither paused nor modified."""
        ends = self._cancel_reason or self.stage in ("releasing", "over")
        return "the goal is ending already" if ends else "the goal does not fly yet"

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the present stage."""
        self._store_pictures(t_ns, inbox)
        stage = self._stage
        if isinstance(stage, Admitting):
            yield from self._await_admission(t_ns, inbox, stage)
        elif isinstance(stage, Checking):
            yield from self._check_inputs(t_ns, inbox, stage)
        elif isinstance(stage, PreparationRun):
            yield from self._await_preparation(t_ns, inbox, stage)
        elif isinstance(stage, Acquiring):
            yield from self._await_control(t_ns, inbox, stage)
        elif isinstance(stage, GoalFlight):
            yield from stage.step(t_ns, inbox, self._cancel_reason)
            yield from self._go_on_modifying(t_ns, inbox, stage)

    # -- until the goal is accepted --

    def _await_admission(self, t_ns: int, inbox: Inbox, stage: Admitting) -> Iterator[Output]:
        """Go on when the bridge would grant control."""
        response = response_to(inbox, stage.tag)
        if self._cancel_reason:
            yield from self.reject(self._cancel_reason, inbox)
        elif refusal := refusal_by(response, t_ns, stage.deadline_ns):
            yield from self.reject(refusal, inbox)
        elif response is not None:
            yield from self._check(t_ns, inbox)

    def _check(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Wait for the inputs, where they decide about the goal or about its plan."""
        if self._plan.check_inputs is None and not (self.plan_only and self._plan.inputs):
            yield from self._prepare(t_ns, inbox)
            return
        self._stage = Checking(t_ns + int(CHECK_TIMEOUT_S * NS_PER_S))
        yield Subscribe((ODOMETRY, *self._context.inputs))

    def _check_inputs(self, t_ns: int, inbox: Inbox, stage: Checking) -> Iterator[Output]:
        """Go on or refuse as soon as every input has come, or the time for it is over."""
        if self._cancel_reason:
            yield from self.reject(self._cancel_reason, inbox)
            return
        odometry = self._view.odometry(inbox)
        complete = all(inbox.latest(topic) is not None for topic in self._plan.inputs)
        complete = complete and (self.capture is None or not self.capture.refusal())
        if not (complete and odometry is not None) and t_ns <= stage.deadline_ns:
            return
        if odometry is None:
            yield from self.reject(POSITION_LOST, inbox)
            return
        check = self._plan.check_inputs
        reason = "" if check is None else check(self._view.state(t_ns, inbox, odometry))
        yield from self.reject(reason, inbox, input_missing=True) if reason else self._prepare(t_ns, inbox)

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
        state = self._view.state(t_ns, inbox, odometry)
        self._stage = PreparationRun(t_ns, self._context.action, self.goal_id, start, state)
        yield from self._stage.begin()

    def _await_preparation(self, t_ns: int, inbox: Inbox, stage: PreparationRun) -> Iterator[Output]:
        """Go on or refuse when the work is done; a cancel doesn't wait for it."""
        if self._cancel_reason:
            yield from self.reject(self._cancel_reason, inbox)
            return
        odometry, outcome = self._view.odometry(inbox), stage.outcome(t_ns, inbox)
        if isinstance(outcome, Refusal):
            yield from self.reject(outcome.reason, inbox)
        elif outcome is not None:
            self._warn(outcome.warning)
            self.coverage = outcome.coverage
            yield from self._acquire(t_ns, inbox, outcome.start)
        elif odometry is not None:
            yield from stage.feedback(t_ns, self._view.state(t_ns, inbox, odometry), inbox.latest(STATUS))

    def _acquire(self, t_ns: int, inbox: Inbox, start: Start) -> Iterator[Output]:
        """Start the behaviour, whose first step knows how long the flight is, and request control from the bridge.

        A goal that is only planned ends here.
        """
        odometry = self._view.odometry(inbox)
        if odometry is None:  # there was some when the goal arrived
            yield from self.reject(POSITION_LOST, inbox)
            return
        flight = GoalFlight(t_ns, inbox, odometry, start, self._context)
        refusal = self._battery_refusal(flight.planned, inbox)
        self.path_ned_m = flight.planned_path_ned_m()
        if refusal := refusal or fence_refusal(self.path_ned_m, self._plan, inbox):
            yield from self.reject(refusal, inbox)
            return
        if self.plan_only:
            yield from self._reply_with_plan(flight, inbox)
            return
        tag = f"{self.goal_id}/acquire/{t_ns}"
        yield Call(ACQUIRE, self._request(t_ns), tag, ACQUIRE_TIMEOUT_S)
        self._stage = Acquiring(reply_deadline_ns(t_ns), tag, flight)

    def _battery_refusal(self, planned: Remaining | Done | None, inbox: Inbox) -> str:
        """Reason why the battery doesn't hold the flight, or ""; a flight of unknown duration isn't judged."""
        status = inbox.latest(STATUS)
        if self._plan.lands or status is None or not isinstance(planned, Remaining):
            return ""
        return battery_refusal(planned.time_s, self._plan.landing_from_m, status.battery, self._battery)

    def _request(self, t_ns: int, *, check_only: bool = False) -> Acquire:
        """The goal's request for control."""
        return Acquire(
            goal_id=self.goal_id,
            action=self._context.action.name,
            do_takeoff=self._plan.do_takeoff,
            issued_t_ns=t_ns,
            goal_t_ns=self._arrived_ns,
            goal_issued_t_ns=self.goal.issued_t_ns,
            override=self._plan.override,
            check_only=check_only,
        )

    def _await_control(self, t_ns: int, inbox: Inbox, stage: Acquiring) -> Iterator[Output]:
        response, flight = response_to(inbox, stage.tag), stage.flight
        if refusal := refusal_by(response, t_ns, stage.deadline_ns):
            yield from self.reject(refusal, inbox)
        elif response is None:
            flight.drop_first_feedback()
        else:
            grant: Any = response.payload  # AcquireReply, as no refusal says otherwise
            self._stage = flight
            self._warn(grant.warning)
            yield from (Reply(watcher, self._accepted, final=False) for watcher in self._context.watchers)
            yield from flight.begin(t_ns, grant, with_feedback=not self._cancel_reason)

    def _warn(self, warning: str) -> None:
        """Add a warning to the acceptance of the goal."""
        texts = [text for text in (self._accepted.warning, warning) if text]
        self._accepted = replace(self._accepted, warning="; ".join(texts))

    def reject(self, reason: str, inbox: Inbox, *, input_missing: bool = False) -> Iterator[Output]:
        """End a goal that hasn't been accepted yet."""
        status = inbox.latest(STATUS)
        code = None if status is None else status.code
        refused: Payload = Rejected(goal_id=self.goal_id, reason=reason, code=code)
        if self.plan_only:
            refused = PlanReply(accepted=False, reason=reason, code=code, input_missing=input_missing)
        yield from (Reply(watcher, refused) for watcher in self._context.watchers)
        if isinstance(self._stage, PreparationRun):
            yield from self._stage.end()
        self._stage = Over()

    def _reply_with_plan(self, flight: GoalFlight, inbox: Inbox) -> Iterator[Output]:
        """End a goal that is only planned."""
        planned = flight.planned
        if isinstance(planned, Done):
            yield from self.reject(planned.reason or "the goal would end at once", inbox)
            return
        status = inbox.latest(STATUS)
        battery = None if status is None else status.battery
        reply = PlanReply(
            accepted=True,
            code=None if status is None else status.code,
            warning=self._accepted.warning,
            duration_s=None if planned is None else planned.time_s,
            distance_m=None if planned is None else planned.distance_m,
            battery_used=None if planned is None else self._battery.used(planned.hover_s or planned.time_s),
            battery_remaining=None if battery is None else battery.remaining,
            battery_critical=None if battery is None else battery.critical,
            coverage=self.coverage,
            path_ned_m=self.path_ned_m,
        )
        yield from (Reply(watcher, reply) for watcher in self._context.watchers)
        self._stage = Over()

    # -- pictures --

    def _store_pictures(self, t_ns: int, inbox: Inbox) -> None:
        """Write the pictures that have come to the disk at once, so that none stays in memory."""
        if self.capture is None or self._pictures is None:
            return
        for shot in self.capture.update(t_ns, inbox):
            try:
                self._pictures.keep(shot.reply(self.goal_id))
            except OSError as error:
                self.capture.fail(f"they can't be stored: {error.strerror or error}")
