"""The MAVLink side: telemetry in, setpoints and acknowledged commands out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import nan, sqrt
from types import MappingProxyType
from typing import NamedTuple

import msgspec

from jezero.base.frames import Quat, Vec3, quat_normalize, quat_rotate
from jezero.base.mavlink import FieldReader, FramePacker, MavlinkCodec, MavMessage, Signing, dialect
from jezero.schemas.sensors import Altimeter, CameraAttitude
from jezero.schemas.state import Battery, Geodetic, Odometry
from jezero.services.vehicle_bridge.fence import FenceUpload
from jezero.services.vehicle_bridge.gimbal import INTERVALS_US as GIMBAL_INTERVALS_US
from jezero.services.vehicle_bridge.gimbal import GimbalClient
from jezero.services.vehicle_bridge.narrow_line import OdometryRate, PairedOdometry
from jezero.services.vehicle_bridge.parameters import ParameterSetter
from jezero.services.vehicle_bridge.takeover import SetpointEcho
from jezero.services.vehicle_bridge.vehicle import AutopilotCommand, ResetHistory, Target, mode_name

NS_PER_MS = 1_000_000
COMPONENT_ID = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT_ID = dialect.MAV_COMP_ID_AUTOPILOT1
GIMBAL_COMPONENT_IDS = (154, 171, 172, 173, 174, 175)
"""Components of gimbals, whose messages the flight controller passes on."""
ACK_TIMEOUT_NS = 500_000_000
"""A command that is refused or not acknowledged is sent again after this time."""
EFFECT_TIMEOUT_NS = 1_500_000_000
"""A command that is acknowledged but has no effect is sent again after this time."""
RESTART_STEP_NS = 1_000_000_000
"""The autopilot has restarted when its time steps back by more than this; by less, datagrams overtook each other."""
HEARTBEAT_MAX_AGE_NS = 150_000_000
"""In flight the mode must not be older than this. PX4 sends a HEARTBEAT once a second, and on request."""
ORIGIN_MISSING_PERIOD_NS, ORIGIN_KNOWN_PERIOD_NS = 1_000_000_000, 5_000_000_000
"""Period of the requests for GPS_GLOBAL_ORIGIN. PX4 sends it once, to whoever listens then, and at changes: one message
lost, and the bridge would never be ready or would keep the old origin."""
BATTERY_CRITICAL = "BAT_CRIT_THR"
"""Parameter with the battery's critical level. The autopilot sends it on request, and when it changes."""
CRITICAL_MISSING_PERIOD_NS = 2_000_000_000
"""Period of the requests for this parameter."""
VERSION_MISSING_PERIOD_NS = 2_000_000_000
"""Period of the requests for AUTOPILOT_VERSION to a real flight controller."""
WARNING_MAX_AGE_NS = 6_000_000_000
"""An older warning of the autopilot doesn't explain a refusal."""
FORCE = 21196.0

INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_ODOMETRY: 20_000,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 100_000,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 100_000,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 500_000,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1_000_000,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 30_000,
}
"""Period of each MAVLink message that the bridge requests from the autopilot, in µs."""
HARDWARE_INTERVALS_US = {**INTERVALS_US, dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR: 40_000}
"""The same of a real flight controller, which has the rangefinder."""
OFF = -1
NARROW_INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_ODOMETRY: OFF,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 33_000,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 33_000,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 200_000,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 200_000,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1_000_000,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 2_000_000,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 200_000,
    dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR: 100_000,
}
"""The same on a narrow line: 4 kB/s instead of 15."""

