"""What others ask over MAVLink, and the answers: setpoints, commands, parameters, and what is politely refused."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, radians

from jezero.frames import Vec3, ned_from_geodetic, rotate_yaw, z_ned_m
from jezero.mavlink import MavMessage, dialect, is_finite
from jezero.services.autopilot.control import Axes, Setpoint
from jezero.services.autopilot.modes import FROM_MAIN_AND_SUB, Mode
from jezero.services.autopilot.parameters import Parameters, Value
from jezero.services.autopilot.telemetry import TelemetryLink
from jezero.services.autopilot.vehicle import Vehicle

FORCE = 21196.0
CHANGE_MODE = 1
FTP_NAK, FTP_UNKNOWN_COMMAND, FTP_HEADER = 129, 7, struct.Struct("<HBBBBBxI")
FTP_PAYLOAD = 251
REPOSITION_MAX_M = 10_000.0
MISSION_UNSUPPORTED = dialect.MAV_MISSION_UNSUPPORTED
ACCEPTED = int(dialect.MAV_RESULT_ACCEPTED)
DENIED = int(dialect.MAV_RESULT_DENIED)
REJECTED = int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
UNSUPPORTED = int(dialect.MAV_RESULT_UNSUPPORTED)
GLOBAL_FRAMES = (dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT)
RELATIVE_FRAMES = (dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
ASKS_FOR = {
    dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    dialect.MAV_CMD_GET_HOME_POSITION: dialect.MAVLINK_MSG_ID_HOME_POSITION,
}
"""Commands of their own for what REQUEST_MESSAGE also does."""


@dataclass(frozen=True)
class Command:
    """A COMMAND_LONG, COMMAND_INT or SET_MODE.

    Attributes:
        p: (4,) the first parameters.
        place_deg: (latitude_deg, longitude_deg, altitude_m) of the others, as far as they are a place.
        relative: the altitude counts from home.
    """

    number: int
    p: tuple[float, float, float, float]
    place_deg: Vec3
    relative: bool = False

    def has(self, *indices: int) -> bool:
        """Whether these of the first parameters are finite."""
        return all(isfinite(self.p[i]) for i in indices)


class Requests:
    """Carries out messages on a vehicle."""

    def __init__(self, vehicle: Vehicle, parameters: Parameters) -> None:
        self._vehicle = vehicle
        self._parameters = parameters
        self._answers = {
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command_long,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._on_command_int,
            dialect.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_parameter_list,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_parameter_read,
            dialect.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter_set,
            dialect.MAVLINK_MSG_ID_PING: self._on_ping,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _refuse_files,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _no_mission,
            dialect.MAVLINK_MSG_ID_MISSION_COUNT: _refuse_mission,
        }

        self._orders: dict[int, Callable[[Command], int]] = {
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_or_disarm,
            dialect.MAV_CMD_DO_SET_MODE: self._set_mode,
            dialect.MAV_CMD_NAV_LAND: self._land,
            dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._return,
            dialect.MAV_CMD_NAV_TAKEOFF: self._take_off,
            dialect.MAV_CMD_DO_REPOSITION: self._reposition,
        }

    def answer(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Do what a message asks; returns what to say to whoever sent it."""
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            setpoint = offboard_setpoint(message, self._vehicle.estimator.yaw_rad)
            if setpoint is not None:
                self._vehicle.stream(setpoint)
        elif kind == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            if message.type == dialect.MAV_TYPE_GCS:
                self._vehicle.hear_ground_station()
        elif handler := self._answers.get(kind):
            return handler(link, message)
        return b""

    # -- commands ------------------------------------------------------------------------------------------

    def _on_command_long(self, link: TelemetryLink, m: MavMessage) -> bytes:
        p = (m.param1, m.param2, m.param3, m.param4)
        return self._run(link, m, Command(m.command, p, (m.param5, m.param6, m.param7)))

    def _on_command_int(self, link: TelemetryLink, m: MavMessage) -> bytes:
        if m.frame in GLOBAL_FRAMES or m.frame in RELATIVE_FRAMES:
            place_deg: Vec3 = (m.x * 1e-7, m.y * 1e-7, m.z)
        else:
            place_deg = (float(m.x), float(m.y), m.z)
        p = (m.param1, m.param2, m.param3, m.param4)
        return self._run(link, m, Command(m.command, p, place_deg, relative=m.frame in RELATIVE_FRAMES))

    def _on_set_mode(self, link: TelemetryLink, m: MavMessage) -> bytes:
        main, sub = m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24 & 0xFF
        p = (float(m.base_mode), float(main), float(sub), 0.0)
        return self._run(link, m, Command(dialect.MAV_CMD_DO_SET_MODE, p, (0.0, 0.0, 0.0)))

    def _run(self, link: TelemetryLink, message: MavMessage, command: Command) -> bytes:
        """Do it, and acknowledge it."""
        number = command.number
        wanted = ASKS_FOR.get(number)
        if number == dialect.MAV_CMD_REQUEST_MESSAGE and command.has(0):
            wanted = int(command.p[0])
        if wanted is not None:
            known = link.knows(wanted)
            acknowledged = link.acknowledge(message, number, ACCEPTED if known else UNSUPPORTED)
            return acknowledged + link.request(wanted, self._vehicle.snapshot())
        if number == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            known = command.has(0, 1) and link.set_interval(int(command.p[0]), command.p[1])
            return link.acknowledge(message, number, ACCEPTED if known else UNSUPPORTED)
        return link.acknowledge(message, number, self._order(command))

    def _order(self, command: Command) -> int:
        """What moves the vehicle; returns the result."""
        handler = self._orders.get(command.number)
        return UNSUPPORTED if handler is None else handler(command)

    def _arm_or_disarm(self, command: Command) -> int:
        if command.p[0] == 1.0:
            return _result(self._vehicle.arm())
        return _result(self._vehicle.disarm(force=command.p[1] == FORCE)) if command.p[0] == 0.0 else DENIED

    def _set_mode(self, command: Command) -> int:
        mode = _asked_mode(command)
        return DENIED if mode is None else _result(self._vehicle.set_mode(mode))

    def _land(self, command: Command) -> int:
        return _result(self._vehicle.set_mode(Mode.LAND))

    def _return(self, command: Command) -> int:
        return _result(self._vehicle.set_mode(Mode.RETURN))

    def _take_off(self, command: Command) -> int:
        vehicle, origin_deg = self._vehicle, self._vehicle.estimator.origin_deg
        if origin_deg is None:
            return REJECTED
        point_ned_m = self._place(command, origin_deg)
        if point_ned_m is None:
            vehicle.commander.say(3, "Takeoff denied: the place is out of reach, and NaN means here")
            return DENIED
        return _result(vehicle.take_off(point_ned_m))

    def _place(self, command: Command, origin_deg: Vec3) -> Axes | None:
        """Where a command's place is, each axis None that it doesn't tell; no place at all when it is out of reach."""
        latitude_deg, longitude_deg, altitude_m = command.place_deg
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

    def _reposition(self, command: Command) -> int:
        """What is not given stays as it is."""
        vehicle, origin_deg = self._vehicle, self._vehicle.estimator.origin_deg
        if not command.has(1) or not int(command.p[1]) & CHANGE_MODE:
            return DENIED
        if origin_deg is None:
            return REJECTED
        place = self._place(command, origin_deg)
        if place is None:
            return DENIED
        here = vehicle.estimator.pos_ned_m
        north, east, down = (now if asked is None else asked for asked, now in zip(place, here, strict=True))
        yaw_rad = radians(command.p[3]) if command.has(3) else None
        return _result(vehicle.reposition((north, east, down), yaw_rad))

    # -- parameters ----------------------------------------------------------------------------------------

    def _on_parameter_list(self, link: TelemetryLink, message: MavMessage) -> bytes:
        return b"".join(self._tell(link, name) for name in self._parameters.names)

    def _on_parameter_read(self, link: TelemetryLink, message: MavMessage) -> bytes:
        names, index = self._parameters.names, message.param_index
        if index >= 0:
            return self._tell(link, names[index]) if index < len(names) else b""
        return self._tell(link, _name(message))

    def _on_parameter_set(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """The answer is the value that holds now, the new one or the old one; none when there is no such parameter."""
        name = _name(message)
        value = decoded(message.param_value, message.param_type)
        old = self._parameters.get(name)
        if old is not None and (value is None or not self._vehicle.set_parameter(name, value)):
            return link.text(5, f"Parameter {name} stays {old:g}") + self._tell(link, name)
        return self._tell(link, name)

    def _tell(self, link: TelemetryLink, name: str) -> bytes:
        value = self._parameters.get(name)
        if value is None:
            return b""
        names = self._parameters.names
        carried, kind = encoded(value)
        return link.pack(
            dialect.MAVLink_param_value_message(name.encode("ascii"), carried, kind, len(names), names.index(name))
        )

    # -- small talk ----------------------------------------------------------------------------------------

    def _on_ping(self, link: TelemetryLink, m: MavMessage) -> bytes:
        if m.target_system != 0:
            return b""
        return link.pack(dialect.MAVLink_ping_message(m.time_usec, m.seq, m.get_srcSystem(), m.get_srcComponent()))

    def _on_timesync(self, link: TelemetryLink, m: MavMessage) -> bytes:
        return link.pack(dialect.MAVLink_timesync_message(self._vehicle.t_us * 1000, m.ts1)) if m.tc1 == 0 else b""


def _result(refusal: str) -> int:
    return REJECTED if refusal else ACCEPTED


def _asked_mode(command: Command) -> Mode | None:
    """Of a DO_SET_MODE; None when it is none of PX4's, or none that this autopilot has."""
    if not command.has(0, 1) or not int(command.p[0]) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return None
    return FROM_MAIN_AND_SUB.get((int(command.p[1]), int(command.p[2]) if command.has(2) else 0))


def _name(message: MavMessage) -> str:
    name = message.param_id if isinstance(message.param_id, str) else message.param_id.decode("ascii", "replace")
    return str(name).split("\0", maxsplit=1)[0]


def encoded(value: Value) -> tuple[float, int]:
    """The float of a PARAM_VALUE, and its type: PX4 puts an integer's bytes in the place of the float's."""
    if isinstance(value, int):
        return float(struct.unpack("<f", struct.pack("<i", value))[0]), int(dialect.MAV_PARAM_TYPE_INT32)
    return value, int(dialect.MAV_PARAM_TYPE_REAL32)


def decoded(carried: float, kind: int) -> Value | None:
    """The value that a PARAM_SET carries, None when it has a type that no parameter has."""
    if kind == dialect.MAV_PARAM_TYPE_INT32:
        return int(struct.unpack("<i", struct.pack("<f", carried))[0])
    return float(carried) if kind == dialect.MAV_PARAM_TYPE_REAL32 else None


def offboard_setpoint(message: MavMessage, yaw_now_rad: float) -> Setpoint | None:
    """What SET_POSITION_TARGET_LOCAL_NED asks for; None when it is empty, not finite, or in a frame PX4 hasn't."""
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

    return Setpoint(axes("x", "y", "z"), axes("vx", "vy", "vz"), axes("afx", "afy", "afz"), yaw, yaw_rate)


def _refuse_files(link: TelemetryLink, m: MavMessage) -> bytes:
    """FTP: there are no files here."""
    sequence, session, opcode, *_ = FTP_HEADER.unpack(bytes(m.payload[: FTP_HEADER.size]))
    nak = FTP_HEADER.pack((sequence + 1) & 0xFFFF, session, FTP_NAK, 1, opcode, 0, 0) + bytes([FTP_UNKNOWN_COMMAND])
    payload = list(nak.ljust(FTP_PAYLOAD, b"\0"))
    return link.pack(
        dialect.MAVLink_file_transfer_protocol_message(0, m.get_srcSystem(), m.get_srcComponent(), payload)
    )


def _no_mission(link: TelemetryLink, m: MavMessage) -> bytes:
    """There is none to download."""
    sender = (m.get_srcSystem(), m.get_srcComponent())
    return link.pack(dialect.MAVLink_mission_count_message(*sender, 0, m.mission_type))


def _refuse_mission(link: TelemetryLink, m: MavMessage) -> bytes:
    """None can be uploaded."""
    sender = (m.get_srcSystem(), m.get_srcComponent())
    return link.pack(dialect.MAVLink_mission_ack_message(*sender, MISSION_UNSUPPORTED, m.mission_type))
