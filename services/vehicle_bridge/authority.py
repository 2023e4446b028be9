"""State machine that decides who controls the vehicle and what is commanded. Source: spec §3, architecture §5.

Inputs are requests, setpoints and a `VehicleSnapshot` per step; outputs are `code`, `streamed` and `command`.
`Authority.accept` makes a setpoint of the goal in charge the target, unless `setpoint_refusal` gives a reason. At the
end of each step `motion_limits` limits the target to what may be streamed, and `AutopilotLink.setpoint` packs that.

Below the state machine: refusals of setpoints, and the targets of setpoints, hovers, releases and aborts.
"""

from collections.abc import Collection
from itertools import chain
from math import isfinite

import msgspec

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.commands import Acquire, Hover, Release, Setpoint
from jezero.schemas.state import InCharge, StatusCode
from jezero.services.vehicle_bridge.admission import (
    CODE_OF,
    IN_PROGRESS,
    REPORT_MIN_S,
    Grant,
    Grants,
    completed,
    hover_refusal,
    in_words,
    is_allowed,
    leaves_limits,
    release_refusal,
    require,
    status_words,
)
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.fence import FenceKeeper
from jezero.services.vehicle_bridge.flight_monitor import Disarming, EngagementTimer, FlightMonitor
from jezero.services.vehicle_bridge.takeover import TakeoverDetector, UnarmableModeDetector
from jezero.services.vehicle_bridge.vehicle import (
    LAND,
    OFFBOARD,
    AutopilotCommand,
    ResetHistory,
    Target,
    VehicleSnapshot,
)

MAX_AGE_NS = 300_000_000
"""A setpoint is flown up to this age."""
MAX_LEAD_NS = 50_000_000
"""A setpoint may seem to come from the future by this much: clocks of two hosts are mapped, not shared."""
STOPPING_TIME_S = 0.5
"""A hover begins at the point that the present velocity reaches in this time, so that the vehicle needn't turn back."""
LOW_HEIGHT_M = 1.0
"""Height over ground or platform below which no descent comes to rest, and an aborted vehicle climbs."""
PRESS_DOWN_MPS = 0.5
"""Commanded descent on the ground until the motors stop. Source: spec §8."""
CLIMB_HEIGHT_M = 1.5
"""Height over ground or platform to which a low vehicle climbs."""
CLIMB_TIMEOUT_S = 5.0
CLIMB_TOLERANCE_M = 0.3


class ControlState(msgspec.Struct, frozen=True):
    """The fields of `status` that the authority decides, at one time."""

    code: StatusCode
    in_charge: InCharge
    goal_id: str
    action: str
    grant: int
    grants: int
    interventions: int
    text: str
    paused: bool

    @property
    def visible(self) -> tuple[object, ...]:
        """Fields whose change is published at once."""
        return self.code, self.in_charge, self.grant, self.interventions, self.paused


