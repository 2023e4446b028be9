"""The autopilot's MAVLink links to the vehicle bridge and to ground stations.

Streams have PX4's messages, units and frames; rates can be set with SET_MESSAGE_INTERVAL.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import nan

from jezero.frames import Quat, Vec3, geodetic_from_ned
from jezero.mavlink import MavlinkCodec, MavMessage, dialect

STATUSTEXT_CHARACTERS = 50
PREARM = dialect.MAV_SYS_STATUS_PREARM_CHECK
SENSORS = (
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | dialect.MAV_SYS_STATUS_SENSOR_3D_MAG
    | dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | dialect.MAV_SYS_STATUS_SENSOR_GPS
)
UNKNOWN_VOLTAGE = 0xFFFF
UNKNOWN_COVARIANCE = [nan] * 21
UNKNOWN_APPROACH = (nan, nan, nan)

OFFBOARD_INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000,
    dialect.MAVLINK_MSG_ID_ODOMETRY: 20_000,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 100_000,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 200_000,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 500_000,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1_000_000,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 1_000_000,
}
GCS_INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 500_000,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1_000_000,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1_000_000,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 2_000_000,
}


@dataclass(frozen=True)
class Snapshot:
    """All that telemetry tells, at one instant. Position and velocity are local NED; `estimated` says they are valid.

    Attributes:
        custom_mode: as HEARTBEAT carries it.
        armable: every arming check passes.
        var_pos_ned_m2: (3,) variance of the position.
        home_ned_m: where the vehicle last armed; before that, where its estimator started.
    """

    t_us: int
    armed: bool
    failsafe: bool
    custom_mode: int
    landed: bool
    armable: bool
    estimated: bool
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    q_ned_from_frd: Quat
    rates_frd_rps: Vec3
    var_pos_ned_m2: Vec3
    reset_counter: int
    origin_deg: Vec3 | None
    home_ned_m: Vec3


class TelemetryLink:
    """One link: its streams, and the messages on it that are meant for this autopilot."""

    def __init__(self, system_id: int, intervals_us: dict[int, int]) -> None:
        self._system_id = system_id
        self._codec = MavlinkCodec(system_id, dialect.MAV_COMP_ID_AUTOPILOT1)
        self._default_us = intervals_us
        self._interval_us = dict(intervals_us)
        self._due_us = dict.fromkeys(intervals_us, 0)
        self._next_us = 0
        self._told: tuple[int, bool, bool] | None = None
        self._text_id = 0

    @property
    def malformed(self) -> int:
        """Stretches of bytes that were no message."""
        return self._codec.malformed

    def receive(self, data: bytes) -> list[MavMessage]:
        """Messages for this autopilot, or for everybody."""
        return [message for message in self._codec.parse(data) if self._is_for_us(message)]

    def _is_for_us(self, message: MavMessage) -> bool:
        return getattr(message, "target_system", 0) in {0, self._system_id} and getattr(
            message, "target_component", 0
        ) in {0, dialect.MAV_COMP_ID_AUTOPILOT1}

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """Change a stream's rate: 0 is its default, -1 stops it; False when there is no such stream."""
        if message_id not in _MAKERS:
            return False
        if interval_us < 0.0:
            self._interval_us.pop(message_id, None)
            return True
        default_us = self._default_us.get(message_id, 1_000_000)
        self._interval_us[message_id] = default_us if interval_us == 0.0 else max(4_000, int(interval_us))
        self._due_us.setdefault(message_id, 0)
        self._next_us = 0
        return True

    def request(self, message_id: int, now: Snapshot) -> bytes | None:
        """One message now, b"" when it can't be told yet, None when there is no such message."""
        maker = _MAKERS.get(message_id)
        if maker is None:
            return None
        message = maker(now)
        return b"" if message is None else self._codec.pack(message)

    def is_due(self, t_us: int, state: tuple[int, bool, bool]) -> bool:
        """Whether `stream` has something to tell. `state` is the custom mode, armed, landed."""
        return state != self._told or t_us >= self._next_us

    def stream(self, now: Snapshot) -> bytes:
        """What is due, and at once what changed."""
        state = (now.custom_mode, now.armed, now.landed)
        if state != self._told:
            self._told = state
            self._due_us[dialect.MAVLINK_MSG_ID_HEARTBEAT] = 0
            self._due_us[dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] = 0
            self._due_us[dialect.MAVLINK_MSG_ID_HOME_POSITION] = 0
        data = b""
        for message_id, interval_us in self._interval_us.items():
            if now.t_us < self._due_us[message_id]:
                continue
            late_us = now.t_us - self._due_us[message_id]
            self._due_us[message_id] = now.t_us + interval_us - (late_us if late_us < interval_us else 0)
            message = _MAKERS[message_id](now)
            if message is not None:
                data += self._codec.pack(message)
        self._next_us = min((self._due_us[message_id] for message_id in self._interval_us), default=now.t_us)
        return data

    def acknowledge(self, command: MavMessage, result: int) -> bytes:
        """COMMAND_ACK to whoever sent it."""
        return self._codec.pack(
            dialect.MAVLink_command_ack_message(
                command.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            )
        )

    def text(self, severity: int, text: str) -> bytes:
        """STATUSTEXT, in several chunks when it is long."""
        raw = text.encode("ascii", "replace")
        chunks = [raw[i : i + STATUSTEXT_CHARACTERS] for i in range(0, len(raw), STATUSTEXT_CHARACTERS)]
        text_id = 0
        if len(chunks) > 1:
            self._text_id = text_id = self._text_id % 65_535 + 1
        return b"".join(
            self._codec.pack(dialect.MAVLink_statustext_message(severity, chunk, text_id, number))
            for number, chunk in enumerate(chunks)
        )


