"""Admission: which status may follow which, which goal gets control, and why others don't. Source: spec §3,
architecture §5."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from math import isfinite
from typing import get_args

from jezero.base.frames import Vec3, altitude_m, horizontal
from jezero.base.vehicle_config import VehicleConfig, VehicleLimitsConfig
from jezero.schemas.commands import Acquire, Hover, Phase, Release, Setpoint
from jezero.schemas.preflight import Override
from jezero.schemas.rows import FLYING_ODOMETRY_MIN_HZ
from jezero.schemas.state import STATUS_WORDS
from jezero.schemas.state import StatusCode as Code
from jezero.schemas.topics import ACTIONS, RETURN_HOME
from jezero.services.vehicle_bridge.narrow_line import rate_refusal
from jezero.services.vehicle_bridge.vehicle import LINK_TIMEOUT_S, Target, VehicleSnapshot

OVERRIDABLE = frozenset(get_args(Override))
"""Names of the preflight checks that a takeoff may override."""
MAX_REQUEST_AGE_S = 1.0
"""Action servers wait this long for the reply to a request for control."""
FORCE_FEET_MAX_M = 0.1
"""The motors are not stopped by force while the altimeter's tilt-corrected range means that the feet are higher."""
UNUSED_TIMEOUT_S = 0.5
"""A grant ends when its goal has sent no setpoint within this time: the reply may have been lost."""
LATE_S = 0.35
"""When a goal has sent no further setpoint for this time the bridge stops the vehicle, within 0.5 s in all: the
autopilot would go on with the last velocity. Source: architecture §5. When the action's server has vanished, the grant
ends after this time."""
SILENT_MAX_S = 1.0
"""A grant ends when its goal sends no setpoint for this time. A server that a busy machine holds up for a moment sends
the next one before."""
ENDED_MAX = 32
FLOWN_MAX = 100
"""Number of ended grants, and of goals that have flown, that are remembered."""


def in_words(name: str) -> str:
    """The name of an action or a phase for people, e.g. "land on spot"."""
    return name.replace("_", " ")


def status_words(code: Code) -> str:
    """The status for people, as a clause."""
    return f"the vehicle {STATUS_WORDS[code]}"


# -- transitions between status codes --------------------------------------------------------------------

REPORT_MIN_S = 0.1
"""A code that only reports an event lasts at least this long, so that every subscriber gets it."""
AFTER: dict[Code, tuple[Code, ...]] = {
    Code.IDLE: (Code.TAKEOFF, Code.EXTERNAL),
    Code.TAKEOFF: (Code.TAKEOFF_DONE, Code.GO_TO, Code.ABORT, Code.EXTERNAL),
    Code.TAKEOFF_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.HOVER: (Code.GO_TO, Code.GET_IMAGES, Code.LANDING, Code.COVERAGE, Code.ACTION, Code.EXTERNAL),
    Code.GO_TO: (Code.GO_TO_DONE, Code.ABORT, Code.EXTERNAL),
    Code.GO_TO_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.GET_IMAGES: (Code.GET_IMAGES_DONE, Code.ABORT, Code.EXTERNAL),
    Code.GET_IMAGES_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.LANDING: (Code.LANDING_DONE, Code.ABORT, Code.EXTERNAL),
    Code.LANDING_DONE: (Code.IDLE, Code.EXTERNAL),
    Code.COVERAGE: (Code.COVERAGE_DONE, Code.ABORT, Code.EXTERNAL),
    Code.COVERAGE_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.ACTION: (Code.ACTION_DONE, Code.ABORT, Code.EXTERNAL),
    Code.ACTION_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.ABORT: (Code.HOVER, Code.IDLE, Code.EXTERNAL),
    Code.EXTERNAL: (Code.IDLE, Code.HOVER),
}

