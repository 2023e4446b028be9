"""One goal from the request for control to its result: the lifecycle that all actions share.

looking and preparing where the goal needs them -> acquiring -> flying -> releasing -> over; a goal ends exactly once.
"""

from collections.abc import Iterator
from typing import Any, Literal

import msgspec

from jezero.frames import Vec3, add
from jezero.runtime.service import (
    BackgroundTask,
    Call,
    Inbox,
    Output,
    Publish,
    Reply,
    Request,
    Response,
    SetRate,
    Subscribe,
)
from jezero.schemas.actions import Accepted, Feedback, FeedbackMessage, Goal, ImagesFeedback, Rejected, Result
from jezero.schemas.commands import Acquire, CameraPitch, Release, ReleaseReply, Setpoint
from jezero.schemas.state import Odometry, Status, StatusCode
from jezero.schemas.topics import (
    ACQUIRE,
    CAMERA_PITCH,
    ODOMETRY,
    RELATIVE,
    RELEASE,
    SETPOINT,
    STATUS,
    Action,
    feedback_of,
)
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.behaviour import Behaviour, Done, Move, Verdict
from jezero.services.actions.lifecycle.capture import CAPTURE_INPUTS, Capture
from jezero.services.actions.lifecycle.config import LifecycleConfig
from jezero.services.actions.lifecycle.control_lease import Control
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.selection_lease import SelectionLease
from jezero.services.actions.lifecycle.vehicle_view import VehicleView, is_fresh
from jezero.services.actions.motion.config import LimitsConfig
from jezero.services.actions.motion.limits import beyond_limits

RETRY_S = 0.2
BEGIN_HZ = 100.0
"""The first setpoint follows the acceptance and the first feedback after 10 ms: who waits for these would have to share
the processors with those whom it wakes."""
LOST = "the vehicle's position is not known any more: is vehicle_bridge running?"
PITCH_PERIOD_NS = 45_000_000
"""A little less than that of `command/camera_pitch`, as steps don't come evenly."""


