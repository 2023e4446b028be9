"""Detection of control by others: another MAVLink system, or the autopilot's failsafe. Source: architecture §5.

`TakeoverDetector` compares arming and mode with what the bridge commanded, and `ForeignSetpointDetector` the setpoints
that the autopilot follows with those sent. `UnarmableModeDetector` finds the mode in which a flight has left an idle
autopilot, unless a pilot may be about to use it.
"""

from collections import deque
from math import dist, isnan

import msgspec

from jezero.base.frames import Vec3
from jezero.schemas.state import InCharge
from jezero.services.vehicle_bridge.vehicle import LAND, OFFBOARD, Target, VehicleSnapshot

Takeover = tuple[InCharge, str]
"""The new holder of control, and the reason for people."""

OFFBOARD_LEFT_MIN_S = 0.3
"""A vehicle that was about to arm and has been out of offboard mode for this time was given another mode."""


class TakeoverDetector:
    """Detects that somebody else controls the vehicle, from changes that the bridge did not command."""

    def __init__(self) -> None:
        self._offboard_ns: int | None = None
        """When the autopilot, commanded to arm, was last in offboard mode."""
        self._external_mode: tuple[str, bool] = ("", False)
        """Mode while others fly, and whether a failsafe chose it."""

    def reset(self, vehicle: VehicleSnapshot) -> None:
        """Start again when the status code changes."""
        self._offboard_ns = None
        self._external_mode = (vehicle.mode, vehicle.failsafe)

    @property
    def was_offboard(self) -> bool:
        """Whether the vehicle was about to arm in offboard mode. If it has left it, the bridge must not command
        offboard mode again: that would override the pilot who changed it."""
        return self._offboard_ns is not None

    def before_lift_off(self, vehicle: VehicleSnapshot, *, arm_commanded: bool) -> Takeover | None:
        """Takeover while the bridge commands offboard mode and arming, None without one."""
        if vehicle.armed and not (arm_commanded and vehicle.mode == OFFBOARD):
            return _takeover("armed, and not by the bridge", vehicle)
        if vehicle.mode == OFFBOARD:
            self._offboard_ns = vehicle.timer_ns if arm_commanded else None
        elif self._offboard_ns is not None and (vehicle.timer_ns - self._offboard_ns) * 1e-9 >= OFFBOARD_LEFT_MIN_S:
            return _takeover(f"the autopilot was switched to {vehicle.mode}", vehicle)
        return None

    def in_flight(self, vehicle: VehicleSnapshot) -> Takeover | None:
        """Takeover while the bridge flies in offboard mode, None without one."""
        if vehicle.armed and vehicle.mode != OFFBOARD:
            return _takeover(f"the autopilot was switched to {vehicle.mode}", vehicle)
        if vehicle.armed and vehicle.foreign_setpoints:
            return _takeover("the autopilot follows setpoints of somebody else", vehicle)
        return None

    def while_idle(self, vehicle: VehicleSnapshot, *, was_disarmed: bool) -> Takeover | None:
        """Takeover while the bridge is idle, None without one.

        Args:
            was_disarmed: the vehicle has been disarmed since the bridge started.
        """
        if not vehicle.armed:
            return None
        if was_disarmed:
            return _takeover("armed, and not by the bridge", vehicle)
        if vehicle.failsafe or vehicle.mode == OFFBOARD:
            return "failsafe", "the vehicle was armed already when the bridge started"
        return _takeover(f"the vehicle flew already, in {vehicle.mode}, when the bridge started", vehicle)

    def handover(self, vehicle: VehicleSnapshot) -> Takeover | None:
        """Handover between a pilot and a failsafe while others fly, None without one."""
        previous, self._external_mode = self._external_mode, (vehicle.mode, vehicle.failsafe)
        if self._external_mode == previous or not previous[0] or not vehicle.armed:
            return None
        if vehicle.failsafe:
            return "failsafe", f"a failsafe switched the autopilot to {vehicle.mode}"
        return "external", f"somebody switched the autopilot to {vehicle.mode}"


def _takeover(event: str, vehicle: VehicleSnapshot) -> Takeover:
    """Takeover through an event that a failsafe, a pilot or another program caused."""
    if vehicle.failsafe:
        because = f" ({vehicle.command_failure})" if vehicle.command_failure else ""
        return "failsafe", f"failsafe: {event}{because}"
    return "external", f"taken over: {event}"


# -- foreign setpoints -----------------------------------------------------------------------------------

SENT_MAX_AGE_NS = 1_000_000_000
"""A setpoint sent this long ago may still be echoed: latency, and positions moved by a reset."""
ECHO_MAX_AGE_NS = 300_000_000
"""An older echo is ignored: it may have been late on a link that was down."""
FOREIGN_WINDOW_NS = 2_000_000_000
FOREIGN_SETPOINTS_MIN = 4
FOREIGN_SPAN_MIN_NS = 500_000_000
"""Fewer foreign echoes in the window, or a shorter burst, may be late echoes of our own setpoints."""
POS_TOLERANCE_M = 0.1
VEL_TOLERANCE_MPS = 0.2


