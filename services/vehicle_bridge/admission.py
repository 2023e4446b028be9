"""Admission of goals, setpoints and hovers, with the reason for each refusal. Source: spec §3, architecture §5."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import get_args

from jezero.frames import Vec3, altitude_m, horizontal
from jezero.schemas.commands import Acquire, Hover, Phase, Release, Setpoint
from jezero.schemas.preflight import Override
from jezero.schemas.state import STATUS_WORDS, StatusCode
from jezero.schemas.topics import ACTIONS
from jezero.services.vehicle_bridge.resets import ResetHistory
from jezero.services.vehicle_bridge.transitions import CODE_OF, is_allowed
from jezero.services.vehicle_bridge.vehicle import LINK_TIMEOUT_S, Target, VehicleSnapshot
from jezero.vehicle_config import VehicleConfig, VehicleLimitsConfig

OVERRIDABLE = frozenset(get_args(Override))
"""Names of the preflight checks that a takeoff may override."""
MAX_AGE_NS = 300_000_000
MAX_REQUEST_AGE_S = 1.0
"""Action servers wait this long for the reply to a request for control."""
MAX_LEAD_NS = 50_000_000
"""A setpoint may seem to come from the future by this much: clocks of two hosts are mapped, not shared."""

FORCE_FEET_MAX_M = 0.1
"""The motors are not stopped by force while the altimeter's tilt-corrected range means that the feet are higher."""


@dataclass
class Grant:
    """The right of one goal to fly.

    Attributes:
        control_id: identifies the grant in setpoints and in the release.
        goal_id: the goal that holds it.
        action: name of the goal's action.
        phases: phases that the goal may go through.
        timer_ns: time of the grant, then of the last accepted setpoint.
        sequence: sequence number of the last accepted setpoint, -1 before the first.
        paused: the goal is paused, by its last accepted setpoint.
        overriding: failed preflight checks that it overrides, for people; "" for none.
        refusal: reason why the last setpoint was dropped; "" for one that was accepted.
        is_late: the next setpoint is late, and the vehicle hovers until one comes.
        is_orphaned: the action's server has vanished since the grant.
    """

    control_id: str
    goal_id: str
    action: str
    phases: tuple[Phase, ...]
    timer_ns: int
    sequence: int = -1
    paused: bool = False
    overriding: str = ""
    refusal: str = ""
    is_late: bool = False
    is_orphaned: bool = False

    @property
    def name(self) -> str:
        """Name for people, e.g. "the goal go to"."""
        return f"the goal {in_words(self.action)}"

    def follow(self, setpoint: Setpoint, vehicle: VehicleSnapshot) -> str:
        """Note an accepted setpoint; returns the event of a pause or hover that begins or ends, for people, or ""."""
        changes = setpoint.paused is not self.paused or self.is_late
        self.sequence, self.timer_ns, self.paused = setpoint.sequence, vehicle.timer_ns, setpoint.paused
        self.refusal, self.is_late = "", False
        if not changes:
            return ""
        return f"{self.name} is paused" if self.paused else f"{self.name} goes on"


def in_words(name: str) -> str:
    """The name of an action or a phase for people, e.g. "land on spot"."""
    return name.replace("_", " ")


def status_words(code: StatusCode) -> str:
    """The status for people, as a clause."""
    return f"the vehicle {STATUS_WORDS[code]}"


def phase_of(action: str) -> Phase:
    """The main phase of an action; an action that jezero doesn't have is one of an installed package."""
    return ACTIONS[action].phase if action in ACTIONS else Phase.ACTION


def phases_of(action: str, code: StatusCode) -> tuple[Phase, ...]:
    """Phases that a goal accepted in this status may go through, in their order."""
    phase = phase_of(action)
    lifts_off_first = code is StatusCode.IDLE and phase is not Phase.TAKEOFF
    return (Phase.TAKEOFF, phase) if lifts_off_first else (phase,)


def acquire_refusal(
    request: Acquire, code: StatusCode, holder: Grant | None, text: str, vehicle: VehicleSnapshot
) -> str | None:
    """Reason why this goal may not fly now, with what to do instead; None when it may.

    Args:
        holder: grant of the goal in charge.
        text: the status' last event, which explains a status 13.
    """
    return next(_acquire_refusals(request, code, holder, text, vehicle), None)


