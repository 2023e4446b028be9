"""Who is in charge, what the status is, and what is asked of the autopilot. Source: spec §3, architecture §5.

Time and the vehicle come in as a `Situation`; out come `code`, `target` (what to stream) and `wanted` (what to order).
"""

from math import degrees

from jezero.frames import Vec3
from jezero.schemas.commands import Acquire, Hover, Release, Setpoint
from jezero.schemas.state import InCharge, StatusCode
from jezero.services.vehicle_bridge.admission import (
    Grant,
    in_words,
    is_within_limits,
    phases_of,
    why_not_acquire,
    why_not_force,
    why_not_hover,
    why_not_setpoint,
)
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.goal_history import GoalsPast
from jezero.services.vehicle_bridge.maneuvers import Aborting, coming_to_rest, hovering_after, pressing_down
from jezero.services.vehicle_bridge.resets import ResetHistory
from jezero.services.vehicle_bridge.takeover import Takeover, Tidying
from jezero.services.vehicle_bridge.transitions import CODE_OF, IN_PROGRESS, completed, require
from jezero.services.vehicle_bridge.vehicle import LAND, OFFBOARD, Order, Situation, Standing, Target

GRANT_TIMEOUT_S = 0.5
HOLD_S = 0.1
"""How long a code that only reports something lasts, so that everyone sees it."""
STREAM_FIRST_S = 0.2
"""Setpoints stream this long before the autopilot is asked for offboard mode."""