class Authority:
    """The state machine behind `status`.

    Attributes:
        code: the present status.
        text: the last event, for people.
        target: setpoint to follow, None for none.
        streamed: the target within the fence and the limits, which goes to the autopilot.
        command: command to the autopilot, None for none.
        taking_back: in status 13, the bridge tries to take control back.
        killing: in status 13, the motors are being cut.
        changes: the control state after each change of code; the publisher empties the list.
        interventions: number of requests to hover, abort or kill so far.
    """

    def __init__(self, config: VehicleBridgeConfig, robot: VehicleConfig, fence: FenceKeeper, secret: str) -> None:
        self.code = StatusCode.IDLE
        self.text = "the bridge has started"
        self.target: Target | None = None
        self.streamed: Target | None = None
        self.command: AutopilotCommand | None = None
        self.taking_back = self.killing = False
        self.changes: list[ControlState] = []
        self.interventions = 0
        self._robot = robot
        self._fence = fence
        self._grants = Grants(secret)
        self._external_holder: InCharge = "failsafe"
        self._takeover = TakeoverDetector()
        self._unarmable_mode = UnarmableModeDetector()
        self._monitor = FlightMonitor(config.router_timeout_s)
        self._abort_maneuver = AbortManeuver()
        self._code_since_ns = 0
        self._engagement = EngagementTimer()
        self._engaged = False
        """The autopilot has been armed and in offboard mode since the bridge commanded it."""
        self._arm_pending = False
        """Arming was commanded and may still happen, whatever telemetry reports."""
        self._was_disarmed = False
        self._land_commanded = False
        self._disarming = Disarming(robot)

    @property
    def grant(self) -> Grant | None:
        """Grant of the goal in charge."""
        return self._grants.present

    @property
    def in_charge(self) -> InCharge:
        """Who controls the vehicle."""
        if self.code is StatusCode.EXTERNAL:
            return self._external_holder
        if self.grant is not None:
            return "goal"
        return "none" if self.code is StatusCode.IDLE else "hover"

    @property
    def control_state(self) -> ControlState:
        """What `status` says of control."""
        grant = self.grant
        return ControlState(
            code=self.code,
            in_charge=self.in_charge,
            goal_id="" if grant is None else grant.goal_id,
            action="" if grant is None else grant.action,
            grant=0 if grant is None else self._grants.count,
            grants=self._grants.count,
            interventions=self.interventions,
            text=self.text,
            paused=grant is not None and grant.paused,
        )

    # -- requests and setpoints --------------------------------------------------------------------------

    def acquire(self, request: Acquire, vehicle: VehicleSnapshot) -> str:
        """Give control to a goal; returns the reason for a refusal, or "" with the new `grant`."""
        refusal = self._grants.acquire(request, self.code, self.text, vehicle)
        if self.grant is not None and not refusal and not request.check_only:
            self.text = f"{self.grant.name} is in charge"
        return refusal

    def accept(self, setpoint: Setpoint, vehicle: VehicleSnapshot, resets: ResetHistory) -> str:
        """Make a setpoint the new target; returns the reason for a refusal, or ""."""
        grant, code = self.grant, CODE_OF.get(setpoint.phase)
        refusal = setpoint_refusal(setpoint, self.code, grant, vehicle, resets)
        if refusal or grant is None or code is None:
            if refusal and grant is not None and setpoint.control_id == grant.control_id:
                grant.refusal = refusal
            return refusal
        self.target = setpoint_target(setpoint, self.target, vehicle, resets)
        if grant.sequence < 0:
            self._grants.add_flown(grant.goal_id)
        self.text = grant.follow(setpoint, vehicle) or self.text
        if code is not self.code:
            if self.code is StatusCode.IDLE:
                self._engagement.start(vehicle)
            because = f"; {grant.overriding}" if grant.overriding else ""
            takes_off_first = code is StatusCode.TAKEOFF and grant.action != setpoint.phase
            self.text = f"{grant.name} {'begins with a takeoff' if takes_off_first else 'has begun'}{because}"
            self._set_code(code, vehicle)
        return ""

    def release(self, request: Release, vehicle: VehicleSnapshot, resets: ResetHistory) -> str:
        """Take a goal's control; returns the reason for a refusal, or "". It is done when the status is 3 or 0."""
        grant = self.grant
        if grant is None or grant.control_id != request.control_id:
            return self._grants.end_reason(request.control_id)
        if request.outcome != "succeeded" or self.code not in IN_PROGRESS:
            because = f": {request.reason}" if request.reason else ""
            self._revoke(f"{grant.name} {request.outcome}{because}", vehicle, released=True)
        elif not self._engaged:
            self._revoke(f"{grant.name} ended before the vehicle was armed in offboard mode", vehicle, released=True)
        elif refusal := release_refusal(request, self.code, vehicle, self._robot):
            return refusal
        else:
            self._disarming.by_force = request.then == "force_disarm"
            forced = ", disarming by force: the autopilot doesn't detect the ground" if self._disarming.by_force else ""
            self._end_grant(f"{grant.name} succeeded{forced}", released=True)
            if self.code is StatusCode.LANDING:
                self.target = press_down_target(self.target, vehicle)
            else:
                self.target = released_target(request, stopping_target(self.target, vehicle), resets)
            self._set_code(completed(self.code), vehicle)
        return ""

    def hover(self, request: Hover, vehicle: VehicleSnapshot) -> str:
        """Hover here or at a point; returns the reason for a refusal, or "". It is done when the status is 3."""
        refusal = hover_refusal(request, self.code, self.text, self.killing, vehicle, self._robot.limits)
        if refusal := refusal or self._fence.point_refusal(request.hover_pos):
            return refusal
        self.interventions += 1
        if self.code is StatusCode.EXTERNAL:
            self._begin_taking_back(vehicle)
            return ""
        if self.grant is not None:
            self._revoke(f"{self.grant.name} ended: hover was requested", vehicle)
        if self.code is StatusCode.HOVER:
            self.target, self.text = hover_target(request, stopping_target(self.target, vehicle))
        return ""

    def _begin_taking_back(self, vehicle: VehicleSnapshot) -> None:
        if not self.taking_back:
            self.taking_back = True
            self._land_commanded = False
            self._engagement.start(vehicle)
            self.target = stopping_target(self.target, vehicle)
            self.text = "taking control back"

    def abort(self, reason: str, vehicle: VehicleSnapshot) -> str:
        """End the goal in charge and all goals that wait for control; returns the event, for people."""
        self._grants.last_abort_ns = max(0, vehicle.t_ns)
        self.interventions += 1
        if self.grant is None:
            return f"no goal was in charge, {status_words(self.code)}"
        because = f": {reason}" if reason else ""
        self._revoke(f"{self.grant.name} aborted on request{because}", vehicle)
        return self.text

    def kill(self, reason: str, vehicle: VehicleSnapshot) -> None:
        """Cut the motors, in the air too."""
        if self.code is not StatusCode.IDLE or vehicle.armed is not False or self._arm_pending:
            self._lose_control("failsafe", reason, vehicle)
            self.killing = True

    # -- events and time ---------------------------------------------------------------------------------

    def on_restart(self, reason: str, vehicle: VehicleSnapshot) -> None:
        """Start again with another vehicle, about which nothing is known."""
        self._grants.last_abort_ns = None
        if self.code is StatusCode.IDLE:
            self._end_grant(reason)
        else:
            self._lose_control("failsafe", reason, vehicle)
        self._code_since_ns = vehicle.timer_ns
        self._unarmable_mode.reset(vehicle, own_flight=True)
        self.killing = self._land_commanded = self._arm_pending = self._was_disarmed = False

    def on_position_step(self, step_ned_m: Vec3, vehicle: VehicleSnapshot) -> None:
        """Move the target along when the autopilot's position estimate has stepped; a hover stays within the limits."""
        before = self.target
        if before is None:
            return
        self.target = before.moved(step_ned_m)
        hovers = self.code is StatusCode.HOVER and self.grant is None
        if hovers and leaves_limits(before, self.target, self._robot.limits):
            self.target = stopping_target(self.target, vehicle)
            self.text = "the autopilot corrected its position, and the hover point is beyond the limits: hovering here"

    def update(self, vehicle: VehicleSnapshot, departed: Collection[str] = ()) -> None:
        """Judge safety and time-outs once in each step, after all requests; `departed` are services that vanished."""
        arm_commanded = self._arm_pending
        if vehicle.armed or vehicle.acknowledged in (AutopilotCommand.DISARM, AutopilotCommand.FORCE_DISARM):
            self._arm_pending = False
        flying = self.code not in (StatusCode.IDLE, StatusCode.EXTERNAL)
        self._monitor.update(vehicle, self.streamed, flying=flying)
        left_fence = self._fence.update(vehicle)
        takeover = None
        if self.code in IN_PROGRESS and not self._engaged:
            takeover = self._takeover.before_lift_off(vehicle, arm_commanded=arm_commanded)
        elif self.code is StatusCode.IDLE:
            takeover = self._takeover.while_idle(vehicle, was_disarmed=self._was_disarmed)
        if takeover:
            self._lose_control(*takeover, vehicle)
        elif flying:
            self._judge_flight(vehicle, left_fence=left_fence)
        self._was_disarmed |= vehicle.armed is False
        end, late = self._grants.silence(vehicle, departed)
        if end:
            self._revoke(end, vehicle)
        elif late:
            self.text, self.target = late, stopping_target(self.target, vehicle)
        self.command = self._advance(vehicle)
        self._arm_pending |= self.command is AutopilotCommand.ARM
        self.streamed = self._fence.limited(self.target, vehicle, self.code, by_goal=self.grant is not None)

    def _judge_flight(self, vehicle: VehicleSnapshot, *, left_fence: bool) -> None:
        monitor = self._monitor
        takeover = self._takeover.in_flight(vehicle) if self._engaged else None
        if reason := monitor.kill_reason(vehicle):
            self.kill(reason, vehicle)
        elif takeover:
            self._lose_control(*takeover, vehicle)
        elif self._engaged and vehicle.armed is False:
            self._on_disarmed(vehicle)
        elif reason := monitor.blind_reason(vehicle):
            self._lose_control("failsafe", reason, vehicle)
        elif self.grant is not None and (reason := monitor.link_reason(vehicle)):
            self._revoke(f"{self.grant.name} ended: {reason}", vehicle)
        elif reason := monitor.router_reason(vehicle):
            self._land(reason, vehicle)
        elif left_fence and not vehicle.landed:
            self._on_left_fence(f"the vehicle is {self._fence.outside}", vehicle)

    def _on_left_fence(self, reason: str, vehicle: VehicleSnapshot) -> None:
        if self._fence.on_fence == "land":
            self._land(f"landing: {reason}", vehicle)
        elif self.grant is not None:
            self._revoke(f"{self.grant.name} ended: {reason}", vehicle)
        else:
            self.text = reason

    def _on_disarmed(self, vehicle: VehicleSnapshot) -> None:
        """The motors stopped, which is the aim of a landing and of an abort on the ground, and else a failure."""
        because = f" ({vehicle.command_failure})" if vehicle.command_failure else ""
        on_ground = vehicle.landed or self._disarming.by_force
        if on_ground and self.code in (StatusCode.LANDING, StatusCode.LANDING_DONE, StatusCode.ABORT):
            return
        if vehicle.landed and self.code is StatusCode.TAKEOFF and self.grant is not None:
            self._revoke(f"{self.grant.name} ended: the autopilot disarmed before lift-off{because}", vehicle)
        else:
            doing = status_words(self.code)
            self._lose_control("failsafe", f"the autopilot disarmed while {doing}{because}", vehicle)

    def _advance(self, vehicle: VehicleSnapshot) -> AutopilotCommand | None:
        """Change the code where time or the vehicle's state says so; returns the command to the autopilot."""
        code = self.code
        if code is StatusCode.EXTERNAL:
            return self._advance_external(vehicle)
        if code is StatusCode.IDLE:
            return AutopilotCommand.HOLD if self._unarmable_mode.update(vehicle) else None
        if code in IN_PROGRESS:
            return self._engage(vehicle)
        if code is StatusCode.ABORT:
            return self._advance_abort(vehicle)
        if code is StatusCode.LANDING_DONE:
            return self._disarm(vehicle)
        if code is not StatusCode.HOVER and self._code_age_s(vehicle) >= REPORT_MIN_S:
            self._set_code(StatusCode.HOVER, vehicle)
        elif self.grant is None and (point := self._fence.return_point(self.target, vehicle)):
            self.target = Target(point, None, None, heading_rad(self.target, vehicle))
            self.text += "; it returns inside the fence"
        return None

    def _engage(self, vehicle: VehicleSnapshot) -> AutopilotCommand | None:
        if self._engaged or self.grant is None:
            return None
        if vehicle.armed and vehicle.mode == OFFBOARD:
            self._engaged = True
        elif self.grant.is_late:
            return None
        elif self._engagement.is_overdue(vehicle):
            self._revoke(f"{self.grant.name} ended: could not arm in offboard mode: {vehicle.failure_reason}", vehicle)
        elif self._engagement.may_command(vehicle) and vehicle.mode == OFFBOARD:
            return AutopilotCommand.ARM
        elif self._engagement.may_command(vehicle) and not self._takeover.was_offboard:
            return AutopilotCommand.OFFBOARD
        return None

    def _advance_abort(self, vehicle: VehicleSnapshot) -> AutopilotCommand | None:
        if vehicle.landed is not self._abort_maneuver.on_ground and not self._plan_abort(vehicle):
            return None
        if self._abort_maneuver.on_ground:
            return self._disarm(vehicle)
        elapsed_s = self._code_age_s(vehicle)
        if elapsed_s >= REPORT_MIN_S and self._abort_maneuver.is_done(vehicle, elapsed_s):
            self._set_code(StatusCode.HOVER, vehicle)
        return None

    def _disarm(self, vehicle: VehicleSnapshot) -> AutopilotCommand | None:
        elapsed_s = self._code_age_s(vehicle)
        if vehicle.armed is False and not self._arm_pending:
            self.target = None
            if elapsed_s >= REPORT_MIN_S:
                self._set_code(StatusCode.IDLE, vehicle)
            return None
        if reason := self._disarming.overdue_reason(vehicle, elapsed_s):
            self._lose_control("failsafe", reason, vehicle)
            return None
        return self._disarming.command(vehicle)

    def _advance_external(self, vehicle: VehicleSnapshot) -> AutopilotCommand | None:
        if self.killing:
            self.killing = vehicle.armed is not False or self._arm_pending
            return AutopilotCommand.FORCE_DISARM if self.killing else None
        if vehicle.armed is False:
            self.taking_back = self._land_commanded = False
            self.target = None
            if vehicle.landed:
                self.text += "; landed and disarmed"
                self._set_code(StatusCode.IDLE, vehicle)
            return None
        if self.taking_back:
            return self._advance_taking_back(vehicle)
        handover = self._takeover.handover(vehicle)
        if handover is not None and not (self._land_commanded and vehicle.mode == LAND):
            self._external_holder, self.text = handover
        self._land_commanded &= vehicle.mode == OFFBOARD  # else it lands, or a pilot or a failsafe has it
        return AutopilotCommand.LAND if self._land_commanded else None

    def _advance_taking_back(self, vehicle: VehicleSnapshot) -> AutopilotCommand | None:
        if self._engagement.is_overdue(vehicle):
            self.taking_back = False
            self.target = None
            self.text = f"control could not be taken back: {vehicle.failure_reason}"
        elif self._engagement.may_command(vehicle) and vehicle.mode != OFFBOARD:
            return AutopilotCommand.OFFBOARD
        elif self._engagement.may_command(vehicle):
            self.taking_back = False
            self._engaged = True
            self.text = "hovering: control was taken back"
            self._set_code(StatusCode.HOVER, vehicle)
        return None

    # -- shared by requests and time ---------------------------------------------------------------------

    def _set_code(self, code: StatusCode, vehicle: VehicleSnapshot) -> None:
        require(self.code, code)
        self._takeover.reset(vehicle)
        if code is StatusCode.IDLE:
            self._unarmable_mode.reset(vehicle, own_flight=self.in_charge != "external")
        self.code = code
        self._code_since_ns = vehicle.timer_ns
        if code in (StatusCode.IDLE, StatusCode.EXTERNAL):
            self._engaged = self._disarming.by_force = False
            self.target = None
        self.changes.append(self.control_state)

    def _code_age_s(self, vehicle: VehicleSnapshot) -> float:
        return (vehicle.timer_ns - self._code_since_ns) * 1e-9

    def _end_grant(self, text: str, *, released: bool = False) -> None:
        self._grants.end("" if released else text)
        self.text = text

    def _revoke(self, reason: str, vehicle: VehicleSnapshot, *, released: bool = False) -> None:
        """End the grant, and abort the flight; a grant that was not used yet only ends."""
        self._end_grant(reason, released=released)
        if self.code in IN_PROGRESS:
            self._set_code(StatusCode.ABORT, vehicle)
            self._plan_abort(vehicle)

    def _lose_control(self, holder: InCharge, reason: str, vehicle: VehicleSnapshot) -> None:
        """Enter status 13, in which the bridge streams and commands nothing."""
        self._end_grant(reason)
        self._external_holder = holder
        self.taking_back = self._land_commanded = False
        self.target = None
        if self.code is not StatusCode.EXTERNAL:
            self._set_code(StatusCode.EXTERNAL, vehicle)

    def _land(self, reason: str, vehicle: VehicleSnapshot) -> None:
        """Leave the landing to the autopilot."""
        self._lose_control("failsafe", reason, vehicle)
        self._land_commanded = True

    def _plan_abort(self, vehicle: VehicleSnapshot) -> bool:
        """Plan the abort manoeuvre; returns False when control was lost instead, as the position is unknown."""
        if not vehicle.landed and (vehicle.pos_ned_m is None or vehicle.height_m is None):
            self._lose_control("failsafe", f"{self.text}; the position is unknown", vehicle)
            return False
        self.target = self._abort_maneuver.plan(self.target, vehicle)
        return True