def _acquire_refusals(
    request: Acquire, code: StatusCode, holder: Grant | None, text: str, vehicle: VehicleSnapshot
) -> Iterator[str]:
    status = status_words(code)
    phase = phase_of(request.action)
    if phase not in CODE_OF:
        yield f"the bridge doesn't know phase {str(phase)!r} of {request.action}: update the bridge"
        return
    age_s = 0.0 if request.issued_t_ns is None else (vehicle.t_ns - request.issued_t_ns) * 1e-9
    if age_s > MAX_REQUEST_AGE_S:
        yield f"the request is {age_s:.1f} s old: its sender has stopped waiting for the reply"
    if age_s < -MAX_REQUEST_AGE_S:
        yield f"the request is {-age_s:.1f} s ahead of vehicle time: it is from before the vehicle restarted"
    takes_off = phase is Phase.TAKEOFF
    moves = phase is Phase.GO_TO
    if holder is not None:
        yield f"{holder.name} is in charge: wait for it or abort it"
    if code is StatusCode.EXTERNAL:
        yield f"{status}: {text}. Wait until it is disarmed, or take control back with hover"
    if code not in (StatusCode.IDLE, StatusCode.HOVER):
        yield f"goals are accepted on the ground and in a hover only, and {status}: try again when that has changed"
    if code is StatusCode.HOVER and takes_off:
        yield f"a takeoff needs a vehicle on the ground, and {status}: it flies already"
    if code is StatusCode.HOVER and vehicle.telemetry_age_s > LINK_TIMEOUT_S:
        yield f"the autopilot's telemetry has been missing for {vehicle.telemetry_age_s:.1f} s: wait for it"
    if code is StatusCode.IDLE and not takes_off and not (moves and request.do_takeoff):
        hint = ", or let the goal begin with a takeoff" if moves else ""
        yield f"{in_words(request.action)} needs a hovering vehicle, and {status}: take off first{hint}"
    if code is StatusCode.IDLE and vehicle.not_ready_reason:
        yield f"not ready to take off: {vehicle.not_ready_reason}"
    if code is StatusCode.IDLE and (failed := _checks_in_words(request, vehicle, overridden=False)):
        advice = ""
        if all(check.name in OVERRIDABLE for check in vehicle.failed_checks):
            advice = (
                ". To take off in spite of it, put the names of the checks into the goal's field override: jezero "
                "takeoff --override NAME"
            )
        yield f"preflight checks have failed: {failed}. Put it right; jezero preflight checks again{advice}"


def overriding(request: Acquire, code: StatusCode, vehicle: VehicleSnapshot) -> str:
    """Failed preflight checks that a goal on the ground overrides, for people; "" for none."""
    failed = _checks_in_words(request, vehicle, overridden=True) if code is StatusCode.IDLE else ""
    return f"takes off in spite of failed preflight checks: {failed}" if failed else ""


def _checks_in_words(request: Acquire, vehicle: VehicleSnapshot, *, overridden: bool) -> str:
    """Failed preflight checks that the request overrides, or those that it doesn't."""
    checks = [check for check in vehicle.failed_checks if (check.name in request.override) is overridden]
    return "; ".join(f"{check.name}: {check.text}" for check in checks)


def setpoint_refusal(
    setpoint: Setpoint, code: StatusCode, holder: Grant | None, vehicle: VehicleSnapshot, resets: ResetHistory
) -> str | None:
    """Reason why this setpoint is dropped, None when it is flown."""
    age_ns, phase, pos_ned_m = vehicle.t_ns - setpoint.t_ns, setpoint.phase, setpoint.pos_ned_m
    next_code, counter = CODE_OF.get(phase), setpoint.reset_counter
    if holder is None or setpoint.control_id != holder.control_id:
        return "its control is not in charge"
    refusal = None
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
    zero = (0.0, 0.0, 0.0)
    x, y, z = setpoint.pos_ned_m or zero
    vx, vy, vz = setpoint.vel_ned_mps or zero
    ax, ay, az = setpoint.acc_ned_mps2 or zero
    turn = (setpoint.yaw_rad or 0.0) + (setpoint.yaw_rate_rps or 0.0)
    return isfinite(x + y + z + vx + vy + vz + ax + ay + az + turn)


