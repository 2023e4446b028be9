"""What the bridge knows and tells of the vehicle, and what it can ask of the autopilot. No MAVLink here."""

from enum import StrEnum

import msgspec

from jezero.frames import Quat, Vec3, add, tilt_from_quat, yaw_from_quat
from jezero.schemas.state import InCharge, StatusCode

OFFBOARD = "OFFBOARD"
LAND = "AUTO.LAND"
UNARMABLE_MODES = (OFFBOARD, LAND, "AUTO.RTL")
"""Modes in which a PX4 on the ground refuses to arm: offboard without a stream, and those that end on the ground."""

_MAIN_MODES = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: OFFBOARD, 7: "STABILIZED", 10: "TERMINATION",
    11: "ALTITUDE_CRUISE",
}  # fmt: skip
_AUTO_MODES = {
    1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW_TARGET", 9: "PRECLAND",
}  # fmt: skip


def mode_name(custom_mode: int) -> str:
    """PX4's word for its HEARTBEAT.custom_mode, e.g. "OFFBOARD" or "AUTO.LAND"."""
    main, sub = (custom_mode >> 16) & 0xFF, (custom_mode >> 24) & 0xFF
    name = _MAIN_MODES.get(main, f"MODE_{main}")
    return f"{name}.{_AUTO_MODES.get(sub, sub)}" if main == 4 else name


class Order(StrEnum):
    """A command that is pursued until the vehicle does it."""

    OFFBOARD = "offboard mode"
    ARM = "arming"
    DISARM = "disarming"
    FORCE_DISARM = "forced disarming"
    LAND = "land mode"
    HOLD = "hold mode"


class Target(msgspec.Struct, frozen=True):
    """What is streamed to the autopilot; at least one of position and velocity is given."""

    pos_ned_m: Vec3 | None
    vel_ned_mps: Vec3 | None
    acc_ned_mps2: Vec3 | None
    yaw_rad: float
    yaw_rate_rps: float | None = None

    def moved(self, step_ned_m: Vec3) -> "Target":
        """The same place after the world frame's positions moved by a step."""
        if self.pos_ned_m is None or not any(step_ned_m):
            return self
        return msgspec.structs.replace(self, pos_ned_m=add(self.pos_ned_m, step_ned_m))


class Situation(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decisions rest on, at one instant.

    Attributes:
        t_ns: vehicle time, which ages of messages are measured by; it may be corrected backwards.
        timer_ns: vehicle time that has passed in the bridge's life, never backwards: all time-outs.
        armed: None until the autopilot tells.
        landed: the autopilot's land detector; before it tells, true only of a disarmed vehicle.
        mode: the autopilot's word, "" until it tells.
        failsafe: the autopilot itself chose what it does; otherwise a mode was somebody's choice.
        armable: the autopilot's arming checks pass, in its present mode.
        contested: it follows setpoints that the bridge didn't send.
        pos_ned_m, vel_ned_mps, q_ned_from_frd: newest odometry; position is None until there is one.
        range_m: to ground or deck by the altimeter, tilt-corrected; None when it measures nothing.
        height_m: above ground or deck, None without odometry.
        silent_s: for how long telemetry, or odometry in it, has been missing.
        not_ready: why a takeoff isn't possible; "" when it is, and in any other status than 0.
        accepted: the order pursued at present, once the autopilot has acknowledged it.
        complaint: the autopilot's last words of refusal, "" when there are none.
        router_lost_s: for how long the bus's router has been missing.
    """

    t_ns: int
    timer_ns: int
    armed: bool | None = None
    landed: bool = False
    mode: str = ""
    failsafe: bool = False
    armable: bool = False
    contested: bool = False
    pos_ned_m: Vec3 | None = None
    vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    q_ned_from_frd: Quat = (1.0, 0.0, 0.0, 0.0)
    range_m: float | None = None
    height_m: float | None = None
    silent_s: float = 0.0
    not_ready: str = ""
    accepted: Order | None = None
    complaint: str = ""
    router_lost_s: float = 0.0

    @property
    def yaw_rad(self) -> float:
        return yaw_from_quat(self.q_ned_from_frd)

    @property
    def tilt_rad(self) -> float:
        return tilt_from_quat(self.q_ned_from_frd)


class Standing(msgspec.Struct, frozen=True):
    """Everything of `status` that authority decides, at one instant."""

    code: StatusCode
    in_charge: InCharge
    goal_id: str
    control_id: str
    grants: int
    text: str