_COMMANDS: dict[AutopilotCommand, tuple[int, tuple[float, float, float]]] = {
    AutopilotCommand.OFFBOARD: (dialect.MAV_CMD_DO_SET_MODE, (1.0, 6.0, 0.0)),
    AutopilotCommand.HOLD: (dialect.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 3.0)),
    AutopilotCommand.LAND: (dialect.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 6.0)),
    AutopilotCommand.ARM: (dialect.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0, 0.0)),
    AutopilotCommand.DISARM: (dialect.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, 0.0, 0.0)),
    AutopilotCommand.FORCE_DISARM: (dialect.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, FORCE, 0.0)),
}
_RESULTS = {
    dialect.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    dialect.MAV_RESULT_DENIED: "denied",
    dialect.MAV_RESULT_UNSUPPORTED: "unsupported",
    dialect.MAV_RESULT_FAILED: "failed",
}
_FAILSAFE_STATES = (dialect.MAV_STATE_CRITICAL, dialect.MAV_STATE_EMERGENCY, dialect.MAV_STATE_FLIGHT_TERMINATION)
_LOCAL_NED = dialect.MAV_FRAME_LOCAL_NED
_ODOMETRY = FieldReader(
    dialect.MAVLink_odometry_message,
    *("time_usec", "x", "y", "z", "q", "vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed"),
    *("pose_covariance[0]", "pose_covariance[6]", "frame_id", "child_frame_id", "reset_counter"),
)
_SETPOINT = FramePacker(
    dialect.MAVLink_set_position_target_local_ned_message,
    *("time_boot_ms", "x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"),
    *("type_mask", "target_system", "target_component", "coordinate_frame"),
)
_MASK_POS, _MASK_VEL, _MASK_ACC, _MASK_YAW_RATE = 7, 56, 448, 2048
_ZERO: Vec3 = (0.0, 0.0, 0.0)


@dataclass
class Telemetry:
    """State that the autopilot has reported; None and "" until it has.

    Attributes:
        received_wall_ns: wall time of the last message.
        heartbeat_wall_ns: wall time of the last HEARTBEAT, or of the last request for one.
        armed: the motors may run.
        landed: state of the land detector.
        mode: mode by PX4's name.
        failsafe: a failsafe chose the mode.
        armable: the autopilot's arming checks pass.
        origin_deg: origin of the world frame.
        battery: None when the autopilot doesn't measure it.
        battery_critical: see `Battery.critical`.
        altimeter: newest range of the rangefinder that points down.
        odometry: newest odometry.
        resets: steps of the position estimate.
        warning: last STATUSTEXT of severity warning or worse.
        warning_ns: timer's time of `warning`.
        version: of a real flight controller, as AUTOPILOT_VERSION carries it.
    """

    received_wall_ns: int | None = None
    heartbeat_wall_ns: int = 0
    armed: bool | None = None
    landed: bool | None = None
    mode: str = ""
    failsafe: bool = False
    armable: bool = False
    origin_deg: Geodetic | None = None
    battery: Battery | None = None
    battery_critical: float | None = None
    altimeter: Altimeter | None = None
    odometry: Odometry | None = None
    resets: ResetHistory = field(default_factory=ResetHistory)
    warning: str = ""
    warning_ns: int = 0
    version: int | None = None


class TelemetryBatch(msgspec.Struct):
    """Contents of one batch of bytes, oldest first.

    Attributes:
        timer_ns: timer's time of arrival.
        wall_ns: wall time of arrival.
        epoch_id: epoch of the vehicle.
        odometry: all valid odometry.
        steps_ned_m: steps of the position estimate at the autopilot's resets.
        setpoint_echo: the newest one.
        restarted: the autopilot's time stepped back.
        altimeter: ranges of the rangefinder that points down, in the autopilot's time.
        camera: measured angles of a camera on a gimbal.
        time_replies: contents of each TIMESYNC reply: the autopilot's time, and the time stamp of the request, in ns.
    """

    timer_ns: int
    wall_ns: int
    epoch_id: int
    odometry: list[Odometry] = msgspec.field(default_factory=list)
    steps_ned_m: list[Vec3] = msgspec.field(default_factory=list)
    setpoint_echo: SetpointEcho | None = None
    restarted: bool = False
    altimeter: list[Altimeter] = msgspec.field(default_factory=list)
    camera: list[CameraAttitude] = msgspec.field(default_factory=list)
    time_replies: list[tuple[int, int]] = msgspec.field(default_factory=list)


