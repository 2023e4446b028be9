"""Handles received MAVLink messages: setpoints, commands, parameters, a geofence; refuses files and missions.

Source: MAVLink common dialect; of the geofence https://mavlink.io/en/services/mission.html.
"""

import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, radians

from jezero.base.frames import Vec3, ned_from_geodetic, rotate_yaw, z_ned_m
from jezero.base.mavlink import MavMessage, dialect, is_finite
from jezero.services.autopilot.control import Axes, ControlSetpoint
from jezero.services.autopilot.modes import FROM_MAIN_AND_SUB, Mode
from jezero.services.autopilot.parameters import Parameters, Value
from jezero.services.autopilot.telemetry import GCS, TelemetryLink
from jezero.services.autopilot.vehicle import AutopilotVehicle

FORCE_DISARM = 21196.0
REPOSITION_CHANGES_MODE = 1
FTP_NAK, FTP_UNKNOWN_COMMAND, FTP_HEADER = 129, 7, struct.Struct("<HBBBBBxI")
FTP_PAYLOAD = 251
REPOSITION_MAX_M = 10_000.0
FENCE_TYPE = dialect.MAV_MISSION_TYPE_FENCE
FENCE_ITEMS_MAX = 1000
FENCE_VERTICES = (
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
MISSION_UNSUPPORTED = dialect.MAV_MISSION_UNSUPPORTED
ACCEPTED = int(dialect.MAV_RESULT_ACCEPTED)
DENIED = int(dialect.MAV_RESULT_DENIED)
REJECTED = int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
UNSUPPORTED = int(dialect.MAV_RESULT_UNSUPPORTED)
GLOBAL_FRAMES = (dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT)
RELATIVE_FRAMES = (dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
MESSAGE_OF_COMMAND = {
    dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    dialect.MAV_CMD_GET_HOME_POSITION: dialect.MAVLINK_MSG_ID_HOME_POSITION,
}
"""Commands that request one message each, like MAV_CMD_REQUEST_MESSAGE."""


@dataclass(frozen=True)
class ReceivedCommand:
    """A COMMAND_LONG, COMMAND_INT or SET_MODE.

    Attributes:
        params: (4,) the first four parameters.
        position_deg: (latitude_deg, longitude_deg, altitude_m) of a command that carries a position.
        relative: whether the altitude is relative to home.
    """

    number: int
    params: tuple[float, float, float, float]
    position_deg: Vec3
    relative: bool = False

    def are_finite(self, *indices: int) -> bool:
        """Whether the parameters with these indices are finite."""
        return all(isfinite(self.params[i]) for i in indices)


class MavlinkReceiver:
    """Handles the messages of all links for one vehicle."""

    def __init__(self, vehicle: AutopilotVehicle, parameters: Parameters) -> None:
        self._vehicle = vehicle
        self._parameters = parameters
        self._fence = StoredFence()
        self._forced_disarm = ForcedDisarmRule(parameters.config.telemetry.force_disarm_systems)
        self._handlers = {
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command_long,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._on_command_int,
            dialect.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_parameter_list,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_parameter_read,
            dialect.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter_set,
            dialect.MAVLINK_MSG_ID_PING: self._on_ping,
            dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_ATTITUDE: self._on_gimbal_attitude,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _refuse_files,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _send_empty_mission,
            dialect.MAVLINK_MSG_ID_MISSION_COUNT: _refuse_mission,
        }
        self._fence_handlers = {
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._fence.send_count,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._fence.send_item,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST: self._fence.send_item,
            dialect.MAVLINK_MSG_ID_MISSION_COUNT: self._fence.on_count,
            dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._fence.on_item,
        }

        self._command_handlers: dict[int, Callable[[ReceivedCommand], int]] = {
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_or_disarm,
            dialect.MAV_CMD_DO_SET_MODE: self._set_mode,
            dialect.MAV_CMD_NAV_LAND: self._land,
            dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._return,
            dialect.MAV_CMD_NAV_TAKEOFF: self._take_off,
            dialect.MAV_CMD_DO_REPOSITION: self._reposition,
        }

    def handle(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Carry out a message; returns the bytes of the reply, which are empty for a message without one."""
        kind = message.get_msgId()
        if link.name == GCS and self._vehicle.landed:
            self._forced_disarm.on_message_on_ground(message.get_srcSystem())
        if kind == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            setpoint = offboard_setpoint(message, self._vehicle.estimator.yaw_rad)
            if setpoint is not None:
                self._vehicle.on_offboard_setpoint(setpoint)
        elif kind == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            if message.type == dialect.MAV_TYPE_GCS:
                self._vehicle.on_gcs_heartbeat()
        elif kind in self._fence_handlers and message.mission_type == FENCE_TYPE:
            return self._fence_handlers[kind](link, message)
        elif handler := self._handlers.get(kind):
            return handler(link, message)
        return b""

    # -- commands ------------------------------------------------------------------------------------------

    def _on_command_long(self, link: TelemetryLink, m: MavMessage) -> bytes:
        p = (m.param1, m.param2, m.param3, m.param4)
        return self._run(link, m, ReceivedCommand(m.command, p, (m.param5, m.param6, m.param7)))

    def _on_command_int(self, link: TelemetryLink, m: MavMessage) -> bytes:
        if m.frame in GLOBAL_FRAMES or m.frame in RELATIVE_FRAMES:
            position_deg: Vec3 = (m.x * 1e-7, m.y * 1e-7, m.z)
        else:
            position_deg = (float(m.x), float(m.y), m.z)
        p = (m.param1, m.param2, m.param3, m.param4)
        return self._run(link, m, ReceivedCommand(m.command, p, position_deg, relative=m.frame in RELATIVE_FRAMES))

    def _on_set_mode(self, link: TelemetryLink, m: MavMessage) -> bytes:
        main, sub = m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24 & 0xFF
        p = (float(m.base_mode), float(main), float(sub), 0.0)
        return self._run(link, m, ReceivedCommand(dialect.MAV_CMD_DO_SET_MODE, p, (0.0, 0.0, 0.0)))

    def _run(self, link: TelemetryLink, message: MavMessage, command: ReceivedCommand) -> bytes:
        """Carry out a command and acknowledge it."""
        number = command.number
        requested_id = MESSAGE_OF_COMMAND.get(number)
        if number == dialect.MAV_CMD_REQUEST_MESSAGE and command.are_finite(0):
            requested_id = int(command.params[0])
        if requested_id is not None:
            requested = link.build_message(requested_id, self._vehicle.snapshot())
            return requested + link.acknowledge(message, number, ACCEPTED if requested else DENIED)
        if number == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            known = command.are_finite(0, 1) and link.set_interval(int(command.params[0]), command.params[1])
            return link.acknowledge(message, number, ACCEPTED if known else UNSUPPORTED)
        if number == dialect.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            sender = (message.get_srcSystem(), message.get_srcComponent())
            given = self._vehicle.gimbal.configure((command.params[0], command.params[1]), sender)
            return link.acknowledge(message, number, ACCEPTED if given else DENIED)
        if self._stops_motors_in_air(command) and not self._may_stop_motors_in_air(link, message):
            return link.acknowledge(message, number, DENIED)
        return link.acknowledge(message, number, self._execute(command))

    def _stops_motors_in_air(self, command: ReceivedCommand) -> bool:
        """Whether a command is a forced disarm in the air."""
        forced = command.number == dialect.MAV_CMD_COMPONENT_ARM_DISARM and command.params[:2] == (0.0, FORCE_DISARM)
        return forced and self._vehicle.commander.armed and not self._vehicle.landed

    def _may_stop_motors_in_air(self, link: TelemetryLink, message: MavMessage) -> bool:
        """Whether the sender of a forced disarm in the air may have it; logs the sender in either case.

        The offboard link is the bridge's alone, which decides by itself when it stops the motors.
        """
        system_id, component_id = message.get_srcSystem(), message.get_srcComponent()
        sender = f"component {component_id} of MAVLink system {system_id} on the link {link.name!r}"
        refusal = self._forced_disarm.refusal(system_id) if link.name == GCS else ""
        if refusal:
            self._vehicle.commander.add_status_text(4, f"Forced disarm denied: {refusal}")
            self._forced_disarm.log(f"a forced disarm in the air by {sender} is denied: {refusal}")
        else:
            self._forced_disarm.log(f"disarmed by force in the air by {sender}")
        return not refusal

    def _execute(self, command: ReceivedCommand) -> int:
        """Carry out a command to the vehicle; returns a MAV_RESULT."""
        handler = self._command_handlers.get(command.number)
        return UNSUPPORTED if handler is None else handler(command)

    def _arm_or_disarm(self, command: ReceivedCommand) -> int:
        if command.params[0] == 1.0:
            return _result(self._vehicle.arm())
        return (
            _result(self._vehicle.disarm(force=command.params[1] == FORCE_DISARM))
            if command.params[0] == 0.0
            else DENIED
        )

    def _set_mode(self, command: ReceivedCommand) -> int:
        mode = _requested_mode(command)
        return DENIED if mode is None else _result(self._vehicle.set_mode(mode))

    def _land(self, command: ReceivedCommand) -> int:
        return _result(self._vehicle.set_mode(Mode.LAND))

    def _return(self, command: ReceivedCommand) -> int:
        return _result(self._vehicle.set_mode(Mode.RETURN))

    def _take_off(self, command: ReceivedCommand) -> int:
        vehicle, origin_deg = self._vehicle, self._vehicle.estimator.origin_deg
        if origin_deg is None:
            return REJECTED
        point_ned_m = self._command_point_ned_m(command, origin_deg)
        if point_ned_m is None:
            vehicle.commander.add_status_text(3, "Takeoff denied: position out of range; NaN keeps the present one")
            return DENIED
        return _result(vehicle.take_off(point_ned_m))

    def _command_point_ned_m(self, command: ReceivedCommand, origin_deg: Vec3) -> Axes | None:
        """Position of a command, an axis that it leaves open being None; None if the position is out of range."""
        latitude_deg, longitude_deg, altitude_m = command.position_deg
        north: float | None = None
        east: float | None = None
        down: float | None = None
        if isfinite(latitude_deg) and isfinite(longitude_deg):
            if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
                return None
            north, east, _ = ned_from_geodetic((latitude_deg, longitude_deg, origin_deg[2]), origin_deg)
        if isfinite(altitude_m):
            down = z_ned_m(altitude_m) + (self._vehicle.home_ned_m[2] if command.relative else origin_deg[2])
        far = any(axis is not None and abs(axis) > REPOSITION_MAX_M for axis in (north, east, down))
        return None if far else (north, east, down)

    def _reposition(self, command: ReceivedCommand) -> int:
        """Hold at another point; an axis that the command leaves open stays as it is."""
        vehicle, origin_deg = self._vehicle, self._vehicle.estimator.origin_deg
        if not command.are_finite(1) or not int(command.params[1]) & REPOSITION_CHANGES_MODE:
            return DENIED
        if origin_deg is None:
            return REJECTED
        point_ned_m = self._command_point_ned_m(command, origin_deg)
        if point_ned_m is None:
            return DENIED
        pos_ned_m = vehicle.estimator.pos_ned_m
        north, east, down = (
            present if target is None else target for target, present in zip(point_ned_m, pos_ned_m, strict=True)
        )
        yaw_rad = radians(command.params[3]) if command.are_finite(3) else None
        return _result(vehicle.reposition((north, east, down), yaw_rad))

    # -- parameters ----------------------------------------------------------------------------------------

    def _on_parameter_list(self, link: TelemetryLink, message: MavMessage) -> bytes:
        return b"".join(self._pack_parameter(link, name) for name in self._parameters.names)

    def _on_parameter_read(self, link: TelemetryLink, message: MavMessage) -> bytes:
        names, index = self._parameters.names, message.param_index
        if index >= 0:
            return self._pack_parameter(link, names[index]) if index < len(names) else b""
        return self._pack_parameter(link, _name(message))

    def _on_parameter_set(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Set a parameter; the reply is its value afterwards, or nothing if there is no such parameter."""
        name = _name(message)
        value = decode_parameter(message.param_value, message.param_type)
        old = self._parameters.get(name)
        if old is not None and (value is None or not self._vehicle.set_parameter(name, value)):
            return link.status_text(5, f"Parameter {name} stays {old:g}") + self._pack_parameter(link, name)
        return self._pack_parameter(link, name)

    def _pack_parameter(self, link: TelemetryLink, name: str) -> bytes:
        value = self._parameters.get(name)
        if value is None:
            return b""
        names = self._parameters.names
        raw, kind = encode_parameter(value)
        return link.pack(
            dialect.MAVLink_param_value_message(name.encode("ascii"), raw, kind, len(names), names.index(name))
        )

    # -- gimbal --------------------------------------------------------------------------------------------

    def _on_gimbal_attitude(self, _link: TelemetryLink, message: MavMessage) -> bytes:
        self._vehicle.gimbal.on_attitude(message, self._vehicle.estimator.q_ned_from_frd)
        return b""

    # -- ping and time -------------------------------------------------------------------------------------

    def _on_ping(self, link: TelemetryLink, m: MavMessage) -> bytes:
        if m.target_system != 0:
            return b""
        return link.pack(dialect.MAVLink_ping_message(m.time_usec, m.seq, m.get_srcSystem(), m.get_srcComponent()))

    def _on_timesync(self, link: TelemetryLink, m: MavMessage) -> bytes:
        return link.pack(dialect.MAVLink_timesync_message(self._vehicle.t_us * 1000, m.ts1)) if m.tc1 == 0 else b""


def _result(refusal: str) -> int:
    return REJECTED if refusal else ACCEPTED


def _requested_mode(command: ReceivedCommand) -> Mode | None:
    """Mode of a DO_SET_MODE; None if this autopilot does not have it."""
    if not command.are_finite(0, 1) or not int(command.params[0]) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return None
    return FROM_MAIN_AND_SUB.get((int(command.params[1]), int(command.params[2]) if command.are_finite(2) else 0))


def offboard_setpoint(message: MavMessage, yaw_now_rad: float) -> ControlSetpoint | None:
    """Setpoint of a SET_POSITION_TARGET_LOCAL_NED; None if it is empty, not finite, or in a frame that PX4 refuses."""
    mask = message.type_mask
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz")
    used = [name for bit, name in enumerate(names) if not mask >> bit & 1]
    yaw = None if mask & 1024 else message.yaw
    yaw_rate = None if mask & 2048 else message.yaw_rate
    turn = [name for name, value in (("yaw", yaw), ("yaw_rate", yaw_rate)) if value is not None]
    body = message.coordinate_frame == dialect.MAV_FRAME_BODY_NED
    if not (body or message.coordinate_frame == dialect.MAV_FRAME_LOCAL_NED) or not used:
        return None
    if not is_finite(message, *used, *turn) or (body and mask & 7 != 7):
        return None
    value: dict[str, float] = {name: getattr(message, name) for name in used}

    def axes(x: str, y: str, z: str) -> Axes:
        n, e, d = value.get(x), value.get(y), value.get(z)
        if body and (n is not None or e is not None):
            n, e, _ = rotate_yaw((n or 0.0, e or 0.0, 0.0), yaw_now_rad)
        return (n, e, d)

    return ControlSetpoint(axes("x", "y", "z"), axes("vx", "vy", "vz"), axes("afx", "afy", "afz"), yaw, yaw_rate)


# -- forced disarm in the air ----------------------------------------------------------------------------


class ForcedDisarmRule:
    """Decides whether a MAVLink system on the link of ground stations may disarm by force in the air.

    Ids are claimed there: anybody can write that of another system into a message.

    Args:
        listed: ids of the systems that may; none leaves it to those that sent something before the takeoff.
    """

    def __init__(self, listed: Sequence[int]) -> None:
        self._listed = frozenset(listed)
        self._seen: set[int] = set()
        self._logged: set[str] = set()
        """Sentences that are in the log since the takeoff: a flood of commands must not fill it."""

    def on_message_on_ground(self, system_id: int) -> None:
        """Note who sends something while the vehicle is landed."""
        self._seen.add(system_id)
        self._logged.clear()

    def refusal(self, system_id: int) -> str:
        """Why a system may not disarm by force in the air; "" when it may."""
        if system_id in (self._listed or self._seen):
            return ""
        if self._listed:
            return f"MAVLink system {system_id} is not in force_disarm_systems"
        return f"MAVLink system {system_id} sent nothing before the takeoff"

    def log(self, sentence: str) -> None:
        """Print a sentence into the log of the autopilot, once in a flight."""
        if sentence not in self._logged:
            self._logged.add(sentence)
            print(sentence, file=sys.stderr, flush=True)


# -- parameters ------------------------------------------------------------------------------------------


def _name(message: MavMessage) -> str:
    name = message.param_id if isinstance(message.param_id, str) else message.param_id.decode("ascii", "replace")
    return str(name).split("\0", maxsplit=1)[0]


def encode_parameter(value: Value) -> tuple[float, int]:
    """Float and type of a PARAM_VALUE. Like in PX4, an integer is sent as four bytes in the field of the float."""
    if isinstance(value, int):
        return float(struct.unpack("<f", struct.pack("<i", value))[0]), int(dialect.MAV_PARAM_TYPE_INT32)
    return value, int(dialect.MAV_PARAM_TYPE_REAL32)


def decode_parameter(raw: float, kind: int) -> Value | None:
    """Value of a PARAM_SET; None if no parameter has this type."""
    if kind == dialect.MAV_PARAM_TYPE_INT32:
        return int(struct.unpack("<i", struct.pack("<f", raw))[0])
    return float(raw) if kind == dialect.MAV_PARAM_TYPE_REAL32 else None


# -- the geofence ----------------------------------------------------------------------------------------


class StoredFence:
    """The geofence that ground stations and companions store here; it is kept and given back, not flown by.

    Attributes:
        items: the MISSION_ITEM_INT messages of the fence that was stored last.
    """

    def __init__(self) -> None:
        self.items: list[MavMessage] = []
        self._incoming: list[MavMessage] = []
        self._count = 0

    def on_count(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Begin an upload: request its first item."""
        if message.count > FENCE_ITEMS_MAX:
            return _acknowledge_fence(link, message, dialect.MAV_MISSION_NO_SPACE)
        self._incoming, self._count = [], message.count
        return self._request_next(link, message)

    def on_item(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Take an item, and request the next one."""
        if message.seq != len(self._incoming) or message.seq >= self._count:
            return b""  # a repetition of one that has come already
        if message.command not in FENCE_VERTICES:
            self._count = 0
            return _acknowledge_fence(link, message, dialect.MAV_MISSION_UNSUPPORTED)
        self._incoming.append(message)
        return self._request_next(link, message)

    def _request_next(self, link: TelemetryLink, message: MavMessage) -> bytes:
        number, sender = len(self._incoming), (message.get_srcSystem(), message.get_srcComponent())
        if number < self._count:
            return link.pack(dialect.MAVLink_mission_request_int_message(*sender, number, FENCE_TYPE))
        self.items, self._incoming, self._count = self._incoming, [], 0
        return _acknowledge_fence(link, message, dialect.MAV_MISSION_ACCEPTED)

    def send_count(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Reply to a download with the number of items."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        return link.pack(dialect.MAVLink_mission_count_message(*sender, len(self.items), FENCE_TYPE))

    def send_item(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Reply to a request for one item."""
        if message.seq >= len(self.items):
            return _acknowledge_fence(link, message, dialect.MAV_MISSION_INVALID_SEQUENCE)
        m, sender = self.items[message.seq], (message.get_srcSystem(), message.get_srcComponent())
        return link.pack(
            dialect.MAVLink_mission_item_int_message(
                *sender, m.seq, m.frame, m.command, 0, 1, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z,
                FENCE_TYPE,
            )
        )  # fmt: skip


def _acknowledge_fence(link: TelemetryLink, message: MavMessage, result: int) -> bytes:
    sender = (message.get_srcSystem(), message.get_srcComponent())
    return link.pack(dialect.MAVLink_mission_ack_message(*sender, result, FENCE_TYPE))


# -- files and missions, which are refused ---------------------------------------------------------------


def _refuse_files(link: TelemetryLink, m: MavMessage) -> bytes:
    """Reply to an FTP request: this autopilot has no files."""
    sequence, session, opcode, *_ = FTP_HEADER.unpack(bytes(m.payload[: FTP_HEADER.size]))
    nak = FTP_HEADER.pack((sequence + 1) & 0xFFFF, session, FTP_NAK, 1, opcode, 0, 0) + bytes([FTP_UNKNOWN_COMMAND])
    payload = list(nak.ljust(FTP_PAYLOAD, b"\0"))
    return link.pack(
        dialect.MAVLink_file_transfer_protocol_message(0, m.get_srcSystem(), m.get_srcComponent(), payload)
    )


def _send_empty_mission(link: TelemetryLink, m: MavMessage) -> bytes:
    """Reply to a mission download: there is no mission."""
    sender = (m.get_srcSystem(), m.get_srcComponent())
    return link.pack(dialect.MAVLink_mission_count_message(*sender, 0, m.mission_type))


def _refuse_mission(link: TelemetryLink, m: MavMessage) -> bytes:
    """Reply to a mission upload: missions are not supported."""
    sender = (m.get_srcSystem(), m.get_srcComponent())
    return link.pack(dialect.MAVLink_mission_ack_message(*sender, MISSION_UNSUPPORTED, m.mission_type))
