"""What is let in: goals, setpoints and hovers, and the reason when they are not. Source: spec §3, architecture §5."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

from jezero.frames import Vec3, altitude_m, horizontal
from jezero.schemas.commands import Acquire, Hover, Phase, Setpoint
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ACTIONS
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.resets import ResetHistory
from jezero.services.vehicle_bridge.transitions import CODE_OF, is_allowed
from jezero.services.vehicle_bridge.vehicle import Situation, Target

MAX_AGE_NS = 300_000_000
MAX_REQUEST_AGE_S = 1.0
"""Action servers wait so long for the answer to a request for control."""
MAX_LEAD_NS = 50_000_000
"""A setpoint may seem to come from the future by this much: clocks of two hosts are mapped, not shared."""


@dataclass
class Grant:
    """Leave to fly, of one goal.

    Attributes:
        phases: those that this goal may go through.
        timer_ns: when it was granted, then of its last accepted setpoint.
        sequence: of its last accepted setpoint, -1 before the first.
    """

    control_id: str
    goal_id: str
    action: str
    phases: tuple[Phase, ...]
    timer_ns: int
    sequence: int = -1

    @property
    def name(self) -> str:
        """For people, e.g. "go_to g-17"; servers' own ids begin with the action."""
        return self.goal_id if self.goal_id.startswith(self.action) else f"{self.action} {self.goal_id}"


def in_words(code: StatusCode) -> str:
    return f"the status is {int(code)} ({code.name})"


def phases_of(action: str, code: StatusCode) -> tuple[Phase, ...]:
    """The phases that a goal accepted in this status may go through, in their order; none for an unknown action."""
    if action not in ACTIONS:
        return ()
    phase = ACTIONS[action].phase
    lifts_off_first = code is StatusCode.IDLE and phase is not Phase.TAKEOFF
    return (Phase.TAKEOFF, phase) if lifts_off_first else (phase,)


def why_not_acquire(
    request: Acquire, code: StatusCode, holder: Grant | None, text: str, now: Situation, link_timeout_s: float
) -> str:
    """Why this goal may not fly now, with what to do instead; "" when it may.

    Args:
        holder: of the control now.
        text: the status' last event, which explains a status 13.
    """
    return next(_acquire_refusals(request, code, holder, text, now, link_timeout_s), "")


def _acquire_refusals(
    request: Acquire, code: StatusCode, holder: Grant | None, text: str, now: Situation, link_timeout_s: float
) -> Iterator[str]:
    status = in_words(code)
    action = ACTIONS.get(request.action)
    if action is None:
        yield f"there is no action {request.action!r}; there are {', '.join(ACTIONS)}"
        return
    if action.phase not in CODE_OF:
        yield f"the bridge doesn't know phase {str(action.phase)!r} of {request.action}: update the bridge"
        return
    age_s = 0.0 if request.issued_t_ns is None else (now.t_ns - request.issued_t_ns) * 1e-9
    if age_s > MAX_REQUEST_AGE_S:
        yield f"asked {age_s:.1f} s ago: nobody waits for the answer any more"
    if age_s < -MAX_REQUEST_AGE_S:
        yield f"asked {-age_s:.1f} s ahead of vehicle time: before the vehicle restarted"
    takes_off = action.phase is Phase.TAKEOFF
    moves = action.phase is Phase.GO_TO
    if holder is not None:
        yield f"{holder.name} is in charge, {status}: wait for it or abort it"
    if code is StatusCode.EXTERNAL:
        yield f"{status}: {text}. Wait until it is disarmed, or take control back with hover"
    if code not in (StatusCode.IDLE, StatusCode.HOVER):
        yield f"goals are accepted in 0 (IDLE) and 3 (HOVER) only, {status}: try again when it has changed"
    if code is StatusCode.HOVER and takes_off:
        yield f"takeoff needs a vehicle on the ground (0), {status}: it flies already"
    if code is StatusCode.HOVER and now.silent_s > link_timeout_s:
        yield f"the autopilot's telemetry has been missing for {now.silent_s:.1f} s, {status}: wait for it"
    if code is StatusCode.IDLE and not takes_off and not (moves and request.do_takeoff):
        hint = ", or set do_takeoff" if moves else ""
        yield f"{request.action} needs a hovering vehicle (3), {status}: take off first{hint}"
    if code is StatusCode.IDLE and now.not_ready:
        yield f"not ready to take off: {now.not_ready}"


