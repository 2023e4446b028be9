"""The MAVLink side: telemetry in, setpoints and acknowledged commands out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import nan, sqrt
from types import MappingProxyType

import msgspec

from jezero.frames import Quat, Vec3, quat_normalize, quat_rotate
from jezero.mavlink import FieldReader, FramePacker, MavlinkCodec, MavMessage, dialect
from jezero.schemas.state import Battery, Geodetic, Odometry
from jezero.services.vehicle_bridge.parameters import ParameterSetter
from jezero.services.vehicle_bridge.resets import ResetHistory
from jezero.services.vehicle_bridge.vehicle import Order, Target, mode_name

COMPONENT_ID = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT_ID = dialect.MAV_COMP_ID_AUTOPILOT1
RETRY_NS = 500_000_000
"""An order that is not acknowledged, or refused, is given again after this."""
EFFECT_NS = 1_500_000_000
"""An order that is acknowledged but has no effect is given again after this."""
RESTART_NS = 1_000_000_000
"""The autopilot's time going back by more than this means that it restarted; by less, that datagrams overtook."""
BEAT_WALL_NS = 150_000_000
"""In flight the mode must be known to be not older than this. PX4 beats once a second, but also when it is asked."""
COMPLAINT_NS = 6_000_000_000
"""A warning of the autopilot explains a refusal for this long."""
FORCE = 21196.0

INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_ODOMETRY: 20_000,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 100_000,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 100_000,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 500_000,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1_000_000,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 30_000,
}
"""What the bridge asks the autopilot to stream."""
ROUTINE = (dialect.MAVLINK_MSG_ID_ODOMETRY, dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)

_COMMANDS: dict[Order, tuple[int, tuple[float, float, float]]] = {
    Order.OFFBOARD: (dialect.MAV_CMD_DO_SET_MODE, (1.0, 6.0, 0.0)),
    Order.HOLD: (dialect.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 3.0)),
    Order.LAND: (dialect.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 6.0)),
    Order.ARM: (dialect.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0, 0.0)),
    Order.DISARM: (dialect.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, 0.0, 0.0)),
    Order.FORCE_DISARM: (dialect.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, FORCE, 0.0)),
}
_RESULTS = {
    dialect.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    dialect.MAV_RESULT_DENIED: "denied",
    dialect.MAV_RESULT_UNSUPPORTED: "unsupported",
    dialect.MAV_RESULT_FAILED: "failed",
}
_FAILSAFE_STATES = (dialect.MAV_STATE_CRITICAL, dialect.MAV_STATE_EMERGENCY, dialect.MAV_STATE_FLIGHT_TERMINATION)
_LOCAL_NED = dialect.MAV_FRAME_LOCAL_NED
_SETPOINT = FramePacker(
    dialect.MAVLink_set_position_target_local_ned_message,
    *("time_boot_ms", "x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"),
    *("type_mask", "target_system", "target_component", "coordinate_frame"),
)
_MASK_POS, _MASK_VEL, _MASK_ACC, _MASK_YAW_RATE = 7, 56, 448, 2048
_NONE: Vec3 = (0.0, 0.0, 0.0)


@dataclass
class Telemetry:
    """What the autopilot told last; None and "" until it did.

    Attributes:
        heard_wall_ns: when it last said anything.
        beat_wall_ns: when it was last asked for its HEARTBEAT, or told it unasked.
        failsafe: a failsafe chose what it does.
        armable: its own arming checks pass.
        warning: its last sentence of severity warning or worse, said at `warning_ns`.
    """

    heard_wall_ns: int | None = None
    beat_wall_ns: int = 0
    armed: bool | None = None
    landed: bool | None = None
    mode: str = ""
    failsafe: bool = False
    armable: bool = False
    origin_deg: Geodetic | None = None
    battery: Battery | None = None
    odometry: Odometry | None = None
    resets: ResetHistory = field(default_factory=ResetHistory)
    warning: str = ""
    warning_ns: int = 0


class Received(msgspec.Struct):
    """What one batch of bytes brought, oldest first.

    Attributes:
        timer_ns, wall_ns, epoch_id: when and in which epoch.
        steps_ned_m: position steps of the autopilot's resets.
        followed: the newest it told of what it follows: vehicle time in ns, position and velocity, NaN where it
            controls none.
        restarted: its time went back.
        respawned: the vehicle is another one than before.
        routine: it told where it is and what it follows, and nothing else.
    """

    timer_ns: int
    wall_ns: int
    epoch_id: int
    odometry: list[Odometry] = msgspec.field(default_factory=list)
    steps_ned_m: list[Vec3] = msgspec.field(default_factory=list)
    followed: tuple[int, Vec3, Vec3] | None = None
    restarted: bool = False
    respawned: bool = False
    routine: bool = True