# -- setpoints -------------------------------------------------------------------------------------------


def setpoint_refusal(
    setpoint: Setpoint, code: StatusCode, holder: Grant | None, vehicle: VehicleSnapshot, resets: ResetHistory
) -> str:
    """Reason why this setpoint is dropped, or ""."""
    age_ns, phase, pos_ned_m = vehicle.t_ns - setpoint.t_ns, setpoint.phase, setpoint.pos_ned_m
    next_code, counter = CODE_OF.get(phase), setpoint.reset_counter
    if holder is None or setpoint.control_id != holder.control_id:
        return "its control is not in charge"
    refusal = ""
    if setpoint.sequence <= holder.sequence:
        refusal = f"sequence {setpoint.sequence} after {holder.sequence}"
    elif not -MAX_LEAD_NS <= age_ns <= MAX_AGE_NS:
        refusal = f"{age_ns * 1e-9:.3f} s old; accepted are {-MAX_LEAD_NS * 1e-9:g} to {MAX_AGE_NS * 1e-9:g} s"
    elif next_code is None or phase not in holder.phases or (next_code is not code and not is_allowed(code, next_code)):
        refusal = f"the phase {in_words(phase)} of {holder.name} while {status_words(code)}"
    elif pos_ned_m is None and setpoint.vel_ned_mps is None:
        refusal = "neither a position nor a velocity"
    elif pos_ned_m is not None and counter != resets.counter and resets.step_since(counter) is None:
        refusal = f"reset counter {counter} is unknown; the present one is {resets.counter}"
    elif not _is_finite(setpoint):
        refusal = "a number that is not finite"
    return refusal