class GoalRun:
    """The lifecycle of one goal.

    Attributes:
        result: set once the goal is over, unless it was rejected.
        clients: those who sent it and are still there.
        capture: the pictures it takes, if it does.
    """

    def __init__(
        self,
        *,
        action: Action[Any],
        goal: Goal,
        goal_id: str,
        behaviour: Behaviour,
        verdict: Verdict,
        config: LifecycleConfig,
        limits: LimitsConfig,
        status: Status,
        spool: PictureStore | None = None,
    ) -> None:
        self.goal = goal
        self.goal_id = goal_id
        self.stage: Literal["looking", "preparing", "acquiring", "flying", "releasing", "over"] = "acquiring"
        self.result: Result[Any] | None = None
        self.clients: list[str] = []
        self._action = action
        self._feedback_topic = feedback_of(action)
        self._behaviour = behaviour
        self._verdict = verdict
        self._config = config
        self._limits = limits
        self._control = Control(config, status.epoch_id)
        self._watchers: list[int] = []
        self._cancel_reason = ""
        self._tag = ""
        self._attempt = 0
        self._came_ns = 0
        self._deadline_ns = 0
        self._retry_ns: int | None = None
        self._sequence = 0
        self._begins = True
        self._first: Feedback[Any] | None = None
        """The first feedback, if nothing newer comes before control is given."""
        self._move: Move | None = None
        self._setpoint_ns = 0
        self._feedback_due_ns = 0
        self._pitch_due_ns = 0
        self._done: Done | None = None
        selection = behaviour.selection
        self._lease = None if selection is None else SelectionLease(goal_id, selection)
        self.capture = behaviour.capture
        self._spool = spool
        captured = () if self.capture is None else CAPTURE_INPUTS
        self._inputs = tuple(dict.fromkeys((*behaviour.inputs, *captured)))
        self._view = VehicleView(config, status.epoch_id, self._lease, self._inputs)

    # -- what the server asks of it --

    def begin(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Look at the inputs where the goal depends on them, else ask the bridge for control."""
        self._came_ns = t_ns
        if self._verdict.look is None:
            yield from self._acquire(t_ns, inbox)
            return
        self.stage = "looking"
        self._deadline_ns = t_ns + int(self._config.check_timeout_s * NS_PER_S)
        yield Subscribe((ODOMETRY, *self._inputs))

    def _acquire(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        odometry = self._view.odometry(inbox)
        if odometry is None:  # any more: there was some when the goal came
            yield from self._reject(LOST, inbox)
            return
        self.stage = "acquiring"
        timeout_s = self._config.acquire_timeout_s
        self._tag = f"{self.goal_id}/acquire/{t_ns}"
        self._deadline_ns = t_ns + int((timeout_s + 0.5) * NS_PER_S)
        acquire = Acquire(
            goal_id=self.goal_id,
            action=self._action.name,
            do_takeoff=self._verdict.do_takeoff,
            issued_t_ns=t_ns,
            goal_t_ns=self._came_ns,
            goal_issued_t_ns=self.goal.issued_t_ns,
        )
        yield Call(ACQUIRE, acquire, self._tag, timeout_s)
        self._start(t_ns, inbox, odometry)

    def _start(self, t_ns: int, inbox: Inbox, odometry: Odometry) -> None:
        """Already while the bridge decides, as somebody waits for the first feedback."""
        self._view.begin(odometry)
        state = self._view.state(t_ns, inbox, odometry)
        self._behaviour.start(t_ns, self.goal, state)
        move = self._behaviour.step(t_ns, state)
        self._first = self._feedback(t_ns, move, odometry, inbox) if isinstance(move, Move) else None

    def attach(self, request: Request) -> Iterator[Output]:
        """Let the sender of this goal watch it; more than one when it was sent twice."""
        self._watchers.append(request.request_id)
        if request.client_id and request.client_id not in self.clients:
            self.clients.append(request.client_id)
        if self.stage not in ("looking", "preparing", "acquiring"):
            yield Reply(request.request_id, self._accepted(), final=False)

    def cancel(self, reason: str) -> bool:
        """End it at the next step; False when it is ending already."""
        if self.stage not in ("looking", "preparing", "acquiring", "flying"):
            return False
        self._cancel_reason = reason
        return True

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """React to what arrived."""
        if self.capture is not None:
            self._take_pictures(t_ns, inbox, self.capture)
        if self.stage == "looking":
            yield from self._looking(t_ns, inbox)
        elif self.stage == "preparing":
            yield from self._preparing(t_ns, inbox)
        elif self.stage == "acquiring":
            yield from self._acquiring(t_ns, inbox)
        elif self.stage == "flying":
            yield from self._flying(t_ns, inbox)
            if self._begins:
                self._begins = False
                yield SetRate(self._behaviour.rate_hz)
                yield Subscribe((ODOMETRY, *self._inputs))
        elif self.stage == "releasing":
            yield from self._releasing(t_ns, inbox)

    # -- looking and acquiring --

    def _looking(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Acquire or refuse as soon as every input has come, or the time for it is over."""
        assert self._verdict.look is not None
        if self._cancel_reason:
            yield from self._reject(self._cancel_reason, inbox)
            return
        odometry = self._view.odometry(inbox)
        complete = all(inbox.latest(topic) is not None for topic in self._behaviour.inputs)
        complete = complete and (self.capture is None or not self.capture.refusal())
        if not (complete and odometry is not None) and t_ns <= self._deadline_ns:
            return
        if odometry is None:
            yield from self._reject(LOST, inbox)
            return
        state = self._view.state(t_ns, inbox, odometry)
        refusal = self._verdict.look(state)
        if refusal:
            yield from self._reject(refusal, inbox)
        elif self._verdict.prepare is None:
            yield from self._acquire(t_ns, inbox)
        else:
            self.stage = "preparing"
            self._tag = f"{self.goal_id}/prepare/{t_ns}"
            self._deadline_ns = t_ns + int(self._config.prepare_timeout_s * NS_PER_S)
            yield BackgroundTask(self._verdict.prepare.work(state), self._tag)

    def _preparing(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Acquire or refuse when the work is done; a cancel doesn't wait for it."""
        assert self._verdict.prepare is not None
        response = self._response(inbox)
        refusal = self._cancel_reason
        if response is not None:
            refusal = refusal or self._verdict.prepare.take(response.payload)
        elif t_ns > self._deadline_ns:
            refusal = refusal or f"the goal could not be prepared within {self._config.prepare_timeout_s:g} s"
        if refusal:
            yield from self._reject(refusal, inbox)
        elif response is not None:
            yield from self._acquire(t_ns, inbox)

    def _acquiring(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        response = self._response(inbox)
        if response is None:
            self._first = None  # something newer has come
            if t_ns > self._deadline_ns:
                yield from self._reject("the vehicle bridge did not answer", inbox)
        elif response.payload is None:
            yield from self._reject(f"the vehicle bridge did not answer: {response.error}", inbox)
        elif not response.payload.granted:
            yield from self._reject(response.payload.reason, inbox)
        else:
            self._control.begin(response.payload, t_ns)
            self.stage = "flying"
            yield from (Reply(watcher, self._accepted(), final=False) for watcher in self._watchers)
            if self._first is not None and not self._cancel_reason:
                yield from self._tell(t_ns, self._first)
            yield SetRate(BEGIN_HZ)

    def _reject(self, reason: str, inbox: Inbox) -> Iterator[Output]:
        status = inbox.latest(STATUS)
        rejected = Rejected(goal_id=self.goal_id, reason=reason, code=None if status is None else status.code)
        yield from (Reply(watcher, rejected) for watcher in self._watchers)
        self.stage = "over"

    def _accepted(self) -> Accepted:
        return Accepted(goal_id=self.goal_id, warning=self._verdict.warning)

    # -- flying --

    def _flying(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        if lost := self._control.loss(t_ns, inbox):
            yield from self._finish(t_ns, inbox, Done("aborted", lost))
            return
        if self._cancel_reason:
            yield from self._release(t_ns, Done("canceled", self._cancel_reason), inbox)
            return
        odometry = self._view.odometry(inbox)
        if odometry is None or not is_fresh(odometry, t_ns, self._config.odometry_age_max_s):
            reason = f"the vehicle's position is unknown: no odometry for {self._config.odometry_age_max_s:g} s"
            yield from self._release(t_ns, Done("aborted", reason), inbox)
            return
        if self.capture is not None and (problem := self.capture.problem(t_ns)):
            yield from self._release(t_ns, Done("aborted", problem), inbox)
            return
        if self._lease is not None:
            yield from self._lease.renew(t_ns, inbox, self._view.shift(odometry))
        news = bool(inbox.new(ODOMETRY)) or bool(inbox.new(RELATIVE))
        rate_hz = self._behaviour.rate_hz or self._config.setpoint_rate_hz
        if not news and (t_ns - self._setpoint_ns) * rate_hz < NS_PER_S:
            return
        state = self._view.state(t_ns, inbox, odometry)
        shift_ned_m = state.shift_ned_m
        move = self._behaviour.step(t_ns, state)
        if any(shift_ned_m) and isinstance(move, Move) and (beyond := self._moved_beyond(move, shift_ned_m)):
            move = Done("aborted", beyond)
        if isinstance(move, Done):
            yield from self._release(t_ns, move, inbox)
            return
        self._move = move
        yield self._setpoint(t_ns, move, odometry, shift_ned_m)
        if move.pitch_camera_rad is not None and t_ns >= self._pitch_due_ns:
            self._pitch_due_ns = t_ns + PITCH_PERIOD_NS
            axes = CameraPitch(t_ns=t_ns, pitch_camera_rad=move.pitch_camera_rad, roll_camera_rad=move.roll_camera_rad)
            yield Publish(CAMERA_PITCH, axes)
        if t_ns >= self._feedback_due_ns:
            yield from self._tell(t_ns, self._feedback(t_ns, move, odometry, inbox))

    def _moved_beyond(self, move: Move, shift_ned_m: Vec3) -> str:
        """Why the goal can't go on after its points moved along with the autopilot's position, or ""."""
        point_ned_m = move.pos_ned_m
        if point_ned_m is None or beyond_limits(point_ned_m, self._limits):
            return ""
        beyond = beyond_limits(add(point_ned_m, shift_ned_m), self._limits)
        return f"the autopilot corrected its position, and with it the goal's: {beyond}" if beyond else ""

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
        )
        return Publish(SETPOINT, setpoint)

    def _feedback(self, t_ns: int, move: Move, odometry: Odometry, inbox: Inbox) -> Feedback[Any]:
        status = inbox.latest(STATUS)
        code = -1 if status is None else status.code
        content = move.feedback
        if content.frame == "world":
            content = msgspec.structs.replace(content, pos_uav_ned_m=odometry.pos_uav_ned_m)
        if isinstance(content, ImagesFeedback) and self.capture is not None:
            taken, planned = self.capture.taken, self.capture.planned
            content = msgspec.structs.replace(content, taken=taken, planned=planned, images=self.capture.told())
        return Feedback(goal_id=self.goal_id, t_ns=t_ns, code=code, feedback=content)

    def _tell(self, t_ns: int, told: Feedback[Any]) -> Iterator[Output]:
        """Feedback to all who watch; the next is due a period after this one was."""
        yield from (Reply(watcher, told, final=False) for watcher in self._watchers)
        period_ns = int(NS_PER_S / self._config.feedback_rate_hz)
        late_ns = t_ns - self._feedback_due_ns
        self._feedback_due_ns = (self._feedback_due_ns if late_ns < period_ns else t_ns) + period_ns
        name = self._action.name
        message = FeedbackMessage(
            t_ns=told.t_ns, goal_id=told.goal_id, action=name, code=told.code, feedback=told.feedback
        )
        yield Publish(self._feedback_topic, message)

    def _take_pictures(self, t_ns: int, inbox: Inbox, capture: Capture) -> None:
        """Those that have come are written to the disk at once: none is kept in memory."""
        if self._spool is None:
            return
        for shot in capture.take_in(t_ns, inbox):
            try:
                self._spool.keep(shot.picture(self.goal_id))
            except OSError as error:
                capture.fail(f"they can't be stored: {error.strerror or error}")

    # -- releasing --

    def _release(self, t_ns: int, done: Done, inbox: Inbox) -> Iterator[Output]:
        odometry = self._view.odometry(inbox)
        if self._move is not None and odometry is not None and self.capture is not None:
            yield from self._tell(t_ns, self._feedback(t_ns, self._move, odometry, inbox))  # of the last pictures
        self.stage = "releasing"
        self._done = done
        self._deadline_ns = t_ns + int(self._config.release_give_up_s * NS_PER_S)
        yield from self._ask_release(t_ns, done, inbox)

    def _ask_release(self, t_ns: int, done: Done, inbox: Inbox) -> Iterator[Output]:
        self._attempt += 1
        self._retry_ns = None
        self._tag = f"{self.goal_id}/release/{self._attempt}/{t_ns}"
        odometry = self._view.odometry(inbox)
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
        hovers = done.then == "hover"
        timeout_s = self._config.release_hover_timeout_s if hovers else self._config.release_disarm_timeout_s
        yield Call(RELEASE, release, self._tag, timeout_s)

    def _releasing(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        done = self._done
        assert done is not None
        response = self._response(inbox)
        ended: Done | None = None
        if response is not None and response.payload is not None:
            ended = self._judge_release(response.payload, done, t_ns, inbox)
        elif response is not None:
            self._retry_ns = t_ns + int(RETRY_S * NS_PER_S)
        if ended is None:
            ended = self._give_up(t_ns, done, inbox)
        if ended is not None:
            yield from self._finish(t_ns, inbox, ended)
            return
        if self._retry_ns is not None and t_ns >= self._retry_ns:
            yield from self._ask_release(t_ns, done, inbox)
        status, odometry = inbox.latest(STATUS), self._view.odometry(inbox)
        still_ours = status is not None and self._control.is_ours(status)
        if done.outcome == "succeeded" and still_ours and self._move is not None and odometry is not None:
            yield self._setpoint(t_ns, self._move, odometry, self._view.shift(odometry))

    def _judge_release(self, reply: ReleaseReply, done: Done, t_ns: int, inbox: Inbox) -> Done:
        if reply.released or (self._attempt > 1 and self._is_settled(done, t_ns, inbox)):
            return done
        outcome = "aborted" if done.outcome == "succeeded" else done.outcome
        return Done(outcome, "; ".join(text for text in (done.reason, reply.reason) if text))

    def _is_settled(self, done: Done, t_ns: int, inbox: Inbox) -> bool:
        """Whether the status shows what the release asked for: its answer was lost, then."""
        status = inbox.latest(STATUS)
        if status is None or not is_fresh(status, t_ns, self._config.status_age_max_s) or self._control.is_ours(status):
            return False
        if done.outcome == "succeeded":
            return status.code == (StatusCode.HOVER if done.then == "hover" else StatusCode.IDLE)
        return status.code in (StatusCode.IDLE, StatusCode.HOVER)

    def _give_up(self, t_ns: int, done: Done, inbox: Inbox) -> Done | None:
        """The end without an answer: the bridge or the vehicle is not the one that granted control, or is silent."""
        why = self._control.partner_loss(t_ns, inbox)
        if t_ns > self._deadline_ns:
            why = why or "the vehicle bridge did not confirm the end of the goal"
        if not why:
            return None
        return Done("aborted", "; ".join(text for text in (done.reason, why) if text))

    # -- the end --

    def _finish(self, t_ns: int, inbox: Inbox, done: Done) -> Iterator[Output]:
        self.stage = "over"
        if self._lease is not None:
            yield from self._lease.end(t_ns)
        odometry = self._view.odometry(inbox)
        pos_uav_ned_m = (0.0, 0.0, 0.0) if odometry is None else odometry.pos_uav_ned_m
        self.result = Result(
            goal_id=self.goal_id,
            t_ns=t_ns,
            outcome=done.outcome,
            reason=done.reason,
            result=self._behaviour.result(done.outcome == "succeeded", pos_uav_ned_m),
        )
        yield from (Reply(watcher, self.result) for watcher in self._watchers)

    def _response(self, inbox: Inbox) -> Response | None:
        return next((response for response in inbox.responses if response.tag == self._tag), None)