CODE_OF: dict[Phase, Code] = {
    Phase.TAKEOFF: Code.TAKEOFF,
    Phase.GO_TO: Code.GO_TO,
    Phase.GET_IMAGES: Code.GET_IMAGES,
    Phase.LANDING: Code.LANDING,
    Phase.COVERAGE: Code.COVERAGE,
    Phase.ACTION: Code.ACTION,
}
"""Code while a goal is in a phase; the next integer means that the phase is completed."""

IN_PROGRESS: tuple[Code, ...] = tuple(CODE_OF.values())


class TransitionError(RuntimeError):
    """A transition that the table doesn't allow: a bug."""


def is_allowed(before: Code, after: Code) -> bool:
    """Whether `after` may directly follow `before`; a code never follows itself."""
    return after in AFTER[before]


def require(before: Code, after: Code) -> None:
    """Raise TransitionError unless `after` may directly follow `before`."""
    if not is_allowed(before, after):
        raise TransitionError(f"{before.name} to {after.name}")


def completed(code: Code) -> Code:
    """Code of a completed phase, from the code of the phase in progress (one of `IN_PROGRESS`)."""
    return Code(code + 1)


# -- grants ----------------------------------------------------------------------------------------------


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


class Grants:
    """The grant of the goal in charge, and the goals that had one before.

    No goal flies twice or after a later abort, and each owner gets the reason why its control ended.

    Attributes:
        present: grant of the goal in charge, or None.
        count: number of grants in this run of the bridge.
        last_abort_ns: vehicle time of the last abort, None before the first.
    """

    def __init__(self, secret: str) -> None:
        self.present: Grant | None = None
        self.count = 0
        self.last_abort_ns: int | None = None
        self._secret = secret
        self._end_reasons: dict[str, str] = {}
        """Reason why control ended, by control id; "" where its owner released it."""
        self._flown: dict[str, None] = {}
        """Ids of goals that have sent a setpoint, oldest first."""

    def acquire(self, request: Acquire, code: Code, text: str, vehicle: VehicleSnapshot) -> str:
        """Give control to a goal; returns the reason for a refusal, or "" with a new `present`.

        A request that only checks changes nothing.

        Args:
            text: the status' last event, which explains a status 13.
        """
        holder = self.present
        if holder is not None and holder.sequence < 0 and holder.goal_id == request.goal_id:
            return ""  # the same request again, because its reply was lost
        refusal = self._repeat_refusal(request, vehicle) or acquire_refusal(request, code, holder, text, vehicle)
        if refusal or request.check_only:
            return refusal
        self.count += 1
        self.present = Grant(
            control_id=f"{self._secret}-{self.count}",
            goal_id=request.goal_id,
            action=request.action,
            phases=_phases_of(request.action, code),
            timer_ns=vehicle.timer_ns,
            overriding=_overriding(request, code, vehicle),
        )
        return ""

    def _repeat_refusal(self, request: Acquire, vehicle: VehicleSnapshot) -> str:
        """Reason why this goal may not have control any more, or ""."""
        goal_id = request.goal_id
        if goal_id in self._flown:
            return "this goal has flown already, and a goal runs once: send it with a new id"
        if request.goal_issued_t_ns is not None and request.goal_issued_t_ns < vehicle.started_ns:
            return "this goal is from before the bridge started and may have flown: send it with a new id"
        if request.goal_t_ns is not None and self.last_abort_ns is not None and request.goal_t_ns <= self.last_abort_ns:
            return "this goal came before the last abort: send it again"
        return ""

    def add_flown(self, goal_id: str) -> None:
        """Remember a goal that flies: a restarted action server doesn't, and clients may send theirs again."""
        if goal_id not in self._flown:
            self._flown[goal_id] = None
            if len(self._flown) > FLOWN_MAX:
                del self._flown[next(iter(self._flown))]

    def silence(self, vehicle: VehicleSnapshot, departed: Collection[str]) -> tuple[str, str]:
        """Judge for how long the goal in charge has sent no setpoint that could be flown.

        Args:
            departed: names of the services that vanished since the last step.

        Returns:
            The reason why the present grant ends, and the event when its goal becomes late; "" for none.
        """
        grant = self.present
        if grant is None:
            return "", ""
        grant.is_orphaned |= grant.action in departed
        age_s = (vehicle.timer_ns - grant.timer_ns) * 1e-9
        if age_s <= (UNUSED_TIMEOUT_S if grant.sequence < 0 else LATE_S):
            return "", ""
        because = f"it sent no setpoint for {age_s:.2f} s"
        if grant.refusal:
            because = f"none of its setpoints could be flown for {age_s:.2f} s: {grant.refusal}"
        if grant.sequence < 0 or grant.is_orphaned or age_s > SILENT_MAX_S:
            return f"{grant.name} ended: {because}", ""
        if grant.is_late:
            return "", ""
        grant.is_late = True
        return "", f"hovering until {grant.name} goes on: {because}"

    def end(self, reason: str) -> None:
        """End the present grant, if there is one; `reason` is "" when its owner releases it."""
        if self.present is not None:
            self._end_reasons[self.present.control_id] = reason
            if len(self._end_reasons) > ENDED_MAX:
                del self._end_reasons[next(iter(self._end_reasons))]
        self.present = None

    def end_reason(self, control_id: str) -> str:
        """Reason why control ended, or "" where its owner released it."""
        return self._end_reasons.get(control_id, "this control was never given")


