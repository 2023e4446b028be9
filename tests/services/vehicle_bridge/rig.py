"""A vehicle bridge with a small autopilot at the other end of its link, stepped by hand.

The autopilot carries out commands, reports the state that a test sets, and ignores physics.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Any

from jezero.base.codec import decode, encode
from jezero.base.mavlink import MavlinkCodec, Signing, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Output, Publish, Reply, Request, Send
from jezero.schemas.commands import Acquire, AcquireReply, Phase, Release, Setpoint
from jezero.schemas.rows import Endpoint
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Clock, Odometry, Status
from jezero.schemas.topics import ACQUIRE, ALTIMETER, CAMERA_ATTITUDE, CLOCK, FENCE, ODOMETRY, RELEASE, SETPOINT, STATUS
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import VehicleBridge

STEP_NS = 20_000_000
BOOT_ID = 0xB0
SECRET = "secret"
MODES = {"OFFBOARD": 6 << 16, "POSCTL": 3 << 16, "LOITER": 4 << 16 | 3 << 24, "LAND": 4 << 16 | 6 << 24}
CRITICAL = dialect.MAV_STATE_CRITICAL
ARM, SET_MODE = dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_DO_SET_MODE


class FakeAutopilot:
    """An autopilot without physics, whose state and faults tests set.

    Attributes:
        origin_sent: it has sent its GPS_GLOBAL_ORIGIN, which it does once and on request, as PX4.
        heartbeat_s: period of its HEARTBEAT, 0 for one in each step.
        foreign_setpoint: setpoint that somebody else streams to it.
        lost_commands: number of commands that it will lose.
        lost_acks: number of acknowledgements that it will lose.
        read_parameters: names of the parameters that were requested.
        lost_reads: number of replies to such requests that will be lost.
        battery_percent: remaining charge; None when it doesn't measure the battery.
        unasked: bytes that it sends with its next telemetry.
        refuse_arming: reason for which it refuses to arm, "" when it doesn't.
        reported_armed: an old arming state that its HEARTBEAT still reports; None for the true one.
        silent: it sends nothing.
        answers_timesync: it answers TIMESYNC.
        kind: HEARTBEAT.autopilot.
        version: its version, as AUTOPILOT_VERSION carries it.
    """

    def __init__(self, system_id: int = 1, signing: Signing | None = None) -> None:
        self.codec = MavlinkCodec(system_id, 1, signing)
        self.answers_timesync = True
        self.kind = dialect.MAV_AUTOPILOT_PX4
        self.version = 1 << 24 | 15 << 16 | 2 << 8 | 255
        self.pos = [0.0, 0.0, 0.0]
        self.vel = [0.0, 0.0, 0.0]
        self.q = [1.0, 0.0, 0.0, 0.0]
        self.armed = False
        self.landed = True
        self.mode = MODES["LOITER"]
        self.system_status = dialect.MAV_STATE_ACTIVE
        self.foreign_setpoint: Any | None = None
        self.parameters: dict[str, int | float] = {}
        self.set_parameters: list[str] = []
        self.read_parameters: list[str] = []
        self.lost_reads = 0
        self.battery_percent: int | None = None
        self.unasked = b""
        self.bytes_received = 0
        self.origin_sent = False
        self.origin_requests = 0
        self.heartbeat_s = 0.0
        self.heartbeat_requests = 0
        self._next_heartbeat_us = 0
        self.armable = True
        self.reset_counter = 0
        self.silent = False
        self.lost_commands = 0
        self.lost_acks = 0
        self.refuse_arming = ""
        self.reported_armed: bool | None = None
        self.commands: list[tuple[int, tuple[float, float, float]]] = []
        self.setpoints: list[Any] = []
        self.t_us = 0

    def handle(self, data: bytes) -> bytes:
        out = b""
        self.bytes_received += len(data)
        for message in self.codec.parse(data):
            kind = message.get_msgId()
            if kind == dialect.MAVLINK_MSG_ID_PARAM_SET:
                out += self._set_parameter(message)
            elif kind == dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                out += self._read_parameter(message.param_id)
            elif kind == dialect.MAVLINK_MSG_ID_COMMAND_LONG and message.command == dialect.MAV_CMD_REQUEST_MESSAGE:
                self._on_message_request(int(message.param1))
            elif kind == dialect.MAVLINK_MSG_ID_TIMESYNC and self.answers_timesync:
                out += self.codec.pack(dialect.MAVLink_timesync_message(self.t_us * 1000, message.ts1))
            elif kind == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                self.setpoints.append(message)
            elif kind == dialect.MAVLINK_MSG_ID_COMMAND_LONG and message.command in (ARM, SET_MODE):
                if self.lost_commands > 0:
                    self.lost_commands -= 1
                    continue
                self.commands.append((message.command, (message.param1, message.param2, message.param3)))
                out += self._do(message)
        return out

    def _on_message_request(self, message_id: int) -> None:
        """Send a message with the next telemetry."""
        if message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self.heartbeat_requests += 1
            self._next_heartbeat_us = 0
        elif message_id == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
            self.origin_requests += 1
            self.origin_sent = False
        elif message_id == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            nothing = [0] * 8
            message = dialect.MAVLink_autopilot_version_message(0, self.version, 0, 0, 0, *[nothing] * 3, 0, 0, 0)
            self.unasked += self.codec.pack(message)

    def _do(self, message: Any) -> bytes:
        result, text = dialect.MAV_RESULT_ACCEPTED, ""
        if message.command == SET_MODE and not int(message.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            result = dialect.MAV_RESULT_DENIED  # as PX4 does: all its modes are custom modes
        elif message.command == SET_MODE:
            self.mode = int(message.param2) << 16 | int(message.param3) << 24
        elif message.param1 == 1.0:
            if self.refuse_arming:
                result, text = dialect.MAV_RESULT_TEMPORARILY_REJECTED, self.refuse_arming
            else:
                self.armed = True
        elif self.landed or message.param2 == 21196.0:
            self.armed = False
        else:
            result = dialect.MAV_RESULT_DENIED
        out = b""
        if text:
            out += self.codec.pack(dialect.MAVLink_statustext_message(3, text.encode()))
        if self.lost_acks > 0:
            self.lost_acks -= 1
            return out
        return out + self.codec.pack(dialect.MAVLink_command_ack_message(message.command, result, 0, 0, 1, 191))

    def _set_parameter(self, message: Any) -> bytes:
        """As PX4 does: no reply about a parameter that it doesn't know or that has another type."""
        name = message.param_id
        self.set_parameters.append(name)
        known = self.parameters.get(name)
        is_int = message.param_type == dialect.MAV_PARAM_TYPE_INT32
        if known is None or is_int is not isinstance(known, int):
            return b""
        raw = struct.pack("<f", message.param_value)
        self.parameters[name] = struct.unpack("<i", raw)[0] if is_int else message.param_value
        return self.parameter(name)

    def _read_parameter(self, name: str) -> bytes:
        """PARAM_VALUE, unless the parameter is unknown or the reply gets lost."""
        self.read_parameters.append(name)
        if name not in self.parameters or self.lost_reads > 0:
            self.lost_reads -= 1
            return b""
        return self.parameter(name)

    def parameter(self, name: str) -> bytes:
        """PARAM_VALUE."""
        value = self.parameters[name]
        kind, carried = dialect.MAV_PARAM_TYPE_REAL32, value
        if isinstance(value, int):
            kind, carried = dialect.MAV_PARAM_TYPE_INT32, struct.unpack("<f", struct.pack("<i", value))[0]
        message = dialect.MAVLink_param_value_message(name.encode(), carried, kind, len(self.parameters), 0)
        return self.codec.pack(message)

    def _is_heartbeat_due(self) -> bool:
        is_due = self.heartbeat_s == 0.0 or self.t_us >= self._next_heartbeat_us
        self._next_heartbeat_us = self.t_us + int(self.heartbeat_s * 1e6) if is_due else self._next_heartbeat_us
        return is_due

    def _setpoint_echo(self) -> Sequence[Any]:
        """POSITION_TARGET_LOCAL_NED of the setpoint that it follows now."""
        s = self.foreign_setpoint or (self.setpoints[-1] if self.setpoints else None)
        if s is None or self.landed:
            return ()
        return (
            dialect.MAVLink_position_target_local_ned_message(
                self.t_us // 1000, 1, s.type_mask, s.x, s.y, s.z, s.vx, s.vy, s.vz, s.afx, s.afy, s.afz, s.yaw, 0.0
            ),
        )

    def telemetry(self) -> bytes:
        """One round of telemetry at the present time."""
        if self.silent:
            return b""
        armed = self.armed if self.reported_armed is None else self.reported_armed
        base_mode = 1 | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
        prearm = dialect.MAV_SYS_STATUS_PREARM_CHECK
        nan = [float("nan")] * 21
        heartbeat = dialect.MAVLink_heartbeat_message(2, self.kind, base_mode, self.mode, self.system_status, 3)
        origin = dialect.MAVLink_gps_global_origin_message(473977418, 85455938, 488000, 0)
        origins = () if self.origin_sent else (origin,)
        self.origin_sent = True
        messages = (
            *((heartbeat,) if self._is_heartbeat_due() else ()),
            dialect.MAVLink_extended_sys_state_message(0, 1 if self.landed else 2),
            dialect.MAVLink_sys_status_message(
                prearm, prearm, prearm if self.armable else 0, 0, *self._battery(), 0, 0, 0, 0, 0, 0
            ),
            *origins,
            dialect.MAVLink_odometry_message(
                self.t_us, 1, 1, *self.pos, self.q, *self.vel, 0.0, 0.0, 0.0, nan, nan, self.reset_counter, 8, 100
            ),
            *self._setpoint_echo(),
        )
        unasked, self.unasked = self.unasked, b""
        return unasked + b"".join(self.codec.pack(message) for message in messages)

    def _battery(self) -> tuple[int, int, int]:
        """Voltage in mV, current and remaining percent of SYS_STATUS; the first numbers stand for no battery."""
        return (0xFFFF, -1, -1) if self.battery_percent is None else (15_300, -1, self.battery_percent)