class SetpointEcho(msgspec.Struct, frozen=True):
    """One POSITION_TARGET_LOCAL_NED: the setpoint that the autopilot follows.

    Attributes:
        t_ns: vehicle time.
        pos_ned_m: position, with NaN in each axis that isn't controlled by position.
        vel_ned_mps: velocity, with NaN in each axis that isn't controlled by velocity.
    """

    t_ns: int
    pos_ned_m: Vec3
    vel_ned_mps: Vec3


class ForeignSetpointDetector:
    """Detects that somebody else streams setpoints too. In offboard mode the autopilot follows them without a change of
    mode.

    The autopilot echoes the setpoint that it follows in POSITION_TARGET_LOCAL_NED. PX4 echoes a position as it was
    sent, and a velocity after its own limits; on the ground it echoes nothing. So an echoed position must be one that
    was sent lately, and an echoed velocity no greater than one that was. Two streams alternate: foreign echoes are
    counted, they need not follow each other.
    """

    def __init__(self) -> None:
        self._sent: deque[tuple[int, Target]] = deque()
        self._foreign_ns: deque[int] = deque()

    def reset(self) -> None:
        """Start again, as when the bridge's own stream ends."""
        self._sent.clear()
        self._foreign_ns.clear()

    def add_sent(self, target: Target, timer_ns: int) -> None:
        """Remember a setpoint that the bridge has sent."""
        self._sent.append((timer_ns, target))
        while self._sent[0][0] < timer_ns - SENT_MAX_AGE_NS:
            self._sent.popleft()

    def update(self, echo: SetpointEcho, t_ns: int, timer_ns: int) -> None:
        """Compare an echo with the setpoints sent during the last second."""
        pos_ned_m, vel_ned_mps = echo.pos_ned_m, echo.vel_ned_mps
        if not self._sent or t_ns - echo.t_ns > ECHO_MAX_AGE_NS or all(map(isnan, pos_ned_m + vel_ned_mps)):
            return
        if not any(_may_be_echo(echo, target) for _, target in reversed(self._sent)):
            self._foreign_ns.append(timer_ns)

    def is_detected(self, timer_ns: int) -> bool:
        """Whether somebody else streams setpoints."""
        foreign_ns = self._foreign_ns
        while foreign_ns and foreign_ns[0] < timer_ns - FOREIGN_WINDOW_NS:
            foreign_ns.popleft()
        return len(foreign_ns) >= FOREIGN_SETPOINTS_MIN and foreign_ns[-1] - foreign_ns[0] >= FOREIGN_SPAN_MIN_NS


def _may_be_echo(echo: SetpointEcho, sent: Target) -> bool:
    """Whether the autopilot may echo this target so."""
    if sent.pos_ned_m is not None:
        return dist(sent.pos_ned_m, echo.pos_ned_m) <= POS_TOLERANCE_M
    if sent.vel_ned_mps is None or not all(map(isnan, echo.pos_ned_m)):
        return False
    return all(map(_is_limited, echo.vel_ned_mps, sent.vel_ned_mps))


def _is_limited(echo_mps: float, sent_mps: float) -> bool:
    """Whether one component of an echo is the sent one, or lies between it and zero."""
    low_mps, high_mps = min(0.0, sent_mps), max(0.0, sent_mps)
    return low_mps - VEL_TOLERANCE_MPS <= echo_mps <= high_mps + VEL_TOLERANCE_MPS


# -- modes after a flight --------------------------------------------------------------------------------

UNARMABLE_MODES = (OFFBOARD, LAND, "AUTO.RTL")
"""Modes in which a PX4 on the ground refuses to arm: offboard without a stream, and those that end on the ground."""
OWN_FLIGHT_TIMEOUT_S = 5.0
"""Hold mode is commanded for at most this time after the bridge's own flight."""
UNARMABLE_MIN_S = 2.0
"""Hold mode is commanded after another pilot's flight only when the vehicle has been unable to arm for this time."""
FOREIGN_FLIGHT_TIMEOUT_S = 10.0
"""Hold mode is not commanded later than this after somebody else's flight: a pilot may be about to arm."""


class UnarmableModeDetector:
    """Detects that an idle autopilot needs hold mode before it can be armed again.

    PX4 returns to offboard mode when it has been landed from it, and then can't be armed without a setpoint stream.
    """

    def __init__(self) -> None:
        self._own_flight = True
        self._since_ns = self._armable_ns = 0

    def reset(self, vehicle: VehicleSnapshot, *, own_flight: bool) -> None:
        """Start again when the vehicle becomes idle; `own_flight` when nobody else has flown it."""
        self._own_flight = own_flight
        self._since_ns = self._armable_ns = vehicle.timer_ns

    def update(self, vehicle: VehicleSnapshot) -> bool:
        """Whether to command hold mode now."""
        unarmable = vehicle.armed is False and vehicle.mode in UNARMABLE_MODES
        if not unarmable or vehicle.armable:
            self._armable_ns = vehicle.timer_ns
        idle_s = (vehicle.timer_ns - self._since_ns) * 1e-9
        self._own_flight &= idle_s <= OWN_FLIGHT_TIMEOUT_S and (unarmable or not vehicle.mode)
        unarmable_s = (vehicle.timer_ns - self._armable_ns) * 1e-9
        abandoned = unarmable_s >= UNARMABLE_MIN_S and idle_s <= FOREIGN_FLIGHT_TIMEOUT_S
        return unarmable and (self._own_flight or abandoned)