def _heartbeat(now: Snapshot) -> MavMessage:
    base_mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
    base_mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if now.armed else 0
    state = dialect.MAV_STATE_ACTIVE if now.armed else dialect.MAV_STATE_STANDBY
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_AUTOPILOT_PX4,
        base_mode,
        now.custom_mode,
        dialect.MAV_STATE_CRITICAL if now.failsafe else state,
        3,
    )


def _odometry(now: Snapshot) -> MavMessage | None:
    if not now.estimated:
        return None
    covariance = list(UNKNOWN_COVARIANCE)
    covariance[0], covariance[6], covariance[11] = now.var_pos_ned_m2
    return dialect.MAVLink_odometry_message(
        now.t_us,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_LOCAL_NED,
        *now.pos_ned_m,
        now.q_ned_from_frd,
        *now.vel_ned_mps,
        *now.rates_frd_rps,
        covariance,
        UNKNOWN_COVARIANCE,
        now.reset_counter % 256,
        dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100,
    )


def _local_position(now: Snapshot) -> MavMessage | None:
    if not now.estimated:
        return None
    t_ms = (now.t_us // 1000) & 0xFFFFFFFF
    return dialect.MAVLink_local_position_ned_message(t_ms, *now.pos_ned_m, *now.vel_ned_mps)


def _extended_sys_state(now: Snapshot) -> MavMessage:
    landed = dialect.MAV_LANDED_STATE_ON_GROUND if now.landed else dialect.MAV_LANDED_STATE_IN_AIR
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, landed)


def _sys_status(now: Snapshot) -> MavMessage:
    """There is no battery to measure: its voltage, current and charge are unknown."""
    healthy = SENSORS | (PREARM if now.armable else 0)
    return dialect.MAVLink_sys_status_message(
        SENSORS | PREARM, SENSORS | PREARM, healthy, 0, UNKNOWN_VOLTAGE, -1, -1, 0, 0, 0, 0, 0, 0
    )


def _global_origin(now: Snapshot) -> MavMessage | None:
    if now.origin_deg is None:
        return None
    latitude_deg, longitude_deg, altitude_m = now.origin_deg
    return dialect.MAVLink_gps_global_origin_message(
        round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_m * 1e3), now.t_us
    )


def _home_position(now: Snapshot) -> MavMessage | None:
    if now.origin_deg is None:
        return None
    latitude_deg, longitude_deg, altitude_m = geodetic_from_ned(now.home_ned_m, now.origin_deg)
    return dialect.MAVLink_home_position_message(
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        round(altitude_m * 1e3),
        *now.home_ned_m,
        [nan] * 4,
        *UNKNOWN_APPROACH,
        now.t_us,
    )


_MAKERS: dict[int, Callable[[Snapshot], MavMessage | None]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _global_origin,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
}
