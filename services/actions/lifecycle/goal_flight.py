"""The flight of one goal: from the start of its behaviour, while control is being acquired, to its result.

acquiring -> flying -> releasing -> over
"""

from collections.abc import Iterator
from typing import Any, Literal

import msgspec

from jezero.frames import Vec3, add, geodetic_from_ned
from jezero.runtime.service import Call, Inbox, Output, Publish, Reply, SetRate, Subscribe
from jezero.schemas.actions import Feedback, Result
from jezero.schemas.commands import AcquireReply, CameraPitch, Release, ReleaseReply, Setpoint
from jezero.schemas.state import Odometry, StatusCode
from jezero.schemas.topics import (
    CAMERA_PITCH,
    ODOMETRY,
    RELATIVE,
    RELEASE,
    SETPOINT,
    STATUS,
)
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.control_lease import ControlLease
from jezero.services.actions.lifecycle.goal_context import GoalContext
from jezero.services.actions.lifecycle.goal_feedback import GoalFeedback
from jezero.services.actions.lifecycle.ground_proximity import GroundProximity
from jezero.services.actions.lifecycle.pause_control import PauseControl
from jezero.services.actions.lifecycle.reset_watch import ResetWatch
from jezero.services.actions.lifecycle.runaway_detector import RunawayDetector
from jezero.services.actions.lifecycle.vehicle_view import (
    ODOMETRY_AGE_MAX_S,
    STATUS_AGE_MAX_S,
    is_fresh,
)
from jezero.services.actions.motion.behaviour import (
    Behaviour,
    Done,
    Move,
    Remaining,
    Start,
    VehicleState,
    path_of,
    pause_refusal_of,
    remaining_of,
)
from jezero.services.actions.motion.limits import beyond_limits

SETPOINT_RATE_HZ = 50.0
"""Rate while a goal runs; a plan may ask for more setpoints."""
SETPOINT_RATE_MIN_HZ = 25.0
"""Rate while no odometry comes: at the start of a goal, and after the bridge has stood still for a moment."""
RELEASE_HOVER_TIMEOUT_S, RELEASE_DISARM_TIMEOUT_S = 6.0, 12.0
"""Time-outs of one reply to a release that hovers or disarms; the release is sent again after it."""
RELEASE_GIVE_UP_S = 20.0
"""After this time a goal ends without the bridge's reply."""
RETRY_S = 0.2
FIRST_SETPOINT_HZ = 100.0
"""The first setpoint follows the acceptance and the first feedback after 10 ms: a client that waits for these would
otherwise share the processors with the services that the setpoint wakes."""
CAMERA_PITCH_PERIOD_NS = 45_000_000
"""A little less than the period of `command/camera_pitch`, because steps don't come evenly."""