def why_not_setpoint(
    setpoint: Setpoint, code: StatusCode, holder: Grant | None, now: Situation, resets: ResetHistory
) -> str:
    """Why this setpoint is dropped; "" when it is flown."""
    age_ns, phase, pos_ned_m = now.t_ns - setpoint.t_ns, setpoint.phase, setpoint.pos_ned_m
    after, counter = CODE_OF.get(phase), setpoint.reset_counter
    if holder is None or setpoint.control_id != holder.control_id:
        return f"control {setpoint.control_id} is not in charge"
    why = ""
    if setpoint.sequence <= holder.sequence:
        why = f"sequence {setpoint.sequence} after {holder.sequence}"
    elif not -MAX_LEAD_NS <= age_ns <= MAX_AGE_NS:
        why = f"{age_ns * 1e-9:.3f} s old; accepted are {-MAX_LEAD_NS * 1e-9:g} to {MAX_AGE_NS * 1e-9:g} s"
    elif after is None or phase not in holder.phases or (after is not code and not is_allowed(code, after)):
        why = f"phase {phase} of {holder.action} in status {code.name}"
    elif pos_ned_m is None and setpoint.vel_ned_mps is None:
        why = "neither a position nor a velocity"
    elif pos_ned_m is not None and counter != resets.counter and resets.step_since(counter) is None:
        why = f"reset counter {counter} is unknown; the present one is {resets.counter}"
    elif not _is_finite(setpoint):
        why = "a number that is not finite"
    return why


def _is_finite(setpoint: Setpoint) -> bool:
    still = (0.0, 0.0, 0.0)
    x, y, z = setpoint.pos_ned_m or still
    vx, vy, vz = setpoint.vel_ned_mps or still
    ax, ay, az = setpoint.acc_ned_mps2 or still
    turn = (setpoint.yaw_rad or 0.0) + (setpoint.yaw_rate_rps or 0.0)
    return isfinite(x + y + z + vx + vy + vz + ax + ay + az + turn)


def why_not_hover(
    request: Hover, code: StatusCode, text: str, killing: bool, now: Situation, config: VehicleBridgeConfig
) -> str:
    """Why the bridge doesn't hover as asked; "" when it does, or takes control back in order to.

    Args:
        text: the status' last event, which explains a status 13.
        killing: the motors are being cut.
    """
    return next(_hover_refusals(request, code, text, killing, now, config), "")


def why_not_force(now: Situation, config: VehicleBridgeConfig) -> str:
    """Why the motors aren't stopped by force at the end of a landing, whatever its goal says; "" when they are."""
    limit_m = config.range_force_max_m
    if now.range_m is None or now.range_m <= limit_m:
        return ""
    return f"not disarmed by force: the altimeter measures {now.range_m:.2f} m, {limit_m:g} m is the limit"


def _hover_refusals(
    request: Hover, code: StatusCode, text: str, killing: bool, now: Situation, config: VehicleBridgeConfig
) -> Iterator[str]:
    status = in_words(code)
    if not request.hover_req:
        yield "hover_req is false: a goal in charge ends a hover, nothing else does"
    if request.hover_pos is not None and code is not StatusCode.HOVER:
        yield f"a hover point can be given only while hovering (3), {status}"
    if code is StatusCode.IDLE and now.armed is None:
        yield f"the autopilot has not told yet what the vehicle does: {now.not_ready}"
    if code is StatusCode.IDLE:
        yield f"the vehicle stands on the ground, {status}: take off first"
    if code is StatusCode.LANDING_DONE or (code is StatusCode.ABORT and now.landed):
        yield f"the vehicle stands on the ground and is being disarmed, {status}"
    if code is StatusCode.EXTERNAL and (killing or not now.armed or now.landed):
        yield f"control can be taken back in the air only, {status}: {text}"
    if code is StatusCode.EXTERNAL and (now.silent_s > config.link_timeout_s or now.pos_ned_m is None):
        yield f"control can't be taken back without telemetry, missing for {now.silent_s:.1f} s, {status}"
    if request.hover_pos is not None:
        yield from _broken_limits(request.hover_pos, config)


def _broken_limits(pos_ned_m: Vec3, config: VehicleBridgeConfig) -> Iterator[str]:
    z_m = pos_ned_m[2]
    if not all(isfinite(x) for x in pos_ned_m):
        yield f"{pos_ned_m} is not a point"
    if z_m >= 0.0:
        yield f"z = {z_m:g} is not above the ground: z points down, 5 m up is −5"
    yield from _too_far(pos_ned_m, config)


def _too_far(pos_ned_m: Vec3, config: VehicleBridgeConfig) -> Iterator[str]:
    z_m, distance_m = pos_ned_m[2], horizontal(pos_ned_m)
    if altitude_m(z_m) > config.altitude_limit_m:
        yield f"{altitude_m(z_m):g} m up is above the limit of {config.altitude_limit_m:g} m"
    if distance_m > config.distance_limit_m:
        yield f"{distance_m:.0f} m away is beyond the limit of {config.distance_limit_m:g} m"


def is_within_limits(target: Target, config: VehicleBridgeConfig) -> bool:
    """Whether a target's point, if it has one, is neither too high nor too far away."""
    return target.pos_ned_m is None or next(_too_far(target.pos_ned_m, config), None) is None