def _is_finite(setpoint: Setpoint) -> bool:
    vectors = (setpoint.pos_ned_m, setpoint.vel_ned_mps, setpoint.acc_ned_mps2)
    numbers = chain(*(vector for vector in vectors if vector), (setpoint.yaw_rad or 0.0, setpoint.yaw_rate_rps or 0.0))
    return all(map(isfinite, numbers))


# -- targets ---------------------------------------------------------------------------------------------


def setpoint_target(
    setpoint: Setpoint, previous: Target | None, vehicle: VehicleSnapshot, resets: ResetHistory
) -> Target:
    """Target of an accepted setpoint, moved by the resets since it was computed; the heading stays where the setpoint
    has none."""
    yaw_rad = heading_rad(previous, vehicle) if setpoint.yaw_rad is None else setpoint.yaw_rad
    target = Target(setpoint.pos_ned_m, setpoint.vel_ned_mps, setpoint.acc_ned_mps2, yaw_rad, setpoint.yaw_rate_rps)
    if setpoint.reset_counter == resets.counter:
        return target
    return target.moved(resets.step_since(setpoint.reset_counter) or (0.0, 0.0, 0.0))


def stopping_target(previous: Target | None, vehicle: VehicleSnapshot) -> Target:
    """Hover where the vehicle comes to rest, with the same heading; a descent ends above `LOW_HEIGHT_M`."""
    pos_ned_m, vel = vehicle.pos_ned_m or (0.0, 0.0, 0.0), vehicle.vel_ned_mps
    room_m = max(0.0, (vehicle.height_m or 0.0) - LOW_HEIGHT_M)
    down_m = min(vel[2] * STOPPING_TIME_S, room_m)
    north_m, east_m = pos_ned_m[0] + vel[0] * STOPPING_TIME_S, pos_ned_m[1] + vel[1] * STOPPING_TIME_S
    return Target((north_m, east_m, pos_ned_m[2] + down_m), None, None, heading_rad(previous, vehicle))