class GoalFlight:
    """One goal with its running behaviour.

    Args:
        start: starts the behaviour.
        odometry: the newest, at the start.

    Attributes:
        stage: of the flight.
        planned: rest of the flight at its start; None where the behaviour doesn't know it; the end of a behaviour that
            ends in its first step.
        result: of the goal; None until it is over.
    """

    def __init__(self, t_ns: int, inbox: Inbox, odometry: Odometry, start: Start, context: GoalContext) -> None:
        self.stage: Literal["acquiring", "flying", "releasing", "over"] = "acquiring"
        self.result: Result[Any] | None = None
        self._feedback = GoalFeedback(context)
        self._goal_id = context.goal_id
        self._rate_hz = context.plan.rate_hz
        self._capture = context.plan.capture
        self._inputs = context.inputs
        self._view = context.view
        self._lease = context.lease
        self._limits = context.vehicle.limits
        self._ground = GroundProximity(context.vehicle)
        self._runaway = RunawayDetector()
        self._resets = None if context.plan.lands else ResetWatch(odometry)
        self._pause = PauseControl(t_ns, context.acceleration_mps2)
        self._control = ControlLease(context.epoch_id)
        self._watchers = context.watchers
        self._tag = ""
        self._attempt = 0
        self._deadline_ns = 0
        self._retry_ns: int | None = None
        self._sequence = 0
        self._changes = 0
        """Number of changes of the goal in force so far."""
        self._first_step = True
        self._move: Move | None = None
        self._setpoint_ns = 0
        self._pitch_due_ns = 0
        self._done = Done("aborted")
        """End of the behaviour, while control is released."""
        self._view.begin(odometry)
        state = self._view.state(t_ns, inbox, odometry)
        self._behaviour: Behaviour = start(t_ns, state)
        move = self._behaviour.step(t_ns, state)
        self.planned: Remaining | Done | None = move if isinstance(move, Done) else remaining_of(self._behaviour, state)
        self._start_state = state
        self._first = self._feedback_now(t_ns, move, odometry, inbox) if isinstance(move, Move) else None
        """The first feedback, until something newer arrives."""

    def drop_first_feedback(self) -> None:
        """Forget the first feedback, because something newer has come before control was given."""
        self._first = None

    def begin(self, t_ns: int, grant: AcquireReply, *, with_feedback: bool) -> Iterator[Output]:
        """Fly, now that the bridge has given control."""
        self._control.begin(grant, t_ns)
        self.stage = "flying"
        if self._first is not None and with_feedback:
            yield from self._feedback.send(t_ns, self._first)
        yield SetRate(FIRST_SETPOINT_HZ)

    def planned_path_ned_m(self) -> tuple[Vec3, ...]:
        """Corners of the planned way; for a goal that is only planned."""
        return path_of(self._behaviour, self._start_state)

    def pause(self, t_ns: int, inbox: Inbox) -> str:
        """Pause as soon as the vehicle has braked; returns the reason why it can't be paused, or ""."""
        odometry = self._view.odometry(inbox)
        if odometry is None:
            return "the vehicle's position is unknown"
        refusal = pause_refusal_of(self._behaviour, self._state(t_ns, inbox, odometry))
        if refusal and not self._pause.wanted:
            return refusal
        self._pause.wanted = True
        return ""

    def resume(self) -> bool:
        """Go on; returns False when the goal isn't paused."""
        was_wanted, self._pause.wanted = self._pause.wanted, False
        return was_wanted

    @property
    def taken(self) -> int:
        """Number of pictures so far."""
        return 0 if self._capture is None else self._capture.taken

    @property
    def behaviour(self) -> Behaviour:
        """The running behaviour."""
        return self._behaviour

    def brake(self, t_ns: int, inbox: Inbox) -> VehicleState | str:
        """Stop for a change of the goal; returns the state at rest, "" on the way to it, or why it can't stop."""
        odometry = self._view.odometry(inbox)
        if odometry is None:
            return "the vehicle's position is unknown"
        state = self._state(t_ns, inbox, odometry)
        if not self._pause.hovers and (refusal := pause_refusal_of(self._behaviour, state)):
            return refusal
        self._pause.changing = True
        waits = self._capture is not None and self._capture.is_waiting
        if not self._pause.hovers or waits or self._move is None:
            return ""
        held_ned_m = self._move.pos_ned_m if self._move.frame is None else None
        return state if held_ned_m is None else msgspec.structs.replace(state, pos_uav_ned_m=held_ned_m)

    def go_on(self, behaviour: Behaviour | None = None) -> None:
        """Go on after a stop for a change: with the behaviour of the changed goal, or with the present one."""
        self._pause.changing = False
        if behaviour is not None:
            self._behaviour = behaviour
            self._changes += 1

    def goal_time_ns(self, t_ns: int) -> int:
        """The goal's own time at a time of the vehicle."""
        return t_ns - self._pause.behind_ns

    def step(self, t_ns: int, inbox: Inbox, cancel_reason: str) -> Iterator[Output]:
        """React to what arrived.

        Args:
            cancel_reason: reason why the goal is canceled, or "".
        """
        if self.stage == "flying":
            yield from self._flying(t_ns, inbox, cancel_reason)
            if self._first_step:
                self._first_step = False
                yield SetRate(self._rate_hz or SETPOINT_RATE_MIN_HZ)
                yield Subscribe((ODOMETRY, *self._inputs))
        elif self.stage == "releasing":
            yield from self._releasing(t_ns, inbox)

    # -- flying --

    def _flying(self, t_ns: int, inbox: Inbox, cancel_reason: str) -> Iterator[Output]:
        if lost := self._control.loss_reason(t_ns, inbox):
            yield from self._finish(t_ns, inbox, Done("aborted", lost))
            return
        if cancel_reason:
            yield from self._release(t_ns, Done("canceled", cancel_reason), inbox)
            return
        odometry = self._view.odometry(inbox)
        if odometry is None or not is_fresh(odometry, t_ns, ODOMETRY_AGE_MAX_S):
            reason = f"the vehicle's position is unknown: no odometry for {ODOMETRY_AGE_MAX_S:g} s"
            yield from self._release(t_ns, Done("aborted", reason), inbox)
            return
        if self._capture is not None and (problem := self._capture.problem(t_ns)):
            yield from self._release(t_ns, Done("aborted", problem), inbox)
            return
        if self._lease is not None:
            yield from self._lease.renew(t_ns, inbox, self._view.shift(odometry))
        new_state = bool(inbox.new(ODOMETRY)) or bool(inbox.new(RELATIVE))
        rate_hz = self._rate_hz or SETPOINT_RATE_HZ
        if new_state or (t_ns - self._setpoint_ns) * rate_hz >= NS_PER_S:
            yield from self._step_behaviour(t_ns, inbox, odometry)

    def _step_behaviour(self, t_ns: int, inbox: Inbox, odometry: Odometry) -> Iterator[Output]:
        """Publish the behaviour's next setpoint and, when it is due, feedback; release control at its end."""
        state = self._state(t_ns, inbox, odometry)
        shift_ned_m = state.shift_ned_m
        move = self._pause.step(t_ns, self._behaviour, state)
        if self._capture is not None:
            self._capture.behind_ns = self._pause.behind_ns
        if any(shift_ned_m) and isinstance(move, Move) and (beyond := self._moved_beyond(move, shift_ned_m)):
            move = Done("aborted", beyond)
        if self._resets and isinstance(move, Move) and (problem := self._resets.problem(odometry, move)):
            move = Done("aborted", problem)
        if isinstance(move, Move) and (problem := self._ground.problem(t_ns, state, move)):
            move = Done("aborted", problem)
        if isinstance(move, Move) and (problem := self._runaway.problem(t_ns, state, move)):
            move = Done("aborted", problem)
        if isinstance(move, Done):
            yield from self._release(t_ns, move, inbox)
            return
        self._move = move
        yield self._setpoint(t_ns, move, odometry, shift_ned_m)
        if move.pitch_camera_rad is not None and t_ns >= self._pitch_due_ns:
            self._pitch_due_ns = t_ns + CAMERA_PITCH_PERIOD_NS
            axes = CameraPitch(t_ns=t_ns, pitch_camera_rad=move.pitch_camera_rad, roll_camera_rad=move.roll_camera_rad)
            yield Publish(CAMERA_PITCH, axes)
        if self._feedback.is_due(t_ns):
            yield from self._feedback.send(t_ns, self._feedback_now(t_ns, move, odometry, inbox))

    def _moved_beyond(self, move: Move, shift_ned_m: Vec3) -> str:
        """Reason why the goal's points are beyond the limits after a step of the autopilot's position, or ""."""
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
            paused=self._pause.paused,
        )
        return Publish(SETPOINT, setpoint)

    def _state(self, t_ns: int, inbox: Inbox, odometry: Odometry) -> VehicleState:
        return self._view.state(t_ns, inbox, odometry, self._pause.behind_ns)

    def _feedback_now(self, t_ns: int, move: Move, odometry: Odometry, inbox: Inbox) -> Feedback[Any]:
        rest = remaining_of(self._behaviour, self._state(t_ns, inbox, odometry))
        status, paused = inbox.latest(STATUS), self._pause.paused
        return self._feedback.make(t_ns, move, odometry, status, rest, paused=paused, changes=self._changes)

    # -- releasing --

    def _release(self, t_ns: int, done: Done, inbox: Inbox) -> Iterator[Output]:
        odometry = self._view.odometry(inbox)
        if self._move is not None and odometry is not None and self._capture is not None:
            # Feedback that is not due yet, because no later one would report the last pictures.
            yield from self._feedback.send(t_ns, self._feedback_now(t_ns, self._move, odometry, inbox))
        self.stage = "releasing"
        self._done = done
        self._deadline_ns = t_ns + int(RELEASE_GIVE_UP_S * NS_PER_S)
        yield from self._call_release(t_ns, done, inbox)

    def _call_release(self, t_ns: int, done: Done, inbox: Inbox) -> Iterator[Output]:
        self._attempt += 1
        self._retry_ns = None
        self._tag = f"{self._goal_id}/release/{self._attempt}/{t_ns}"
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
        timeout_s = RELEASE_HOVER_TIMEOUT_S if hovers else RELEASE_DISARM_TIMEOUT_S
        yield Call(RELEASE, release, self._tag, timeout_s)

    def _releasing(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        done = self._done
        response = next((response for response in inbox.responses if response.tag == self._tag), None)
        ended: Done | None = None
        if response is not None and response.payload is not None:
            ended = self._end_by_reply(response.payload, done, t_ns, inbox)
        elif response is not None:
            self._retry_ns = t_ns + int(RETRY_S * NS_PER_S)
        if ended is None:
            ended = self._end_without_reply(t_ns, done, inbox)
        if ended is not None:
            yield from self._finish(t_ns, inbox, ended)
            return
        if self._retry_ns is not None and t_ns >= self._retry_ns:
            yield from self._call_release(t_ns, done, inbox)
        status, odometry = inbox.latest(STATUS), self._view.odometry(inbox)
        still_ours = status is not None and self._control.is_ours(status)
        if done.outcome == "succeeded" and still_ours and self._move is not None and odometry is not None:
            yield self._setpoint(t_ns, self._move, odometry, self._view.shift(odometry))

    def _end_by_reply(self, reply: ReleaseReply, done: Done, t_ns: int, inbox: Inbox) -> Done:
        """End by the bridge's reply to a release; a refused release makes a success an abort."""
        if reply.released or (self._attempt > 1 and self._is_settled(done, t_ns, inbox)):
            return done
        outcome = "aborted" if done.outcome == "succeeded" else done.outcome
        return Done(outcome, "; ".join(text for text in (done.reason, reply.reason) if text))

    def _is_settled(self, done: Done, t_ns: int, inbox: Inbox) -> bool:
        """Whether the vehicle is in the state that the release requested, because only its reply was lost."""
        status = inbox.latest(STATUS)
        if status is None or not is_fresh(status, t_ns, STATUS_AGE_MAX_S) or self._control.is_ours(status):
            return False
        if done.outcome == "succeeded":
            return status.code == (StatusCode.HOVER if done.then == "hover" else StatusCode.IDLE)
        return status.code in (StatusCode.IDLE, StatusCode.HOVER)

    def _end_without_reply(self, t_ns: int, done: Done, inbox: Inbox) -> Done | None:
        """End when no reply can come any more, because the bridge restarted or is silent; None: a reply may come."""
        reason = self._control.bridge_loss_reason(t_ns, inbox)
        if t_ns > self._deadline_ns:
            reason = reason or "the vehicle bridge did not confirm the end of the goal"
        if not reason:
            return None
        return Done("aborted", "; ".join(text for text in (done.reason, reason) if text))

    # -- the end --

    def _finish(self, t_ns: int, inbox: Inbox, done: Done) -> Iterator[Output]:
        self.stage = "over"
        if self._lease is not None:
            yield from self._lease.end(t_ns)
        odometry = self._view.odometry(inbox)
        pos_uav_ned_m = (0.0, 0.0, 0.0) if odometry is None else odometry.pos_uav_ned_m
        self.result = Result(
            goal_id=self._goal_id,
            t_ns=t_ns,
            outcome=done.outcome,
            reason=done.reason,
            result=self._behaviour.result(done.outcome == "succeeded", pos_uav_ned_m),
            position_deg=_position_deg(odometry),
        )
        yield from (Reply(watcher, self.result) for watcher in self._watchers)


def _position_deg(odometry: Odometry | None) -> Vec3 | None:
    """Latitude, longitude and altitude of the vehicle; None while the origin is unknown."""
    if odometry is None or odometry.origin_deg is None:
        return None
    return geodetic_from_ned(odometry.pos_uav_ned_m, odometry.origin_deg)