def hover_refusal(
    request: Hover, code: StatusCode, text: str, killing: bool, vehicle: VehicleSnapshot, limits: VehicleLimitsConfig
) -> str | None:
    """Reason why the bridge doesn't hover as requested; None when it does, or takes control back in order to.

    Args:
        text: the status' last event, which explains a status 13.
        killing: the motors are being cut.
    """
    return next(_hover_refusals(request, code, text, killing, vehicle, limits), None)


def force_disarm_refusal(vehicle: VehicleSnapshot, robot: VehicleConfig) -> str | None:
    """Reason why a landing's end may not stop the motors by force, None when it may."""
    range_max_m = robot.height_altimeter_m + FORCE_FEET_MAX_M
    if vehicle.range_m is None or vehicle.range_m <= range_max_m:
        return None
    return f"not disarmed by force: the altimeter measures {vehicle.range_m:.2f} m, {range_max_m:.2g} m is the limit"


def release_refusal(request: Release, code: StatusCode, vehicle: VehicleSnapshot, robot: VehicleConfig) -> str | None:
    """Reason why a goal that succeeded may not end so, None when it may."""
    if (code is StatusCode.LANDING) != (request.then != "hover"):
        return "a landing that succeeded ends with then=disarm, and nothing else does"
    return force_disarm_refusal(vehicle, robot) if request.then == "force_disarm" else None


def _hover_refusals(
    request: Hover, code: StatusCode, text: str, killing: bool, vehicle: VehicleSnapshot, limits: VehicleLimitsConfig
) -> Iterator[str]:
    status, age_s = status_words(code), vehicle.telemetry_age_s
    if not request.hover_req:
        yield "hover_req is false: a goal in charge ends a hover, nothing else does"
    if request.hover_pos is not None and code is not StatusCode.HOVER:
        yield f"a hover point can be given only while hovering, and {status}"
    if code is StatusCode.IDLE and vehicle.armed is None:
        yield f"the autopilot has not reported the vehicle's state yet: {vehicle.not_ready_reason}"
    if code is StatusCode.IDLE:
        yield "the vehicle stands on the ground: take off first"
    if code is StatusCode.LANDING_DONE or (code is StatusCode.ABORT and vehicle.landed):
        yield "the vehicle stands on the ground and is being disarmed"
    if code is StatusCode.EXTERNAL and (killing or not vehicle.armed or vehicle.landed):
        yield f"control can be taken back in the air only, and {status}: {text}"
    if code is StatusCode.EXTERNAL and (age_s > LINK_TIMEOUT_S or vehicle.pos_ned_m is None):
        yield f"control can't be taken back without telemetry, which has been missing for {age_s:.1f} s"
    if request.hover_pos is not None:
        yield from _point_refusals(request.hover_pos, limits)


def _point_refusals(pos_ned_m: Vec3, limits: VehicleLimitsConfig) -> Iterator[str]:
    z_m = pos_ned_m[2]
    if not all(isfinite(x) for x in pos_ned_m):
        yield f"{pos_ned_m} is not a point"
    if z_m >= 0.0:
        yield f"z = {z_m:g} is not above the ground: z points down, 5 m up is −5"
    elif altitude_m(z_m) < limits.altitude_min_m:
        yield f"z = {z_m:g} is {altitude_m(z_m):g} m up, below the limit of {limits.altitude_min_m:g} m"
    yield from _limit_refusals(pos_ned_m, limits)


def _limit_refusals(pos_ned_m: Vec3, limits: VehicleLimitsConfig) -> Iterator[str]:
    z_m, distance_m = pos_ned_m[2], horizontal(pos_ned_m)
    if altitude_m(z_m) > limits.altitude_max_m:
        yield f"{altitude_m(z_m):g} m up is above the limit of {limits.altitude_max_m:g} m"
    if distance_m > limits.distance_max_m:
        yield f"{distance_m:.0f} m away is beyond the limit of {limits.distance_max_m:g} m"


def leaves_limits(before: Target, after: Target, limits: VehicleLimitsConfig) -> bool:
    """Whether a target's point, if it has one, moves from within the limits to beyond them."""
    return not _is_beyond(before, limits) and _is_beyond(after, limits)


def _is_beyond(target: Target, limits: VehicleLimitsConfig) -> bool:
    return target.pos_ned_m is not None and any(_limit_refusals(target.pos_ned_m, limits))