class AutopilotLink:
    """Speaks MAVLink with one autopilot.

    Args:
        system_id: of the vehicle; the bridge is another component of the same system.
        parameters: that the autopilot shall have.
    """

    def __init__(self, system_id: int, parameters: Mapping[str, int | float] = MappingProxyType({})) -> None:
        self.telemetry = Telemetry()
        self.parameters = ParameterSetter(parameters)
        self.accepted: Order | None = None
        """The order pursued at present, once it has been acknowledged."""
        self._system_id = system_id
        self._codec = MavlinkCodec(system_id, COMPONENT_ID, peer=(system_id, AUTOPILOT_COMPONENT_ID))
        self._order: Order | None = None
        self._next_try_ns = 0
        self._tries = 0
        self._refusal = ""
        self._statustext: tuple[int, str] = (0, "")
        self._handlers: dict[int, Callable[[MavMessage, Received], None]] = {
            dialect.MAVLINK_MSG_ID_ODOMETRY: self._on_odometry,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._on_extended_sys_state,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._on_sys_status,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._on_origin,
            dialect.MAVLINK_MSG_ID_COMMAND_ACK: self._on_ack,
            dialect.MAVLINK_MSG_ID_STATUSTEXT: self._on_statustext,
            dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._on_target,
            dialect.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
        }

    @property
    def malformed(self) -> int:
        """Stretches of bytes that were no message, and messages with impossible numbers."""
        return self._codec.malformed

    def forget(self) -> None:
        """The vehicle is another one than before: nothing that was told holds any more."""
        self.telemetry = Telemetry()
        self.parameters.restart()
        self.pursue(None, 0)
        self._refusal = ""

    def complaint(self, timer_ns: int) -> str:
        """Why the autopilot refuses what it is asked, in its own words where it gave some."""
        if not (self._refusal or self.telemetry.warning):
            return ""
        warning = self.warning(timer_ns)
        return f"{self._refusal}; {warning}" if self._refusal and warning else self._refusal or warning

    def warning(self, timer_ns: int) -> str:
        """What the autopilot warned of lately."""
        recent = timer_ns - self.telemetry.warning_ns <= COMPLAINT_NS
        return self.telemetry.warning if recent else ""

    # -- in --

    def receive(self, data: bytes, timer_ns: int, wall_ns: int, epoch_id: int) -> Received:
        """Take in what arrived."""
        received = Received(timer_ns, wall_ns, epoch_id)
        for message in self._codec.parse(data):
            self.telemetry.heard_wall_ns = wall_ns
            kind = message.get_msgId()
            take = self._handlers.get(kind)
            if take is not None:
                take(message, received)
                received.routine &= kind in ROUTINE
        return received

    def _on_odometry(self, message: MavMessage, received: Received) -> None:
        try:
            t_ns, pos, vel, q, rates, std_pos_m, reset_counter = _pose(message)
        except ValueError:
            self._codec.malformed += 1
            return
        last = self.telemetry.odometry
        if last is not None and t_ns <= last.t_ns:
            if last.t_ns - t_ns <= RESTART_NS:
                return
            received.restarted = True
            received.routine = False
            received.odometry.clear()
            received.steps_ned_m.clear()
            heard_wall_ns = self.telemetry.heard_wall_ns
            self.forget()
            self.telemetry.heard_wall_ns = heard_wall_ns
        resets = self.telemetry.resets
        step = resets.update(t_ns, reset_counter, pos, vel)
        if step is not None:
            received.steps_ned_m.append(step)
            received.routine = False
        odometry = Odometry(
            t_ns=t_ns,
            epoch_id=received.epoch_id,
            pos_uav_ned_m=pos,
            vel_uav_ned_mps=vel,
            q_ned_from_frd=q,
            rates_uav_frd_rps=rates,
            std_pos_m=std_pos_m,
            origin_deg=self.telemetry.origin_deg,
            reset_counter=resets.counter,
            reset_offset_ned_m=resets.offset_ned_m,
        )
        self.telemetry.odometry = odometry
        received.odometry.append(odometry)

    def _on_heartbeat(self, message: MavMessage, received: Received) -> None:
        self.telemetry.beat_wall_ns = received.wall_ns
        self.telemetry.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        self.telemetry.mode = mode_name(message.custom_mode)
        self.telemetry.failsafe = message.system_status in _FAILSAFE_STATES

    def _on_extended_sys_state(self, message: MavMessage, _received: Received) -> None:
        undefined = message.landed_state == dialect.MAV_LANDED_STATE_UNDEFINED
        self.telemetry.landed = None if undefined else message.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND

    def _on_target(self, message: MavMessage, received: Received) -> None:
        received.followed = _followed(message)

    def _on_parameter(self, message: MavMessage, _received: Received) -> None:
        self.parameters.confirm(_text(message.param_id), message.param_value, message.param_type)

    def _on_sys_status(self, message: MavMessage, _received: Received) -> None:
        bit = dialect.MAV_SYS_STATUS_PREARM_CHECK
        healthy = message.onboard_control_sensors_health  # PX4 never says that the check is present
        self.telemetry.armable = bool(healthy & bit)
        if message.voltage_battery == 0xFFFF:
            self.telemetry.battery = None
            return
        remaining = message.battery_remaining
        self.telemetry.battery = Battery(
            voltage_v=message.voltage_battery * 1e-3, remaining=remaining / 100.0 if 0 <= remaining <= 100 else None
        )

    def _on_origin(self, message: MavMessage, _received: Received) -> None:
        latitude_deg, longitude_deg = message.latitude * 1e-7, message.longitude * 1e-7
        altitude_m = message.altitude * 1e-3
        if abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and abs(altitude_m) <= 1e5:
            self.telemetry.origin_deg = (latitude_deg, longitude_deg, altitude_m)

    def _on_statustext(self, message: MavMessage, received: Received) -> None:
        text = _text(message.text)
        last_id, before = self._statustext
        if message.id != 0 and message.chunk_seq > 0 and message.id == last_id:
            text = (before + text)[:1000]
        self._statustext = (message.id, text)
        if message.severity <= dialect.MAV_SEVERITY_WARNING:
            self.telemetry.warning = text
            self.telemetry.warning_ns = received.timer_ns

    def _on_ack(self, message: MavMessage, received: Received) -> None:
        order = self._order
        to_us = (message.target_system, message.target_component) == (self._system_id, COMPONENT_ID)
        if order is None or not to_us or message.command != _COMMANDS[order][0] or self._tries == 0:
            return
        if message.result in (dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_IN_PROGRESS):
            self.accepted = order
            self._refusal = ""
            self._next_try_ns = received.timer_ns + EFFECT_NS
        else:
            self._refusal = f"{order} {_RESULTS.get(message.result, f'refused with result {message.result}')}"

    # -- out --

    def heartbeat(self) -> bytes:
        """That the bridge lives; due once per second."""
        return self._codec.pack(
            dialect.MAVLink_heartbeat_message(
                dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
            )
        )

    def ask_for_heartbeat(self, wall_ns: int) -> bytes:
        """Ask for one unless the last is fresh enough; for use in flight."""
        if wall_ns - self.telemetry.beat_wall_ns < BEAT_WALL_NS:
            return b""
        self.telemetry.beat_wall_ns = wall_ns
        return self._command(dialect.MAV_CMD_REQUEST_MESSAGE, float(dialect.MAVLINK_MSG_ID_HEARTBEAT), 0.0)

    def intervals(self) -> bytes:
        """Ask for the telemetry that the bridge needs."""
        command = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
        return b"".join(self._command(command, float(kind), float(us)) for kind, us in INTERVALS_US.items())

    def set_parameters(self, wall_ns: int) -> bytes:
        """PARAM_SET of what is not confirmed yet, when it is due."""
        return b"".join(
            self._codec.pack(
                dialect.MAVLink_param_set_message(
                    self._system_id, AUTOPILOT_COMPONENT_ID, name.encode("ascii"), value, kind
                )
            )
            for name, value, kind in self.parameters.due(wall_ns)
        )

    def setpoint(self, target: Target, t_ns: int) -> bytes:
        """One SET_POSITION_TARGET_LOCAL_NED."""
        pos, vel, acc = target.pos_ned_m, target.vel_ned_mps, target.acc_ned_mps2
        mask = _MASK_YAW_RATE if target.yaw_rate_rps is None else 0
        mask |= _MASK_POS if pos is None else 0
        mask |= _MASK_VEL if vel is None else 0
        mask |= _MASK_ACC if acc is None else 0
        x, y, z = pos or _NONE
        vx, vy, vz = vel or _NONE
        afx, afy, afz = acc or _NONE
        motion = (x, y, z, vx, vy, vz, afx, afy, afz, target.yaw_rad, target.yaw_rate_rps or 0.0)
        t_ms = (t_ns // 1_000_000) & 0xFFFFFFFF
        return self._codec.pack_numbers(
            _SETPOINT, t_ms, *motion, mask, self._system_id, AUTOPILOT_COMPONENT_ID, _LOCAL_NED
        )

    def pursue(self, order: Order | None, timer_ns: int) -> bytes:
        """What must be sent now so that `order` gets done; call it with the same one until it is."""
        if order is not self._order:
            self._order = order
            self.accepted = None
            if order is not None:
                self._refusal = ""
            self._next_try_ns = timer_ns
            self._tries = 0
        if order is None or timer_ns < self._next_try_ns:
            return b""
        self._next_try_ns = timer_ns + RETRY_NS
        command, parameters = _COMMANDS[order]
        data = self._command(command, *parameters, confirmation=min(self._tries, 255))
        self._tries += 1
        return data

    def _command(self, command: int, p1: float, p2: float, p3: float = 0.0, *, confirmation: int = 0) -> bytes:
        return self._codec.pack(
            dialect.MAVLink_command_long_message(
                self._system_id, AUTOPILOT_COMPONENT_ID, command, confirmation, p1, p2, p3, 0.0, 0.0, 0.0, 0.0
            )
        )


def _text(field: str | bytes) -> str:
    return (field if isinstance(field, str) else field.decode("utf-8", "replace")).rstrip("\0")


def _followed(message: MavMessage) -> tuple[int, Vec3, Vec3]:
    """Vehicle time, position and velocity of a POSITION_TARGET_LOCAL_NED, with NaN for what is masked."""
    fields = ("x", "y", "z", "vx", "vy", "vz")
    x, y, z, vx, vy, vz = (nan if message.type_mask >> i & 1 else getattr(message, f) for i, f in enumerate(fields))
    return message.time_boot_ms * 1_000_000, (x, y, z), (vx, vy, vz)


_ODOMETRY = FieldReader(
    dialect.MAVLink_odometry_message,
    *("time_usec", "x", "y", "z", "q", "vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed"),
    *("pose_covariance[0]", "pose_covariance[6]", "frame_id", "child_frame_id", "reset_counter"),
)


def _pose(message: MavMessage) -> tuple[int, Vec3, Vec3, Quat, Vec3, float | None, int]:
    """Time in ns, position, velocity and attitude in world NED, body rates, horizontal standard deviation of the
    position and reset counter of an ODOMETRY.

    Raises:
        ValueError: a number is not finite, out of its range, or in a frame the bridge doesn't know.
    """
    numbers = _ODOMETRY(message)
    t_us, x, y, z, qw, qx, qy, qz, vx, vy, vz, p, q, r, var_north_m2, var_east_m2, frame, child_frame, counter = numbers
    pos, vel, rates = (x, y, z), (vx, vy, vz), (p, q, r)
    if frame != _LOCAL_NED:
        raise ValueError("not a pose in local NED")
    attitude = quat_normalize((qw, qx, qy, qz))
    if child_frame == dialect.MAV_FRAME_BODY_FRD:
        vel = quat_rotate(attitude, vel)
    elif child_frame != _LOCAL_NED:
        raise ValueError("velocity in an unknown frame")
    t_ns = t_us * 1000
    if t_ns > 2**62:
        raise ValueError("time out of range")
    vx, vy, vz = vel
    small = x * x + y * y + z * z <= 1e12 and vx * vx + vy * vy + vz * vz <= 1e6 and p * p + q * q + r * r <= 1e6
    if not small:  # or NaN
        raise ValueError("not finite, or out of range")
    variance_m2 = max(var_north_m2, var_east_m2)
    std_m = sqrt(variance_m2) if 0.0 <= variance_m2 <= 1e12 else None
    return t_ns, pos, vel, attitude, rates, std_m, counter