# -- refusals of goals -----------------------------------------------------------------------------------


def acquire_refusal(request: Acquire, code: Code, holder: Grant | None, text: str, vehicle: VehicleSnapshot) -> str:
    """Reason why this goal may not fly now, with what to do instead, or "".

    Args:
        holder: grant of the goal in charge.
        text: the status' last event, which explains a status 13.
    """
    return next(_acquire_refusals(request, code, holder, text, vehicle), "")


def _acquire_refusals(
    request: Acquire, code: Code, holder: Grant | None, text: str, vehicle: VehicleSnapshot
) -> Iterator[str]:
    status = status_words(code)
    phase = _phase_of(request.action)
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
    if code is Code.EXTERNAL:
        yield f"{status}: {text}. Wait until it is disarmed, or take control back with hover"
    if code not in (Code.IDLE, Code.HOVER):
        yield f"goals are accepted on the ground and in a hover only, and {status}: try again when that has changed"
    if code is Code.HOVER and takes_off:
        yield f"a takeoff needs a vehicle on the ground, and {status}: it flies already"
    if code is Code.HOVER and vehicle.telemetry_age_s > LINK_TIMEOUT_S:
        yield f"the autopilot's telemetry has been missing for {vehicle.telemetry_age_s:.1f} s: wait for it"
    yield from _rate_refusals(request.action, code, vehicle)
    if code is Code.IDLE and not takes_off and not (moves and request.do_takeoff):
        hint = ", or let the goal begin with a takeoff" if moves else ""
        yield f"{in_words(request.action)} needs a hovering vehicle, and {status}: take off first{hint}"
    if code is Code.IDLE and vehicle.not_ready_reason:
        yield f"not ready to take off: {vehicle.not_ready_reason}"
    if code is Code.IDLE and (failed := _checks_in_words(request, vehicle, overridden=False)):
        advice = ""
        if all(check.name in OVERRIDABLE for check in vehicle.failed_checks):
            advice = (
                ". To take off in spite of it, put the names of the checks into the goal's field override: jezero "
                "takeoff --override NAME"
            )
        yield f"preflight checks have failed: {failed}. Put it right; jezero preflight checks again{advice}"


def _rate_refusals(action: str, code: Code, vehicle: VehicleSnapshot) -> Iterator[str]:
    """Why odometry comes too rarely for an action; a vehicle in the air has a way down all the same."""
    if reason := rate_refusal(vehicle.odometry_hz, odometry_min_hz(action), in_words(action), vehicle.line):
        way_down = f". jezero return lands with {RETURN_HOME.odometry_min_hz:g} Hz" if code is Code.HOVER else ""
        yield reason + way_down


