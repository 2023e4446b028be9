"""State of the vehicle, steps of its position estimate, and the commands and targets for its autopilot. No MAVLink."""

from collections import deque
from enum import StrEnum

import msgspec

from jezero.base.frames import Quat, Vec3, add, scale, subtract, tilt_from_quat, yaw_from_quat
from jezero.schemas.preflight import Check

OFFBOARD = "OFFBOARD"
LAND = "AUTO.LAND"
LINK_TIMEOUT_S = 1.0
"""Telemetry that is older than this is missing: a goal ends and a hover begins, and nothing takes off."""
RESETS_MAX = 32
"""Number of resets that are kept; a setpoint computed before them is dropped."""

_MAIN_MODES = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: OFFBOARD, 7: "STABILIZED", 10: "TERMINATION",
    11: "ALTITUDE_CRUISE",
}  # fmt: skip
_AUTO_MODES = {
    1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW_TARGET", 9: "PRECLAND",
}  # fmt: skip


def mode_name(custom_mode: int) -> str:
    """PX4's name for its HEARTBEAT.custom_mode, e.g. "OFFBOARD" or "AUTO.LAND"."""
    main, sub = (custom_mode >> 16) & 0xFF, (custom_mode >> 24) & 0xFF
    name = _MAIN_MODES.get(main, f"MODE_{main}")
    return f"{name}.{_AUTO_MODES.get(sub, sub)}" if main == 4 else name


class AutopilotCommand(StrEnum):
    """A command to the autopilot, repeated until the vehicle's state shows its effect."""

    OFFBOARD = "offboard mode"
    ARM = "arming"
    DISARM = "disarming"
    FORCE_DISARM = "forced disarming"
    LAND = "land mode"
    HOLD = "hold mode"


class Target(msgspec.Struct, frozen=True):
    """A setpoint that is streamed to the autopilot; at least one of position and velocity is given."""

    pos_ned_m: Vec3 | None
    vel_ned_mps: Vec3 | None
    acc_ned_mps2: Vec3 | None
    yaw_rad: float
    yaw_rate_rps: float | None = None

    def moved(self, step_ned_m: Vec3) -> "Target":
        """The same place after the autopilot's position estimate has moved by this step."""
        if self.pos_ned_m is None or not any(step_ned_m):
            return self
        return msgspec.structs.replace(self, pos_ned_m=add(self.pos_ned_m, step_ned_m))


class VehicleSnapshot(msgspec.Struct, frozen=True, kw_only=True):
    """The vehicle's state at one time; every decision of one step rests on the same snapshot.

    Attributes:
        t_ns: vehicle time, for the age of messages; it may be corrected backwards.
        timer_ns: vehicle time since the bridge started, for time-outs; it never steps back.
        started_ns: vehicle time at which the bridge has started.
        armed: None until the autopilot has reported it.
        landed: state of the autopilot's land detector; until that is reported, true for a disarmed vehicle only.
        mode: the autopilot's mode by PX4's name, "" until it is reported.
        failsafe: the autopilot's failsafe chose the mode; otherwise a person or program did.
        armable: the autopilot's arming checks pass in its present mode.
        foreign_setpoints: the autopilot follows setpoints that the bridge did not send.
        pos_ned_m: position of the newest odometry, None until there is one.
        vel_ned_mps: velocity of the newest odometry.
        q_ned_from_frd: attitude of the newest odometry.
        range_m: tilt-corrected distance from the altimeter to ground or platform; None without a valid measurement.
        height_m: height above ground or platform, None without odometry.
        takeoff_ned_m: place where the vehicle last stood; None when the bridge did not see it stand.
        telemetry_age_s: age of the newest telemetry, or of the newest odometry if that is older.
        failed_checks: preflight checks that have failed lately.
        not_ready_reason: reason why a takeoff isn't possible; "" when it is, and in any status but 0.
        acknowledged: the present command, once the autopilot has acknowledged it.
        command_failure: the autopilot's reason for refusing a command, "" without one.
        router_lost_s: time since the bus's router was last reachable.
        odometry_hz: rate of odometry; None where it isn't judged, or it is too early.
        line: the link to a real flight controller, as in the settings; "" for the simulated one.
    """

    t_ns: int
    timer_ns: int
    started_ns: int = 0
    armed: bool | None = None
    landed: bool = False
    mode: str = ""
    failsafe: bool = False
    armable: bool = False
    foreign_setpoints: bool = False
    pos_ned_m: Vec3 | None = None
    vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    q_ned_from_frd: Quat = (1.0, 0.0, 0.0, 0.0)
    range_m: float | None = None
    height_m: float | None = None
    takeoff_ned_m: Vec3 | None = None
    telemetry_age_s: float = 0.0
    failed_checks: tuple[Check, ...] = ()
    not_ready_reason: str = ""
    acknowledged: AutopilotCommand | None = None
    command_failure: str = ""
    router_lost_s: float = 0.0
    odometry_hz: float | None = None
    line: str = ""

    @property
    def yaw_rad(self) -> float:
        return yaw_from_quat(self.q_ned_from_frd)

    @property
    def tilt_rad(self) -> float:
        return tilt_from_quat(self.q_ned_from_frd)

    @property
    def failure_reason(self) -> str:
        """The autopilot's reason for refusing a command, for people."""
        return self.command_failure or "the autopilot gives no reason"


class ResetHistory:
    """Sum of the autopilot's position steps, which moves a point given before a reset to where it is now.

    Attributes:
        counter: the autopilot's reset counter, unwrapped from its eight bits; -1 before the first odometry.
        offset_ned_m: sum of all steps since the first odometry.
    """

    def __init__(self) -> None:
        self.counter = -1
        self.offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._history: deque[tuple[int, Vec3]] = deque(maxlen=RESETS_MAX)
        self._last: tuple[int, Vec3, Vec3] | None = None

    def update(self, t_ns: int, counter_u8: int, pos_ned_m: Vec3, vel_ned_mps: Vec3) -> Vec3 | None:
        """Update with one odometry.

        Args:
            counter_u8: the counter as MAVLink carries it, 0–255.
        Returns:
            The step (3,) in m, NED, when this odometry is the first after a reset, else None. The step is the change
            of position that the vehicle's velocity doesn't explain.
        """
        last = self._last
        self._last = (t_ns, pos_ned_m, vel_ned_mps)
        if last is None:
            self.counter = counter_u8
            self._history.append((self.counter, self.offset_ned_m))
            return None
        resets = (counter_u8 - self.counter) % 256
        if resets == 0:
            return None
        expected = add(last[1], scale(last[2], (t_ns - last[0]) * 1e-9))
        step = subtract(pos_ned_m, expected)
        self.counter += resets
        self.offset_ned_m = add(self.offset_ned_m, step)
        self._history.append((self.counter, self.offset_ned_m))
        return step

    def step_since(self, counter: int) -> Vec3 | None:
        """Sum of the steps (3,) in m, NED, since `counter`; None when that counter is unknown."""
        if counter == self.counter:
            return (0.0, 0.0, 0.0)
        for known, offset_ned_m in reversed(self._history):
            if known == counter:
                return subtract(self.offset_ned_m, offset_ned_m)
        return None