class Authority:
    """The state machine behind `status`.

    Attributes:
        code: the present status.
        text: the last event worth telling.
        grant: of the goal in charge, or None.
        target: what to stream; None: nothing.
        wanted: what to ask of the autopilot now.
        taking_back: in 13, control was asked back and is being sought.
        killing: in 13, the motors are being cut.
        changes: every standing that a change of code led to, until taken.
    """

    def __init__(self, config: VehicleBridgeConfig, boot_id: int) -> None:
        self.code = StatusCode.IDLE
        self.text = "the bridge has started"
        self.grant: Grant | None = None
        self.target: Target | None = None
        self.wanted: Order | None = None
        self.taking_back = False
        self.killing = False
        self.changes: list[Standing] = []
        self._config = config
        self._boot_id = boot_id
        self._grants = 0
        self._past = GoalsPast()
        self._other: InCharge = "failsafe"
        self._takeover = Takeover()
        self._tidying = Tidying()
        self._entered_ns: int | None = None
        self._since_ns = 0
        """When engaging, or taking back, began."""
        self._upright_ns = 0
        self._engaged = False
        """The autopilot has been seen armed and in offboard mode since the bridge asked for it."""
        self._arming = False
        """Arming was asked for and may still happen, whatever telemetry says."""
        self._seen_disarmed = False
        self._aborting = Aborting(config)
        self._landing_alone = False
        self._by_force = False
        """The landing that has ended is sure that the vehicle stands, though the autopilot is not."""

    @property
    def in_charge(self) -> InCharge:
        if self.code is StatusCode.EXTERNAL:
            return self._other
        if self.grant is not None:
            return "goal"
        return "none" if self.code is StatusCode.IDLE else "hover"

    @property
    def standing(self) -> Standing:
        goal_id, control_id = ("", "") if self.grant is None else (self.grant.goal_id, self.grant.control_id)
        return Standing(self.code, self.in_charge, goal_id, control_id, self._grants, self.text)

    # -- what others ask ---------------------------------------------------------------------------------

    def acquire(self, request: Acquire, now: Situation) -> str:
        """Give control to a goal; returns why not, or "" with the new `grant`."""
        grant = self.grant
        if grant is not None and grant.sequence < 0 and grant.goal_id == request.goal_id:
            return ""  # it asks again because the reply was lost
        refusal = self._past.why_not(request, now) or why_not_acquire(
            request, self.code, grant, self.text, now, self._config.link_timeout_s
        )
        if refusal:
            return refusal
        self._grants += 1
        self.grant = Grant(
            control_id=f"{self._boot_id:x}-{self._grants}",
            goal_id=request.goal_id,
            action=request.action,
            phases=phases_of(request.action, self.code),
            timer_ns=now.timer_ns,
        )
        self.text = f"{self.grant.name} is in charge"
        return ""

    def accept(self, setpoint: Setpoint, now: Situation, resets: ResetHistory) -> str:
        """Take one setpoint as the new target; returns why not, or ""."""
        grant = self.grant
        code = CODE_OF.get(setpoint.phase)
        refusal = why_not_setpoint(setpoint, self.code, grant, now, resets)
        if refusal or grant is None or code is None:
            return refusal
        yaw_rad = self._yaw_rad(now) if setpoint.yaw_rad is None else setpoint.yaw_rad
        target = Target(setpoint.pos_ned_m, setpoint.vel_ned_mps, setpoint.acc_ned_mps2, yaw_rad, setpoint.yaw_rate_rps)
        if setpoint.reset_counter != resets.counter:
            target = target.moved(resets.step_since(setpoint.reset_counter) or (0.0, 0.0, 0.0))
        self.target = target
        if grant.sequence < 0:
            self._past.flies(grant.goal_id)
        grant.sequence = setpoint.sequence
        grant.timer_ns = now.timer_ns
        if code is not self.code:
            if self.code is StatusCode.IDLE:
                self._since_ns = now.timer_ns
            self.text = f"{grant.name}: {setpoint.phase}"
            self._go(code, now)
        return ""

    def release(self, request: Release, now: Situation, resets: ResetHistory) -> str:
        """Take control back from a goal; returns why not, or "". It is done when the status is 3 or 0."""
        grant = self.grant
        if grant is None or grant.control_id != request.control_id:
            return self._past.why_ended(request.control_id)
        if request.outcome != "succeeded" or self.code not in IN_PROGRESS:
            because = f": {request.reason}" if request.reason else ""
            self._revoke(f"{grant.name} {request.outcome}{because}", now, given_back=True)
        elif not self._engaged:
            self._revoke(f"{grant.name} ended before the vehicle was armed in offboard mode", now, given_back=True)
        elif (self.code is StatusCode.LANDING) != (request.then != "hover"):
            return "a landing that succeeded ends with then=disarm, and nothing else does"
        elif request.then == "force_disarm" and (refusal := why_not_force(now, self._config)):
            return refusal
        else:
            self._by_force = request.then == "force_disarm"
            forced = ", disarming by force: the autopilot doesn't see the ground" if self._by_force else ""
            self._end(f"{grant.name} succeeded{forced}", given_back=True)
            if self.code is StatusCode.LANDING:
                self.target = pressing_down(self.target, self._yaw_rad(now))
            else:
                self.target = hovering_after(request, self._at_rest(now), resets)
            self._go(completed(self.code), now)
        return ""

    def hover(self, request: Hover, now: Situation) -> str:
        """Hover here, or at a point; returns why not, or "". It is done when the status is 3."""
        refusal = why_not_hover(request, self.code, self.text, self.killing, now, self._config)
        if refusal:
            return refusal
        if self.code is StatusCode.EXTERNAL:
            self._begin_taking_back(now)
            return ""
        if self.grant is not None:
            self._revoke(f"{self.grant.name} ended: hover was asked for", now)
        if self.code is StatusCode.HOVER:
            if request.hover_pos is None:
                self.target = self._at_rest(now)
                self.text = "hovering here"
            else:
                self.target = Target(request.hover_pos, None, None, self._yaw_rad(now))
                self.text = "hovering at ({:.2f}, {:.2f}, {:.2f})".format(*request.hover_pos)
        return ""

    def _begin_taking_back(self, now: Situation) -> None:
        if not self.taking_back:
            self.taking_back = True
            self._landing_alone = False
            self._since_ns = now.timer_ns
            self.target = self._at_rest(now)
            self.text = "taking control back"

    def abort(self, reason: str, now: Situation) -> str:
        """End whatever goal is in charge, and all that wait for it; returns what happened, in words."""
        self._past.aborted_ns = max(0, now.t_ns)
        if self.grant is None:
            return f"no goal was in charge, {in_words(self.code)}"
        because = f": {reason}" if reason else ""
        self._revoke(f"{self.grant.name} aborted on request{because}", now)
        return self.text

    def kill(self, why: str, now: Situation) -> None:
        """Cut the motors, wherever the vehicle is."""
        if self.code is not StatusCode.IDLE or now.armed is not False or self._arming:
            self._lose("failsafe", why, now)
            self.killing = True

    def restart(self, why: str, now: Situation) -> None:
        """The vehicle is another one than before."""
        self._past.aborted_ns = None
        if self.code is StatusCode.IDLE:
            self._end(why, given_back=False)
        else:
            self._lose("failsafe", why, now)
        self._entered_ns = now.timer_ns
        self._tidying.begin(now, at_once=True)
        self.killing = self._landing_alone = self._arming = self._seen_disarmed = False

    def moved(self, step_ned_m: Vec3, now: Situation) -> None:
        """The autopilot moved its position in one step; what is streamed moves along, a hover within the limits."""
        before = self.target
        if before is None:
            return
        self.target = before.moved(step_ned_m)
        hovers = self.code is StatusCode.HOVER and self.grant is None
        if hovers and is_within_limits(before, self._config) and not is_within_limits(self.target, self._config):
            self.target = self._at_rest(now)
            self.text = "the autopilot corrected its position, and the hover point is beyond the limits: hovering here"

    # -- what time and the vehicle do --------------------------------------------------------------------

    def tick(self, now: Situation) -> None:
        """Once per step, after all that was asked."""
        if self._entered_ns is None:
            self._entered_ns = now.timer_ns
        asked_to_arm = self._arming
        if now.armed or now.accepted in (Order.DISARM, Order.FORCE_DISARM):
            self._arming = False
        flies = self.code not in (StatusCode.IDLE, StatusCode.EXTERNAL)
        if not (flies and now.armed and now.tilt_rad > self._config.tilt_limit_rad):
            self._upright_ns = now.timer_ns
        if self.code in IN_PROGRESS and not self._engaged:
            taken_over = self._takeover.before_lift_off(now, asked_to_arm=asked_to_arm)
            if taken_over:
                self._lose_to_others(taken_over, now)
        if flies and self.code is not StatusCode.EXTERNAL:
            self._watch_flight(now)
        elif self.code is StatusCode.IDLE and now.armed:
            self._on_armed_by_others(now)
        self._seen_disarmed |= now.armed is False
        if self.grant is not None:
            self._expire(self.grant, now)
        self.wanted = self._advance(now)
        self._arming |= self.wanted is Order.ARM

    def _on_armed_by_others(self, now: Situation) -> None:
        if self._seen_disarmed:
            self._lose_to_others("armed, and not by the bridge", now)
        elif now.failsafe or now.mode == OFFBOARD:
            self._lose("failsafe", "the vehicle was armed already when the bridge first heard it", now)
        else:
            self._lose_to_others(f"the vehicle flew already, in {now.mode}, when the bridge first heard it", now)

    def _watch_flight(self, now: Situation) -> None:
        config = self._config
        taken_over = self._takeover.in_flight(now) if self._engaged else ""
        if (now.timer_ns - self._upright_ns) * 1e-9 >= config.tilt_timeout_s:
            tilt_deg = degrees(now.tilt_rad)
            self.kill(f"motors cut: tilted by {tilt_deg:.0f} degrees for {config.tilt_timeout_s:g} s", now)
        elif taken_over:
            self._lose_to_others(taken_over, now)
        elif self._engaged and now.armed is False:
            self._on_disarmed(now)
        elif now.silent_s > config.blind_timeout_s:
            self._lose("failsafe", f"no telemetry for {now.silent_s:.1f} s: left to the autopilot's failsafe", now)
        elif now.silent_s > config.link_timeout_s and self.grant is not None:
            self._revoke(f"{self.grant.name} ended: no telemetry for {now.silent_s:.1f} s", now)
        elif now.router_lost_s >= config.router_timeout_s and now.armed and not now.landed:
            self._lose("failsafe", f"landing: the bus's router has been missing for {now.router_lost_s:.0f} s", now)
            self._landing_alone = True

    def _on_disarmed(self, now: Situation) -> None:
        """The motors stopped; during a landing or an abort on the ground that is what was wanted."""
        because = f" ({now.complaint})" if now.complaint else ""
        stands = now.landed or self._by_force
        if stands and self.code in (StatusCode.LANDING, StatusCode.LANDING_DONE, StatusCode.ABORT):
            return
        if now.landed and self.code is StatusCode.TAKEOFF and self.grant is not None:
            self._revoke(f"{self.grant.name} ended: the autopilot disarmed before lift-off{because}", now)
        else:
            self._lose("failsafe", f"the autopilot disarmed in status {self.code.name}{because}", now)

    def _expire(self, grant: Grant, now: Situation) -> None:
        silent_s = (now.timer_ns - grant.timer_ns) * 1e-9
        if silent_s > (GRANT_TIMEOUT_S if grant.sequence < 0 else self._config.setpoint_timeout_s):
            self._revoke(f"{grant.name} ended: it sent no setpoint for {silent_s:.2f} s", now)

    def _advance(self, now: Situation) -> Order | None:
        """Move on where time or the vehicle says so; returns what to ask of the autopilot."""
        code = self.code
        if code is StatusCode.EXTERNAL:
            return self._advance_external(now)
        if code is StatusCode.IDLE:
            return Order.HOLD if self._tidying.is_wanted(now) else None
        if code in IN_PROGRESS:
            return self._engage(now)
        if code is StatusCode.ABORT:
            return self._advance_abort(now)
        if code is StatusCode.LANDING_DONE:
            return self._disarm(now)
        if code is not StatusCode.HOVER and self._held_s(now) >= HOLD_S:
            self._go(StatusCode.HOVER, now)
        return None

    def _engage(self, now: Situation) -> Order | None:
        if self._engaged or self.grant is None:
            return None
        waited_s = (now.timer_ns - self._since_ns) * 1e-9
        if now.armed and now.mode == OFFBOARD:
            self._engaged = True
        elif waited_s > self._config.engage_timeout_s:
            why = now.complaint or "the autopilot gives no reason"
            self._revoke(f"{self.grant.name} ended: could not arm in offboard mode: {why}", now)
        elif waited_s >= STREAM_FIRST_S and now.mode == OFFBOARD:
            return Order.ARM
        elif waited_s >= STREAM_FIRST_S and not self._takeover.was_offboard:
            return Order.OFFBOARD
        return None

    def _advance_abort(self, now: Situation) -> Order | None:
        if now.landed is not self._aborting.on_ground and not self._plan_abort(now):
            return None
        if self._aborting.on_ground:
            return self._disarm(now)
        held_s = self._held_s(now)
        if held_s >= HOLD_S and self._aborting.is_done(now, held_s):
            self._go(StatusCode.HOVER, now)
        return None

    def _disarm(self, now: Situation) -> Order | None:
        held_s = self._held_s(now)
        if now.armed is False and not self._arming:
            self.target = None
            if held_s >= HOLD_S:
                self._go(StatusCode.IDLE, now)
            return None
        if held_s > self._config.disarm_timeout_s:
            why = now.complaint or "it gives no reason"
            self._lose("failsafe", f"the autopilot did not disarm within {held_s:.0f} s: {why}", now)
            return None
        by_force = self._by_force and not now.landed and not why_not_force(now, self._config)
        return Order.FORCE_DISARM if by_force else Order.DISARM

    def _advance_external(self, now: Situation) -> Order | None:
        if self.killing:
            self.killing = now.armed is not False or self._arming
            return Order.FORCE_DISARM if self.killing else None
        if now.armed is False:
            self.taking_back = self._landing_alone = False
            self.target = None
            if now.landed:
                self.text += "; landed and disarmed"
                self._go(StatusCode.IDLE, now)
            return None
        if self.taking_back:
            return self._advance_taking_back(now)
        handed_over = self._takeover.of_others(now)
        if handed_over is not None and not self._landing_alone:
            self._other, self.text = handed_over
        self._landing_alone &= now.mode != LAND
        return Order.LAND if self._landing_alone else None

    def _advance_taking_back(self, now: Situation) -> Order | None:
        waited_s = (now.timer_ns - self._since_ns) * 1e-9
        if waited_s > self._config.engage_timeout_s:
            self.taking_back = False
            self.target = None
            self.text = f"control could not be taken back: {now.complaint or 'the autopilot gives no reason'}"
        elif waited_s >= STREAM_FIRST_S and now.mode != OFFBOARD:
            return Order.OFFBOARD
        elif waited_s >= STREAM_FIRST_S:
            self.taking_back = False
            self._engaged = True
            self.text = "hovering: control was taken back"
            self._go(StatusCode.HOVER, now)
        return None

    # -- steps that several of these take ----------------------------------------------------------------

    def _go(self, code: StatusCode, now: Situation) -> None:
        require(self.code, code)
        self._takeover.begin(now)
        if code is StatusCode.IDLE:
            self._tidying.begin(now, at_once=self.in_charge != "external")
        self.code = code
        self._entered_ns = now.timer_ns
        if code in (StatusCode.IDLE, StatusCode.EXTERNAL):
            self._engaged = self._by_force = False
            self.target = None
        self.changes.append(self.standing)

    def _held_s(self, now: Situation) -> float:
        return 0.0 if self._entered_ns is None else (now.timer_ns - self._entered_ns) * 1e-9

    def _end(self, why: str, *, given_back: bool) -> None:
        if self.grant is not None:
            self._past.end(self.grant, "" if given_back else why)
        self.grant = None
        self.text = why

    def _revoke(self, why: str, now: Situation, *, given_back: bool = False) -> None:
        """The goal's flight ends in an abort; a grant that was not used yet just ends."""
        self._end(why, given_back=given_back)
        if self.code in IN_PROGRESS:
            self._go(StatusCode.ABORT, now)
            self._plan_abort(now)

    def _lose_to_others(self, what: str, now: Situation) -> None:
        """Status 13 because of what the autopilot's failsafe did, or whom else it obeys."""
        if now.failsafe:
            because = f" ({now.complaint})" if now.complaint else ""
            self._lose("failsafe", f"failsafe: {what}{because}", now)
        else:
            self._lose("external", f"taken over: {what}", now)

    def _lose(self, other: InCharge, why: str, now: Situation) -> None:
        """Status 13: silence."""
        self._end(why, given_back=False)
        self._other = other
        self.taking_back = self._landing_alone = False
        self.target = None
        if self.code is not StatusCode.EXTERNAL:
            self._go(StatusCode.EXTERNAL, now)

    def _plan_abort(self, now: Situation) -> bool:
        """Decide where an abort leads; returns whether the status is still 12."""
        if not now.landed and (now.pos_ned_m is None or now.height_m is None):
            self._lose("failsafe", f"{self.text}; the position is unknown", now)
            return False
        self.target = self._aborting.plan(self.target, now, self._yaw_rad(now))
        return True

    def _yaw_rad(self, now: Situation) -> float:
        """The heading that is being held."""
        return now.yaw_rad if self.target is None else self.target.yaw_rad

    def _at_rest(self, now: Situation) -> Target:
        return coming_to_rest(now, self._yaw_rad(now), self._config.low_height_m)