def hover_target(request: Hover, stopping: Target) -> tuple[Target, str]:
    """Hover where a request says, with the heading of `stopping`, or at `stopping`; and the event, for people."""
    if request.hover_pos is None:
        return stopping, "hovering here"
    text = "hovering at ({:.2f}, {:.2f}, {:.2f})".format(*request.hover_pos)
    return Target(request.hover_pos, None, None, stopping.yaw_rad), text


def released_target(release: Release, stopping: Target, resets: ResetHistory) -> Target:
    """Hover where a finished goal's release says, with the heading of `stopping`; at `stopping` where it says nothing
    or its reset counter is unknown."""
    step_ned_m = resets.step_since(release.reset_counter)
    if release.hover_pos_ned_m is None or step_ned_m is None:
        return stopping
    return Target(release.hover_pos_ned_m, None, None, stopping.yaw_rad).moved(step_ned_m)


def press_down_target(previous: Target | None, vehicle: VehicleSnapshot) -> Target:
    """Keep the vehicle on the ground, or on the moving platform, until its motors stop."""
    vel = None if previous is None else previous.vel_ned_mps
    north_mps, east_mps, _ = vel or (0.0, 0.0, 0.0)
    return Target(None, (north_mps, east_mps, PRESS_DOWN_MPS), None, heading_rad(previous, vehicle))