class AutopilotLink:
    """MAVLink connection with one autopilot.

    Args:
        system_id: MAVLink system id of the vehicle; the bridge is another component of the same system.
        parameters: parameters to set on the autopilot.
        on_hardware: whether it is a real flight controller, with the rangefinder, on a line that may be too narrow.
        gimbal: the gimbal that the flight controller manages; None without one.
        signing: signs what is sent, and refuses what isn't signed; None for a link without signatures.

    Attributes:
        telemetry: the autopilot's reported state.
        parameters: progress of setting the parameters.
        fence: progress of the autopilot's own fence.
        rate: how often odometry comes; None where it isn't judged.
        acknowledged: the present command, once the autopilot has acknowledged it.
        refusal: why nothing is taken from this autopilot, as it is none that jezero flies, or "".
    """

    def __init__(
        self,
        system_id: int,
        parameters: Mapping[str, int | float] = MappingProxyType({}),
        *,
        on_hardware: bool = False,
        gimbal: GimbalClient | None = None,
        signing: Signing | None = None,
    ) -> None:
        self.telemetry = Telemetry()
        self.parameters = ParameterSetter(parameters)
        self.fence = FenceUpload(system_id)
        self.rate = OdometryRate() if on_hardware else None
        self._pair = PairedOdometry()
        self._fence_items = b""
        self.acknowledged: AutopilotCommand | None = None
        self.refusal = ""
        self._system_id = system_id
        self._gimbal = gimbal
        self._codec = MavlinkCodec(
            system_id,
            COMPONENT_ID,
            signing,
            peer=(system_id, AUTOPILOT_COMPONENT_ID),
            others=() if gimbal is None else GIMBAL_COMPONENT_IDS,
        )
        self._present: AutopilotCommand | None = None
        self._next_try_ns = 0
        self._tries = 0
        self._refusal = ""
        self._origin_request_wall_ns: int | None = None
        self._critical_request_wall_ns: int | None = None
        self._version_request_wall_ns: int | None = None
        self._statustext: tuple[int, str] = (0, "")
        """Id and text so far of the last STATUSTEXT, which may come in chunks."""
        self._handlers: dict[int, Callable[[MavMessage, TelemetryBatch], None]] = {
            dialect.MAVLINK_MSG_ID_ODOMETRY: self._on_odometry,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._on_local_position,
            dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._on_attitude,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._on_extended_sys_state,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._on_sys_status,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._on_origin,
            dialect.MAVLINK_MSG_ID_COMMAND_ACK: self._on_ack,
            dialect.MAVLINK_MSG_ID_STATUSTEXT: self._on_statustext,
            dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._on_setpoint_echo,
            dialect.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
            dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._on_distance,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._on_version,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST: self._on_fence_message,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._on_fence_message,
            dialect.MAVLINK_MSG_ID_MISSION_ACK: self._on_fence_message,
        }

    @property
    def malformed(self) -> int:
        """Number of byte sequences that were no message, and of messages with impossible numbers."""
        return self._codec.malformed

    @property
    def bad_signatures(self) -> int:
        """Number of messages that were refused, as they had no valid signature."""
        return self._codec.bad_signatures

    @property
    def unchecked_signatures(self) -> int:
        """Number of signed messages of the autopilot on a link without signatures."""
        return self._codec.unchecked_signatures

    @property
    def other_system_id(self) -> int | None:
        """System id of another autopilot on the link, from which nothing is taken; None without one."""
        other = self._codec.other_sender
        return other[0] if other is not None and other[1] == AUTOPILOT_COMPONENT_ID else None

    def reset(self) -> None:
        """Start again with another vehicle, about which nothing is known."""
        self.telemetry = Telemetry()
        self.parameters.restart()
        self.fence.restart()
        self.command(None, 0)
        self._origin_request_wall_ns = self._critical_request_wall_ns = self._version_request_wall_ns = None
        if self.rate is not None:
            self.rate.restart()

    def command_failure(self, timer_ns: int) -> str:
        """The autopilot's reason for refusing the present command, with its own warning; "" without one."""
        if not (self._refusal or self.telemetry.warning):
            return ""
        warning = self.warning(timer_ns)
        return f"{self._refusal}; {warning}" if self._refusal and warning else self._refusal or warning

    def warning(self, timer_ns: int) -> str:
        """The autopilot's recent warning, "" without one."""
        recent = timer_ns - self.telemetry.warning_ns <= WARNING_MAX_AGE_NS
        return self.telemetry.warning if recent else ""

    # -- in --

    def receive(self, data: bytes, timer_ns: int, wall_ns: int, epoch_id: int) -> TelemetryBatch:
        """Update the telemetry with the bytes that arrived."""
        batch = TelemetryBatch(timer_ns, wall_ns, epoch_id)
        for message in self._codec.parse(data):
            kind = message.get_msgId()
            handler = self._handlers.get(kind)
            if self._gimbal is not None and self._on_gimbal(self._gimbal, message, batch):
                continue
            self.telemetry.received_wall_ns = wall_ns
            if handler is not None and (not self.refusal or kind == dialect.MAVLINK_MSG_ID_HEARTBEAT):
                handler(message, batch)
        return batch

    def _on_gimbal(self, gimbal: GimbalClient, message: MavMessage, batch: TelemetryBatch) -> bool:
        """Take in a message about the gimbal; returns whether it is one, or another of a gimbal itself."""
        odometry, kind = self.telemetry.odometry, message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS:
            gimbal.on_status(message)
        elif kind == dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS:
            try:
                if odometry is not None:
                    attitude = gimbal.on_attitude(message, odometry.t_ns, odometry.q_ned_from_frd, batch.wall_ns)
                    batch.camera.append(attitude)
            except ValueError:
                self._codec.malformed += 1
        else:
            return bool(message.get_srcComponent() != AUTOPILOT_COMPONENT_ID)
        return True

    def _on_odometry(self, message: MavMessage, batch: TelemetryBatch) -> None:
        try:
            self._take_odometry(_odometry_of(message), batch)
        except ValueError:
            self._codec.malformed += 1

    def _on_attitude(self, message: MavMessage, _batch: TelemetryBatch) -> None:
        if not self._is_narrow:
            return
        rates_rps = (message.rollspeed, message.pitchspeed, message.yawspeed)
        try:
            q = quat_normalize((message.q1, message.q2, message.q3, message.q4))
        except ValueError:
            self._codec.malformed += 1
            return
        if not _is_small(_ZERO, _ZERO, rates_rps):
            self._codec.malformed += 1
            return
        self._pair.on_attitude(message.time_boot_ms * NS_PER_MS, q, rates_rps)

    def _on_local_position(self, message: MavMessage, batch: TelemetryBatch) -> None:
        if not self._is_narrow:
            return
        t_ns = message.time_boot_ms * NS_PER_MS
        pos, vel = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
        if not _is_small(pos, vel, _ZERO):
            self._codec.malformed += 1
        elif (attitude := self._pair.on_position(t_ns, pos, vel)) is not None:
            self._take_odometry(_Odometry(t_ns, pos, vel, *attitude, None, self._pair.reset_counter), batch)

    @property
    def _is_narrow(self) -> bool:
        return self.rate is not None and self.rate.narrow

    def _take_odometry(self, contents: "_Odometry", batch: TelemetryBatch) -> None:
        t_ns, pos, vel, q, rates, std_pos_m, reset_counter = contents
        last = self.telemetry.odometry
        if last is not None and t_ns <= last.t_ns:
            if last.t_ns - t_ns <= RESTART_STEP_NS:
                return
            batch.restarted = True
            batch.odometry.clear()
            batch.steps_ned_m.clear()
            received_wall_ns = self.telemetry.received_wall_ns
            self.reset()
            self.telemetry.received_wall_ns = received_wall_ns
        resets = self.telemetry.resets
        step = resets.update(t_ns, reset_counter, pos, vel)
        if step is not None:
            batch.steps_ned_m.append(step)
        odometry = Odometry(
            t_ns=t_ns,
            epoch_id=batch.epoch_id,
            pos_uav_ned_m=pos,
            vel_uav_ned_mps=vel,
            q_ned_from_frd=q,
            rates_uav_frd_rps=rates,
            std_pos_m=std_pos_m,
            origin_deg=self.telemetry.origin_deg,
            reset_counter=resets.counter,
            reset_offset_ned_m=resets.offset_ned_m,
        )
        if self.rate is not None:
            self.rate.add(batch.wall_ns)
        self.telemetry.odometry = odometry
        batch.odometry.append(odometry)

    def _on_heartbeat(self, message: MavMessage, batch: TelemetryBatch) -> None:
        if refusal := autopilot_refusal(message.autopilot):
            self.refusal = refusal
            self.telemetry = Telemetry(received_wall_ns=batch.wall_ns)  # its modes and numbers would be misread
            return
        self.refusal = ""
        self.telemetry.heartbeat_wall_ns = batch.wall_ns
        self.telemetry.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        self.telemetry.mode = mode_name(message.custom_mode)
        self.telemetry.failsafe = message.system_status in _FAILSAFE_STATES

    def _on_extended_sys_state(self, message: MavMessage, _batch: TelemetryBatch) -> None:
        undefined = message.landed_state == dialect.MAV_LANDED_STATE_UNDEFINED
        self.telemetry.landed = None if undefined else message.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND

    def _on_setpoint_echo(self, message: MavMessage, batch: TelemetryBatch) -> None:
        batch.setpoint_echo = _setpoint_echo_of(message)

    def _on_parameter(self, message: MavMessage, _batch: TelemetryBatch) -> None:
        name = _text_of(message.param_id)
        self.parameters.confirm(name, message.param_value, message.param_type)
        if name == BATTERY_CRITICAL and 0.0 <= message.param_value <= 1.0:
            self.telemetry.battery_critical = round(message.param_value, 6)

    def _on_sys_status(self, message: MavMessage, _batch: TelemetryBatch) -> None:
        bit = dialect.MAV_SYS_STATUS_PREARM_CHECK
        healthy = message.onboard_control_sensors_health  # PX4 never says that the check is present
        self.telemetry.armable = bool(healthy & bit)
        if message.voltage_battery == 0xFFFF:
            self.telemetry.battery = None
            return
        remaining = message.battery_remaining
        self.telemetry.battery = Battery(
            voltage_v=message.voltage_battery * 1e-3,
            remaining=remaining / 100.0 if 0 <= remaining <= 100 else None,
            critical=self.telemetry.battery_critical,
        )

    def _on_origin(self, message: MavMessage, _batch: TelemetryBatch) -> None:
        latitude_deg, longitude_deg = message.latitude * 1e-7, message.longitude * 1e-7
        altitude_m = message.altitude * 1e-3
        if abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and abs(altitude_m) <= 1e5:
            self.telemetry.origin_deg = (latitude_deg, longitude_deg, altitude_m)

    def _on_statustext(self, message: MavMessage, batch: TelemetryBatch) -> None:
        text = _text_of(message.text)
        last_id, before = self._statustext
        if message.id != 0 and message.chunk_seq > 0 and message.id == last_id:
            text = (before + text)[:1000]
        self._statustext = (message.id, text)
        if message.severity <= dialect.MAV_SEVERITY_WARNING:
            self.telemetry.warning = text
            self.telemetry.warning_ns = batch.timer_ns

    def _is_for_us(self, message: MavMessage) -> bool:
        """Whether a reply is to this bridge, and not to another program on a network of MAVLink."""
        return (message.target_system, message.target_component) == (self._system_id, COMPONENT_ID)

    def _on_ack(self, message: MavMessage, batch: TelemetryBatch) -> None:
        command = self._present
        if (
            command is None
            or message.command != _COMMANDS[command][0]
            or self._tries == 0
            or not self._is_for_us(message)
        ):
            return
        if message.result in (dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_IN_PROGRESS):
            self.acknowledged = command
            self._refusal = ""
            self._next_try_ns = batch.timer_ns + EFFECT_TIMEOUT_NS
        else:
            self._refusal = f"{command} {_RESULTS.get(message.result, f'refused with result {message.result}')}"

    def _on_timesync(self, message: MavMessage, batch: TelemetryBatch) -> None:
        if message.tc1 != 0:  # else it is a request of the autopilot, which needs no reply to fly
            batch.time_replies.append((message.tc1, message.ts1))

    def _on_version(self, message: MavMessage, _batch: TelemetryBatch) -> None:
        self.telemetry.version = message.flight_sw_version

    def _on_distance(self, message: MavMessage, batch: TelemetryBatch) -> None:
        """A range without its limits met nothing, and one of quality 1 is invalid."""
        t_ns, last = message.time_boot_ms * 1_000_000, self.telemetry.altimeter
        if message.orientation != dialect.MAV_SENSOR_ROTATION_PITCH_270 or (last is not None and t_ns == last.t_ns):
            return
        valid = message.min_distance <= message.current_distance <= message.max_distance and message.signal_quality != 1
        range_m = 0.01 * message.current_distance if valid and message.current_distance > 0 else None
        self.telemetry.altimeter = altimeter = Altimeter(t_ns=t_ns, range_m=range_m)
        batch.altimeter.append(altimeter)

    def _on_fence_message(self, message: MavMessage, batch: TelemetryBatch) -> None:
        if self._is_for_us(message) and (item := self.fence.on_message(message, batch.timer_ns)) is not None:
            self._fence_items += self._codec.pack(item)

    # -- out --

    def heartbeat(self) -> bytes:
        """The bridge's own HEARTBEAT, due once per second."""
        return self._codec.pack(
            dialect.MAVLink_heartbeat_message(
                dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
            )
        )

    def request_time(self, host_ns: int) -> bytes:
        """TIMESYNC, whose reply holds the autopilot's time and this time stamp."""
        return self._codec.pack(dialect.MAVLink_timesync_message(0, host_ns))

    def request_heartbeat(self, wall_ns: int) -> bytes:
        """Request a HEARTBEAT unless the last is fresh enough; for use in flight."""
        if wall_ns - self.telemetry.heartbeat_wall_ns < HEARTBEAT_MAX_AGE_NS:
            return b""
        self.telemetry.heartbeat_wall_ns = wall_ns
        return self._request_message(dialect.MAVLINK_MSG_ID_HEARTBEAT)

    def request_origin(self, wall_ns: int) -> bytes:
        """Request GPS_GLOBAL_ORIGIN when that is due."""
        known, last_ns = self.telemetry.origin_deg is not None, self._origin_request_wall_ns
        period_ns = ORIGIN_KNOWN_PERIOD_NS if known else ORIGIN_MISSING_PERIOD_NS
        if last_ns is not None and wall_ns - last_ns < period_ns:
            return b""
        self._origin_request_wall_ns = wall_ns
        return self._request_message(dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)

    def request_battery_critical(self, wall_ns: int) -> bytes:
        """Request the battery's critical level when that is due."""
        last_ns = self._critical_request_wall_ns
        if self.telemetry.battery_critical is not None:
            return b""
        if last_ns is not None and wall_ns - last_ns < CRITICAL_MISSING_PERIOD_NS:
            return b""
        self._critical_request_wall_ns = wall_ns
        name = BATTERY_CRITICAL.encode("ascii")
        request = dialect.MAVLink_param_request_read_message(self._system_id, AUTOPILOT_COMPONENT_ID, name, -1)
        return self._codec.pack(request)

    def request_version(self, wall_ns: int) -> bytes:
        """Request the version of a real flight controller when that is due."""
        last_ns = self._version_request_wall_ns
        if self.rate is None or self.telemetry.version is not None:
            return b""
        if last_ns is not None and wall_ns - last_ns < VERSION_MISSING_PERIOD_NS:
            return b""
        self._version_request_wall_ns = wall_ns
        return self._request_message(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)

    def request_intervals(self) -> bytes:
        """Request the telemetry that the bridge needs."""
        command = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
        hardware_us = NARROW_INTERVALS_US if self._is_narrow else HARDWARE_INTERVALS_US
        intervals_us = INTERVALS_US if self.rate is None else hardware_us
        if self._gimbal is not None:
            intervals_us = intervals_us | GIMBAL_INTERVALS_US
        return b"".join(self._command_long(command, float(kind), float(us)) for kind, us in intervals_us.items())

    def point_camera(self, wall_ns: int) -> bytes:
        """Messages to the gimbal that are due."""
        odometry = self.telemetry.odometry
        if self._gimbal is None or odometry is None:
            return b""
        return b"".join(self._codec.pack(each) for each in self._gimbal.due(odometry.q_ned_from_frd, wall_ns))

    def set_parameters(self, wall_ns: int) -> bytes:
        """PARAM_SET of each parameter that is due."""
        return b"".join(
            self._codec.pack(
                dialect.MAVLink_param_set_message(
                    self._system_id, AUTOPILOT_COMPONENT_ID, name.encode("ascii"), value, kind
                )
            )
            for name, value, kind in self.parameters.due(wall_ns)
        )

    def send_fence(self, timer_ns: int) -> bytes:
        """Messages that give the autopilot its fence, when they are due."""
        data, self._fence_items = self._fence_items, b""
        announcement = self.fence.due(timer_ns)
        return data if announcement is None else data + self._codec.pack(announcement)

    def setpoint(self, target: Target, t_ns: int) -> bytes:
        """SET_POSITION_TARGET_LOCAL_NED of a target."""
        pos, vel, acc = target.pos_ned_m, target.vel_ned_mps, target.acc_ned_mps2
        mask = _MASK_YAW_RATE if target.yaw_rate_rps is None else 0
        mask |= _MASK_POS if pos is None else 0
        mask |= _MASK_VEL if vel is None else 0
        mask |= _MASK_ACC if acc is None else 0
        x, y, z = pos or _ZERO
        vx, vy, vz = vel or _ZERO
        afx, afy, afz = acc or _ZERO
        motion = (x, y, z, vx, vy, vz, afx, afy, afz, target.yaw_rad, target.yaw_rate_rps or 0.0)
        t_ms = (t_ns // 1_000_000) & 0xFFFFFFFF
        return self._codec.pack_numbers(
            _SETPOINT, t_ms, *motion, mask, self._system_id, AUTOPILOT_COMPONENT_ID, _LOCAL_NED
        )

    def command(self, command: AutopilotCommand | None, timer_ns: int) -> bytes:
        """Bytes that are due now for a command; call it in each step with the same command until it has an effect."""
        if command is not self._present:
            self._present = command
            self.acknowledged = None
            self._refusal = ""
            self._next_try_ns = timer_ns
            self._tries = 0
        if command is None or timer_ns < self._next_try_ns:
            return b""
        self._next_try_ns = timer_ns + ACK_TIMEOUT_NS
        number, parameters = _COMMANDS[command]
        data = self._command_long(number, *parameters, confirmation=min(self._tries, 255))
        self._tries += 1
        return data

    def _request_message(self, message_id: int) -> bytes:
        return self._command_long(dialect.MAV_CMD_REQUEST_MESSAGE, float(message_id), 0.0)

    def _command_long(self, number: int, p1: float, p2: float, p3: float = 0.0, *, confirmation: int = 0) -> bytes:
        return self._codec.pack(
            dialect.MAVLink_command_long_message(
                self._system_id, AUTOPILOT_COMPONENT_ID, number, confirmation, p1, p2, p3, 0.0, 0.0, 0.0, 0.0
            )
        )


VERSION_MIN = (1, 15)
"""Oldest PX4 that was flown. Older ones are refused: the vehicle is landed by their failsafes when this computer fails,
and nobody should learn in flight whether they do."""
VERSION_MAX = (1, 18)
"""Newest PX4 that was flown, as its development version of March 2026. A newer one may fly: what the bridge needs of it
has been the same through all of these, and what is missing is named."""


def autopilot_refusal(kind: int) -> str:
    """Reason why jezero doesn't fly an autopilot, or "".

    Args:
        kind: HEARTBEAT.autopilot.
    """
    if kind == dialect.MAV_AUTOPILOT_PX4:
        return ""
    if kind == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return (
            "the flight controller runs ArduPilot, and jezero flies PX4 only: ArduPilot sends no ODOMETRY and no "
            "counter of position resets, and numbers its modes in another way. Install PX4 on it"
        )
    return f"the flight controller runs no PX4 (its HEARTBEAT names autopilot {kind}), and jezero flies PX4 only"


def version_text(version: int) -> str:
    """Name of a version for people, with a warning about one that wasn't flown.

    Args:
        version: AUTOPILOT_VERSION.flight_sw_version: major, minor, patch and type, a byte each.
    """
    if version == 0:
        return "the flight controller doesn't name its version"
    major, minor, patch = version >> 24, version >> 16 & 0xFF, version >> 8 & 0xFF
    name = f"PX4 {major}.{minor}.{patch}"
    if (major, minor) > VERSION_MAX:
        return f"{name}, which jezero was not tried with: try everything with the propellers off first"
    return name


def version_refusal(version: int | None) -> str:
    """Reason why nothing takes off with this version, or "".

    Args:
        version: as in `version_text`; None while it isn't known.
    """
    if not version or (version >> 24, version >> 16 & 0xFF) >= VERSION_MIN:
        return ""
    oldest = ".".join(map(str, VERSION_MIN))
    return f"the flight controller has {version_text(version)}, which was never tried: install {oldest} or newer"


# -- contents of messages --------------------------------------------------------------------------------


class _Odometry(NamedTuple):
    """Contents of an ODOMETRY: position, velocity and attitude in world NED, body rates in FRD.

    Attributes:
        std_pos_m: horizontal standard deviation of the position; None where it isn't known.
        reset_counter: 0–255.
    """

    t_ns: int
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    q_ned_from_frd: Quat
    rates_frd_rps: Vec3
    std_pos_m: float | None
    reset_counter: int


def _is_small(pos_m: Vec3, vel_mps: Vec3, rates_rps: Vec3) -> bool:
    """Whether the numbers are finite and those of a vehicle."""
    (x, y, z), (vx, vy, vz), (p, q, r) = pos_m, vel_mps, rates_rps
    return x * x + y * y + z * z <= 1e10 and vx * vx + vy * vy + vz * vz <= 1e6 and p * p + q * q + r * r <= 1e6


def _odometry_of(message: MavMessage) -> _Odometry:
    """Contents of an ODOMETRY.

    Raises:
        ValueError: a number is not finite or out of its range, or a frame is unknown.
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
    if not _is_small(pos, vel, rates):  # or NaN
        raise ValueError("not finite, or out of range")
    variance_m2 = max(var_north_m2, var_east_m2)
    std_m = sqrt(variance_m2) if 0.0 <= variance_m2 <= 1e12 else None
    return _Odometry(t_ns, pos, vel, attitude, rates, std_m, counter)


def _setpoint_echo_of(message: MavMessage) -> SetpointEcho:
    """Echo in a POSITION_TARGET_LOCAL_NED, with NaN in each masked axis."""
    fields = ("x", "y", "z", "vx", "vy", "vz")
    x, y, z, vx, vy, vz = (nan if message.type_mask >> i & 1 else getattr(message, f) for i, f in enumerate(fields))
    return SetpointEcho(message.time_boot_ms * 1_000_000, (x, y, z), (vx, vy, vz))


def _text_of(field: str | bytes) -> str:
    """A MAVLink string without its padding."""
    return (field if isinstance(field, str) else field.decode("utf-8", "replace")).rstrip("\0")