def _overriding(request: Acquire, code: Code, vehicle: VehicleSnapshot) -> str:
    """Failed preflight checks that a goal on the ground overrides, for people; "" for none."""
    failed = _checks_in_words(request, vehicle, overridden=True) if code is Code.IDLE else ""
    return f"takes off in spite of failed preflight checks: {failed}" if failed else ""


def _checks_in_words(request: Acquire, vehicle: VehicleSnapshot, *, overridden: bool) -> str:
    """Failed preflight checks that the request overrides, or those that it doesn't."""
    checks = [check for check in vehicle.failed_checks if (check.name in request.override) is overridden]
    return "; ".join(f"{check.name}: {check.text}" for check in checks)


def _phase_of(action: str) -> Phase:
    """The main phase of an action; an action that jezero doesn't have is one of an installed package."""
    return ACTIONS[action].phase if action in ACTIONS else Phase.ACTION


def odometry_min_hz(action: str) -> float:
    """Rate of odometry that an action needs."""
    return ACTIONS[action].odometry_min_hz if action in ACTIONS else FLYING_ODOMETRY_MIN_HZ


def _phases_of(action: str, code: Code) -> tuple[Phase, ...]:
    """Phases that a goal accepted in this status may go through, in their order."""
    phase = _phase_of(action)
    lifts_off_first = code is Code.IDLE and phase is not Phase.TAKEOFF
    return (Phase.TAKEOFF, phase) if lifts_off_first else (phase,)


# -- refusals of releases and hovers ---------------------------------------------------------------------


def release_refusal(request: Release, code: Code, vehicle: VehicleSnapshot, robot: VehicleConfig) -> str:
    """Reason why a goal that succeeded may not end with this request, or ""."""
    if (code is Code.LANDING) != (request.then != "hover"):
        return "a landing that succeeded ends with then=disarm, and nothing else does"
    return force_disarm_refusal(vehicle, robot) if request.then == "force_disarm" else ""


def force_disarm_refusal(vehicle: VehicleSnapshot, robot: VehicleConfig) -> str:
    """Reason why a landing's end may not stop the motors by force, or ""."""
    range_max_m = robot.height_altimeter_m + FORCE_FEET_MAX_M
    if vehicle.range_m is None or vehicle.range_m <= range_max_m:
        return ""
    return f"not disarmed by force: the altimeter measures {vehicle.range_m:.2f} m, {range_max_m:.2g} m is the limit"


def hover_refusal(
    request: Hover, code: Code, text: str, killing: bool, vehicle: VehicleSnapshot, limits: VehicleLimitsConfig
) -> str:
    """Reason why the bridge doesn't hover as requested; "" when it does, or takes control back in order to.

    Args:
        text: the status' last event, which explains a status 13.
        killing: the motors are being cut.
    """
    return next(_hover_refusals(request, code, text, killing, vehicle, limits), "")


def _hover_refusals(
    request: Hover, code: Code, text: str, killing: bool, vehicle: VehicleSnapshot, limits: VehicleLimitsConfig
) -> Iterator[str]:
    status, age_s = status_words(code), vehicle.telemetry_age_s
    if not request.hover_req:
        yield "hover_req is false: a goal in charge ends a hover, nothing else does"
    if request.hover_pos is not None and code is not Code.HOVER:
        yield f"a hover point can be given only while hovering, and {status}"
    if code is Code.IDLE and vehicle.armed is None:
        yield f"the autopilot has not reported the vehicle's state yet: {vehicle.not_ready_reason}"
    if code is Code.IDLE:
        yield "the vehicle stands on the ground: take off first"
    if code is Code.LANDING_DONE or (code is Code.ABORT and vehicle.landed):
        yield "the vehicle stands on the ground and is being disarmed"
    if code is Code.EXTERNAL and (killing or not vehicle.armed or vehicle.landed):
        yield f"control can be taken back in the air only, and {status}: {text}"
    if code is Code.EXTERNAL and (age_s > LINK_TIMEOUT_S or vehicle.pos_ned_m is None):
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
