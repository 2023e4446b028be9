"""State machine that decides who controls the vehicle and what is commanded. Source: spec §3, architecture §5.

Inputs are requests, setpoints and a `VehicleSnapshot` per step; outputs are `code`, `target` and `command`.
"""

from collections.abc import Collection

from jezero.frames import Vec3
from jezero.schemas.commands import Acquire, Hover, Release, Setpoint
from jezero.schemas.state import InCharge, StatusCode
from jezero.services.vehicle_bridge import admission, targets
from jezero.services.vehicle_bridge.abort_maneuver import AbortManeuver
from jezero.services.vehicle_bridge.admission import Grant
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.disarming import Disarming
from jezero.services.vehicle_bridge.engagement import EngagementTimer
from jezero.services.vehicle_bridge.fence import FenceKeeper
from jezero.services.vehicle_bridge.flight_monitor import FlightMonitor
from jezero.services.vehicle_bridge.grants import Grants
from jezero.services.vehicle_bridge.resets import ResetHistory
from jezero.services.vehicle_bridge.takeover_detector import TakeoverDetector
from jezero.services.vehicle_bridge.transitions import CODE_OF, IN_PROGRESS, REPORT_MIN_S, completed, require
from jezero.services.vehicle_bridge.unarmable_mode import UnarmableModeDetector
from jezero.services.vehicle_bridge.vehicle import LAND, OFFBOARD, Command, ControlState, Target, VehicleSnapshot
from jezero.vehicle_config import VehicleConfig


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
        self.command: Command | None = None
        self.taking_back = self.killing = False
        self.changes: list[ControlState] = []
        self.interventions = 0
        self._robot = robot
        self._fence = fence
        self._grants = Grants(secret)
        self._external_holder: InCharge = "failsafe"
        self._takeover = TakeoverDetector()
        self._unarmable_mode = UnarmableModeDetector()
        self._monitor = FlightMonitor(config)
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
        return self._external_holder if self.code is StatusCode.EXTERNAL else self._grants.in_charge(self.code)

    @property
    def control_state(self) -> ControlState:
        return self._grants.control_state(self.code, self.in_charge, self.interventions, self.text)

    # -- requests and setpoints --------------------------------------------------------------------------

    def acquire(self, request: Acquire, vehicle: VehicleSnapshot) -> str | None:
        """Give control to a goal; returns the reason for a refusal, or None with the new `grant`."""
        refusal = self._grants.acquire(request, self.code, self.text, vehicle)
        if self.grant is not None and not refusal and not request.check_only:
            self.text = f"{self.grant.name} is in charge"
        return refusal

    def accept(self, setpoint: Setpoint, vehicle: VehicleSnapshot, resets: ResetHistory) -> str | None:
        """Make a setpoint the new target; returns the reason for a refusal, or None."""
        grant, code = self.grant, CODE_OF.get(setpoint.phase)
        refusal = admission.setpoint_refusal(setpoint, self.code, grant, vehicle, resets)
        if refusal or grant is None or code is None:
            if refusal and grant is not None and setpoint.control_id == grant.control_id:
                grant.refusal = refusal
            return refusal
        self.target = targets.setpoint_target(setpoint, self.target, vehicle, resets)
        if grant.sequence < 0:
            self._grants.history.add_flown(grant.goal_id)
        self.text = grant.follow(setpoint, vehicle) or self.text
        if code is not self.code:
            if self.code is StatusCode.IDLE:
                self._engagement.start(vehicle)
            because = f"; {grant.overriding}" if grant.overriding else ""
            takes_off_first = code is StatusCode.TAKEOFF and grant.action != setpoint.phase
            self.text = f"{grant.name} {'begins with a takeoff' if takes_off_first else 'has begun'}{because}"
            self._set_code(code, vehicle)
        return None

    def release(self, request: Release, vehicle: VehicleSnapshot, resets: ResetHistory) -> str | None:
        """Take a goal's control; returns the reason for a refusal, or None. It is done when the status is 3 or 0."""
        grant = self.grant
        if grant is None or grant.control_id != request.control_id:
            return self._grants.history.end_reason(request.control_id)
        if request.outcome != "succeeded" or self.code not in IN_PROGRESS:
            because = f": {request.reason}" if request.reason else ""
            self._revoke(f"{grant.name} {request.outcome}{because}", vehicle, released=True)
        elif not self._engaged:
            self._revoke(f"{grant.name} ended before the vehicle was armed in offboard mode", vehicle, released=True)
        elif refusal := admission.release_refusal(request, self.code, vehicle, self._robot):
            return refusal
        else:
            self._disarming.by_force = request.then == "force_disarm"
            forced = ", disarming by force: the autopilot doesn't detect the ground" if self._disarming.by_force else ""
            self._end_grant(f"{grant.name} succeeded{forced}", released=True)
            if self.code is StatusCode.LANDING:
                self.target = targets.press_down_target(self.target, vehicle)
            else:
                self.target = targets.released_target(request, targets.stopping_target(self.target, vehicle), resets)
            self._set_code(completed(self.code), vehicle)
        return None

    def hover(self, request: Hover, vehicle: VehicleSnapshot) -> str | None:
        """Hover here or at a point; returns the reason for a refusal, or None. It is done when the status is 3."""
        refusal = admission.hover_refusal(request, self.code, self.text, self.killing, vehicle, self._robot.limits)
        if refusal := refusal or self._fence.point_refusal(request.hover_pos):
            return refusal
        self.interventions += 1
        if self.code is StatusCode.EXTERNAL:
            self._begin_taking_back(vehicle)
            return None
        if self.grant is not None:
            self._revoke(f"{self.grant.name} ended: hover was requested", vehicle)
        if self.code is StatusCode.HOVER:
            self.target, self.text = targets.hover_target(request, targets.stopping_target(self.target, vehicle))
        return None

    def _begin_taking_back(self, vehicle: VehicleSnapshot) -> None:
        if not self.taking_back:
            self.taking_back = True
            self._land_commanded = False
            self._engagement.start(vehicle)
            self.target = targets.stopping_target(self.target, vehicle)
            self.text = "taking control back"

    def abort(self, reason: str, vehicle: VehicleSnapshot) -> str:
        """End the goal in charge and all goals that wait for control; returns the event, for people."""
        self._grants.history.last_abort_ns = max(0, vehicle.t_ns)
        self.interventions += 1
        if self.grant is None:
            return f"no goal was in charge, {admission.status_words(self.code)}"
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
        self._grants.history.last_abort_ns = None
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
        if hovers and admission.leaves_limits(before, self.target, self._robot.limits):
            self.target = targets.stopping_target(self.target, vehicle)
            self.text = "the autopilot corrected its position, and the hover point is beyond the limits: hovering here"

    def update(self, vehicle: VehicleSnapshot, departed: Collection[str] = ()) -> None:
        """Judge safety and time-outs once in each step, after all requests; `departed` are services that vanished."""
        arm_commanded = self._arm_pending
        if vehicle.armed or vehicle.acknowledged in (Command.DISARM, Command.FORCE_DISARM):
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
            self.text, self.target = late, targets.stopping_target(self.target, vehicle)
        self.command = self._advance(vehicle)
        self._arm_pending |= self.command is Command.ARM
        self.streamed = self._fence.limited(self.target, vehicle, self.code)

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
            doing = admission.status_words(self.code)
            self._lose_control("failsafe", f"the autopilot disarmed while {doing}{because}", vehicle)

    def _advance(self, vehicle: VehicleSnapshot) -> Command | None:
        """Change the code where time or the vehicle's state says so; returns the command to the autopilot."""
        code = self.code
        if code is StatusCode.EXTERNAL:
            return self._advance_external(vehicle)
        if code is StatusCode.IDLE:
            return Command.HOLD if self._unarmable_mode.update(vehicle) else None
        if code in IN_PROGRESS:
            return self._engage(vehicle)
        if code is StatusCode.ABORT:
            return self._advance_abort(vehicle)
        if code is StatusCode.LANDING_DONE:
            return self._disarm(vehicle)
        if code is not StatusCode.HOVER and self._code_age_s(vehicle) >= REPORT_MIN_S:
            self._set_code(StatusCode.HOVER, vehicle)
        elif self.grant is None and (point := self._fence.return_point(self.target, vehicle)):
            self.target = Target(point, None, None, targets.heading_rad(self.target, vehicle))
            self.text += "; it returns inside the fence"
        return None

    def _engage(self, vehicle: VehicleSnapshot) -> Command | None:
        if self._engaged or self.grant is None or self.grant.is_late:
            return None
        if vehicle.armed and vehicle.mode == OFFBOARD:
            self._engaged = True
        elif self._engagement.is_overdue(vehicle):
            self._revoke(f"{self.grant.name} ended: could not arm in offboard mode: {vehicle.failure_reason}", vehicle)
        elif self._engagement.may_command(vehicle) and vehicle.mode == OFFBOARD:
            return Command.ARM
        elif self._engagement.may_command(vehicle) and not self._takeover.was_offboard:
            return Command.OFFBOARD
        return None

    def _advance_abort(self, vehicle: VehicleSnapshot) -> Command | None:
        if vehicle.landed is not self._abort_maneuver.on_ground and not self._plan_abort(vehicle):
            return None
        if self._abort_maneuver.on_ground:
            return self._disarm(vehicle)
        elapsed_s = self._code_age_s(vehicle)
        if elapsed_s >= REPORT_MIN_S and self._abort_maneuver.is_done(vehicle, elapsed_s):
            self._set_code(StatusCode.HOVER, vehicle)
        return None

    def _disarm(self, vehicle: VehicleSnapshot) -> Command | None:
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

    def _advance_external(self, vehicle: VehicleSnapshot) -> Command | None:
        if self.killing:
            self.killing = vehicle.armed is not False or self._arm_pending
            return Command.FORCE_DISARM if self.killing else None
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
        if handover is not None and not self._land_commanded:
            self._external_holder, self.text = handover
        self._land_commanded &= vehicle.mode != LAND
        return Command.LAND if self._land_commanded else None

    def _advance_taking_back(self, vehicle: VehicleSnapshot) -> Command | None:
        if self._engagement.is_overdue(vehicle):
            self.taking_back = False
            self.target = None
            self.text = f"control could not be taken back: {vehicle.failure_reason}"
        elif self._engagement.may_command(vehicle) and vehicle.mode != OFFBOARD:
            return Command.OFFBOARD
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
        self._grants.end(None if released else text)
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