class Box:
    """The bridge's inbox."""

    def __init__(self) -> None:
        self.wall_ns = self.stalled_ns = 0
        self.connected = True
        self.departed: Sequence[str] = ()
        self.responses: Sequence[Any] = ()
        self.sent: Sequence[Any] = ()
        self.messages: dict[str, list[Any]] = {}
        self.last: dict[str, Any] = {}
        self.pending: dict[str, list[Request]] = {}
        self.bytes = b""

    def new(self, topic: Any) -> Sequence[Any]:
        return self.messages.get(topic.name, ())

    def latest(self, topic: Any) -> Any | None:
        return self.last.get(topic.name)

    @property
    def has_requests(self) -> bool:
        return bool(self.pending)

    def requests(self, endpoint: Endpoint[Any, Any]) -> Sequence[Request]:
        return self.pending.get(endpoint.name, ())

    def received(self, link: str) -> bytes:
        return self.bytes

    def connections(self, link: str) -> int:
        return 1

    def is_up(self, link: str) -> bool:
        return True

    def put(self, topic: Any, message: Any) -> None:
        self.messages.setdefault(topic.name, []).append(message)
        self.last[topic.name] = message

    def clear(self) -> None:
        self.messages.clear()
        self.pending.clear()
        self.departed = ()
        self.bytes = b""