def heading_rad(previous: Target | None, vehicle: VehicleSnapshot) -> float:
    """Heading of the previous target, else of the vehicle."""
    return vehicle.yaw_rad if previous is None else previous.yaw_rad


class AbortManeuver:
    """An aborted vehicle stays on the ground, climbs when it is near the ground, and else comes to rest.

    Attributes:
        on_ground: the vehicle was on the ground when the manoeuvre was planned.
    """

    def __init__(self) -> None:
        self.on_ground = False
        self._climbs = False

    def plan(self, previous: Target | None, vehicle: VehicleSnapshot) -> Target | None:
        """Target of the manoeuvre, None for no stream; in the air position and height must be known."""
        self.on_ground, self._climbs = vehicle.landed, False
        if vehicle.landed:
            return press_down_target(previous, vehicle) if vehicle.armed else None
        stopping = stopping_target(previous, vehicle)
        pos_ned_m, height_m = vehicle.pos_ned_m, vehicle.height_m
        if stopping.pos_ned_m is None or pos_ned_m is None or height_m is None or height_m >= LOW_HEIGHT_M:
            return stopping
        self._climbs = True
        north_m, east_m, _ = stopping.pos_ned_m
        return Target((north_m, east_m, pos_ned_m[2] - (CLIMB_HEIGHT_M - height_m)), None, None, stopping.yaw_rad)

    def is_done(self, vehicle: VehicleSnapshot, elapsed_s: float) -> bool:
        """Whether the vehicle is high enough, or has tried to climb until the time-out."""
        high = vehicle.height_m is None or vehicle.height_m >= CLIMB_HEIGHT_M - CLIMB_TOLERANCE_M
        return high or not self._climbs or elapsed_s >= CLIMB_TIMEOUT_S