class Rig:
    """Steps bridge and autopilot every 20 ms of vehicle time; wall time is the same unless set."""

    def __init__(
        self, config: VehicleBridgeConfig | None = None, robot: VehicleConfig | None = None, key: bytes = b""
    ) -> None:
        config, robot = config or VehicleBridgeConfig(), robot or VehicleConfig()
        self.bridge = VehicleBridge(config, robot, system_id=1, boot_id=BOOT_ID, secret=SECRET, key=key)
        self.autopilot = FakeAutopilot()
        self.box = Box()
        self.t_ns = 1_000_000_000
        self.ahead_ns = 0
        """The bridge's estimate of vehicle time minus the true one."""
        self.epoch_id = 7
        self.has_simulator = not config.link
        """Whether a simulator publishes vehicle time; else the bridge does, and hears itself."""
        self.clocks: list[Clock] = []
        self.outputs: list[Output] = []
        self.statuses: list[Status] = []
        self.odometry: list[Odometry] = []
        self.replies: dict[int, Any] = {}
        self.reply_t_ns: dict[int, int] = {}
        self.sequence = 0
        self.range_m: float | None = None
        self._request_id = 0
        self._to_bridge = b""

    @property
    def status(self) -> Status:
        return self.statuses[-1]

    @property
    def codes(self) -> list[int]:
        """Codes in the order they were published, each once."""
        codes: list[int] = []
        for status in self.statuses:
            if not codes or codes[-1] != status.code:
                codes.append(status.code)
        return codes

    def step(self) -> None:
        self.t_ns += STEP_NS
        self.box.wall_ns += STEP_NS
        self.autopilot.t_us = self.t_ns // 1000
        if self.has_simulator:
            self.box.put(CLOCK, Clock(t_ns=self.t_ns, epoch_id=self.epoch_id, wall_ns=self.t_ns))
        elif self.clocks:
            self.box.put(CLOCK, self.clocks[-1])
        if self.range_m is not None:
            self.box.put(ALTIMETER, Altimeter(t_ns=self.t_ns, range_m=self.range_m))
        self.box.bytes = b"" if self.autopilot.silent else self._to_bridge + self.autopilot.telemetry()
        self._to_bridge = b""
        for output in self.bridge.step(self.t_ns + self.ahead_ns, self.box):
            self._apply(output)
        self.box.clear()

    def _apply(self, output: Output) -> None:
        self.outputs.append(output)
        if isinstance(output, Publish) and isinstance(output.message, Clock):
            self.clocks.append(output.message)
        elif isinstance(output, Publish) and output.topic not in (FENCE, ALTIMETER, CAMERA_ATTITUDE):
            message = decode(output.topic.type, encode(output.message))
            (self.statuses if output.topic is STATUS else self.odometry).append(message)
            assert output.topic in (STATUS, ODOMETRY)
        elif isinstance(output, Reply):
            assert output.payload is not None
            self.replies[output.request_id] = output.payload
            self.reply_t_ns[output.request_id] = self.t_ns
        elif isinstance(output, Send):
            self._to_bridge += self.autopilot.handle(output.data)

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            each()
            self.step()

    def stand_still(self, seconds: float) -> None:
        """Stop vehicle time, of which the bridge is informed afterwards; no telemetry arrives meanwhile."""
        self.autopilot.silent = True
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.t_ns -= STEP_NS
            self.ahead_ns += STEP_NS
            self.step()
        self.autopilot.silent = False
        self.ahead_ns = 0

    def run_until(
        self, condition: Callable[[], bool], each: Callable[[], None] = lambda: None, limit_s: float = 20.0
    ) -> None:
        for _ in range(round(limit_s * 1e9 / STEP_NS)):
            if condition():
                return
            each()
            self.step()
        raise AssertionError(f"condition not met within {limit_s} s; the last status is {self.status}")

    def post(self, endpoint: Endpoint[Any, Any], payload: Any) -> int:
        """Put a request into the next step; returns its id."""
        self._request_id += 1
        self.box.pending.setdefault(endpoint.name, []).append(Request(self._request_id, "test", payload))
        return self._request_id

    def request(self, endpoint: Endpoint[Any, Any], payload: Any, each: Callable[[], None] = lambda: None) -> Any:
        """Send a request and step until its reply."""
        request_id = self.post(endpoint, payload)
        self.run_until(lambda: request_id in self.replies, each)
        return self.replies[request_id]

    def acquire(self, action: str = "takeoff", goal_id: str = "", *, do_takeoff: bool = False) -> AcquireReply:
        """Request control for a new goal, unless another id is given."""
        goal_id = goal_id or f"g{self._request_id + 1}"
        reply: AcquireReply = self.request(ACQUIRE, Acquire(goal_id=goal_id, action=action, do_takeoff=do_takeoff))
        return reply

    def setpoint(self, control_id: str, phase: Phase, **fields: Any) -> None:
        """Put a setpoint into the next step, as its owner would send it."""
        self.sequence += 1
        given: dict[str, Any] = {"t_ns": self.t_ns, "sequence": self.sequence, "pos_ned_m": (0.0, 0.0, -2.0)}
        given["reset_counter"] = self.autopilot.reset_counter
        given.update(fields)
        self.box.put(SETPOINT, Setpoint(control_id=control_id, phase=phase, **given))

    def release(self, control_id: str, outcome: Any = "succeeded", **fields: Any) -> Any:
        return self.request(RELEASE, Release(control_id=control_id, outcome=outcome, **fields))

    def ready(self) -> "Rig":
        self.run_until(lambda: bool(self.statuses) and self.status.ready)
        return self

    def lift_off(self, height_m: float = 2.0) -> None:
        self.autopilot.landed = False
        self.autopilot.pos[2] = -height_m

    def fly(self, height_m: float = 2.0) -> "Rig":
        """Take off and hover at status 3."""
        self.ready()
        control_id = self.acquire("takeoff").control_id
        self.run_until(lambda: self.status.armed, lambda: self.setpoint(control_id, Phase.TAKEOFF))
        self.lift_off(height_m)
        self.run(0.1, lambda: self.setpoint(control_id, Phase.TAKEOFF))
        reply = self.release(control_id, hover_pos_ned_m=(0.0, 0.0, -height_m))
        assert reply.released
        assert reply.code == 3
        return self

    def go(self, action: str, phase: Phase) -> str:
        """Begin a goal's flight from status 3; returns its control id."""
        reply = self.acquire(action, goal_id=f"goal-{action}")
        assert reply.granted, reply.reason
        self.run(0.06, lambda: self.setpoint(reply.control_id, phase))
        return reply.control_id
