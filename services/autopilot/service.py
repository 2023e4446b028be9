"""The embedded autopilot: speaks what PX4 speaks, and knows only what HIL_SENSOR and HIL_GPS tell."""

from collections.abc import Iterator
from math import inf

from jezero.frames import Vec3, add, subtract
from jezero.mavlink import MavMessage, dialect, is_finite
from jezero.runtime.service import Health, Inbox, Output, Send, Spec
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.commander import Commander, Condition, Mode
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.control import Axes, Setpoint
from jezero.services.autopilot.estimator import Estimator
from jezero.services.autopilot.flight import Flight
from jezero.services.autopilot.hil import HilLink, Reading
from jezero.services.autopilot.mixer import STOPPED
from jezero.services.autopilot.telemetry import (
    GCS_INTERVALS_US,
    OFFBOARD_INTERVALS_US,
    Snapshot,
    TelemetryLink,
)

HIL, OFFBOARD, GCS = "hil", "offboard", "gcs"
STEP_MAX_S = 0.05
GAP_MAX_US = 1_000_000
FORCE = 21196.0
MODES = {mode.value: mode for mode in Mode}
USE_TWO_PARAMETERS = (
    dialect.MAV_CMD_COMPONENT_ARM_DISARM,
    dialect.MAV_CMD_DO_SET_MODE,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
)

SPEC = Spec(name="autopilot", links=(HIL, OFFBOARD, GCS), triggers=(HIL, OFFBOARD, GCS), rate_hz=10.0)


class Autopilot:
    """One autopilot with its links.

    All its time is that of HIL_SENSOR; it answers each with one HIL_ACTUATOR_CONTROLS. A new simulator, or time that
    goes back or leaps, makes it start over.

    Args:
        system_id: MAVLink system id.
        boot_id: differs between two runs; the autopilot itself has no use for it.
    """

    spec = SPEC

    def __init__(self, config: AutopilotConfig, system_id: int, boot_id: int) -> None:
        self._config = config
        self._system_id = system_id
        self._links = {
            OFFBOARD: TelemetryLink(system_id, OFFBOARD_INTERVALS_US),
            GCS: TelemetryLink(system_id, GCS_INTERVALS_US),
        }
        self._connections = 0
        self._health: Health | None = None
        self._start_over()

    def _start_over(self) -> None:
        config = self._config
        self._hil = HilLink(self._system_id)
        self._estimator = Estimator(config.estimator, config.airframe.gravity_mps2)
        self._flight = Flight(config, self._estimator)
        self._commander = Commander(config.commander)
        self._t_us = 0
        self._fix_us: int | None = None
        self._mag_us: int | None = None
        self._baro_us: int | None = None
        self._offboard = Setpoint()
        self._offboard_us: int | None = None
        self._hold = Setpoint()
        self._home_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._reset_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._links = {
            OFFBOARD: TelemetryLink(self._system_id, OFFBOARD_INTERVALS_US),
            GCS: TelemetryLink(self._system_id, GCS_INTERVALS_US),
        }

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Sensors in, motors out; then what the links ask and tell."""
        if inbox.connections(HIL) != self._connections:
            self._connections = inbox.connections(HIL)
            self._start_over()
        for item in self._hil.receive(inbox.received(HIL)):
            if isinstance(item, Fix):
                self._fix_us = self._t_us
                self._estimator.fix(item)
                self._follow_reset()
            else:
                yield Send(HIL, self._on_reading(item))
        for name, link in self._links.items():
            for message in link.receive(inbox.received(name)):
                if answer := self._on_message(link, message):
                    yield Send(name, answer)
        yield from self._tell(inbox)

    # -- flying --------------------------------------------------------------------------------------------

    def _on_reading(self, reading: Reading) -> bytes:
        """One HIL_SENSOR in, one HIL_ACTUATOR_CONTROLS out."""
        if reading.t_us < self._t_us or (self._t_us and reading.t_us > self._t_us + GAP_MAX_US):
            self._start_over()
        dt = min((reading.t_us - self._t_us) * 1e-6, STEP_MAX_S) if self._t_us else 0.0
        self._t_us = reading.t_us
        estimator = self._estimator
        if reading.imu is not None:
            estimator.imu(reading.t_us, *reading.imu)
        if reading.field_frd_gauss is not None:
            self._mag_us = reading.t_us
            estimator.mag(reading.field_frd_gauss)
        if reading.altitude_pressure_m is not None:
            self._baro_us = reading.t_us
            estimator.baro(reading.altitude_pressure_m)
        self._follow_reset()
        mode_before = self._commander.mode
        self._commander.tick(self._condition())
        self._take_over(mode_before)
        armed = self._commander.armed
        commands = STOPPED
        if armed and estimator.running:
            commands = self._flight.step(dt, self._setpoint(), may_lift=self._commander.mode is Mode.OFFBOARD)
        elif not armed:
            commands = self._flight.stopped()
        return self._hil.actuators(reading.t_us, commands, armed=armed)

    def _follow_reset(self) -> None:
        """Move what is stored in the local frame along with a step of the estimate."""
        offset = self._estimator.reset_offset_ned_m
        if offset != self._reset_offset_ned_m:
            step = subtract(offset, self._reset_offset_ned_m)
            self._reset_offset_ned_m = offset
            self._home_ned_m = add(self._home_ned_m, step)
            self._hold = self._hold.moved(step)
            self._offboard = self._offboard.moved(step)

    def _setpoint(self) -> Setpoint:
        return self._offboard if self._commander.mode is Mode.OFFBOARD else self._hold

    def _take_over(self, mode_before: Mode) -> None:
        """A new mode of the autopilot's own starts where the vehicle comes to rest."""
        mode = self._commander.mode
        if mode is mode_before:
            return
        north, east, down = self._flight.stopping_point_ned_m()
        if mode is Mode.LAND:
            speed_mps = self._config.control.mpc_land_speed_mps
            self._hold = Setpoint((north, east, None), (None, None, speed_mps), yaw_rad=self._estimator.yaw_rad)
        else:
            self._hold = Setpoint((north, east, down), yaw_rad=self._estimator.yaw_rad)

    def _condition(self) -> Condition:
        return Condition(
            t_us=self._t_us,
            not_armable="" if self._commander.armed else self._not_armable(),
            position_lost="" if self._estimator.running else self._estimator.missing,
            stream_age_s=self._age_s(self._offboard_us),
            landed=self._flight.detector.landed,
            tilt_rad=self._estimator.tilt_rad,
        )

    def _not_armable(self) -> str:
        """Why the vehicle must not arm, in words."""
        c = self._config.commander
        if self._t_us == 0:
            return "no sensor data"
        if missing := self._estimator.missing:
            return missing
        ages = (("GNSS", self._fix_us), ("magnetometer", self._mag_us), ("barometer", self._baro_us))
        for name, last_us in ages:
            if self._age_s(last_us) > c.sensor_timeout_s:
                return f"no {name} data for {self._age_s(last_us):.1f} s"
        if self._estimator.tilt_rad > c.arm_tilt_rad:
            return "the vehicle is tilted too much"
        return ""

    def _age_s(self, last_us: int | None) -> float:
        return inf if last_us is None else (self._t_us - last_us) * 1e-6

    # -- what others ask -----------------------------------------------------------------------------------

    def _on_message(self, link: TelemetryLink, message: MavMessage) -> bytes:
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            setpoint = _offboard_setpoint(message)
            if setpoint is not None:
                self._offboard, self._offboard_us = setpoint, self._t_us
        elif kind == dialect.MAVLINK_MSG_ID_COMMAND_LONG:
            return self._on_command(link, message)
        elif kind == dialect.MAVLINK_MSG_ID_COMMAND_INT:
            return link.acknowledge(message, dialect.MAV_RESULT_COMMAND_LONG_ONLY)
        return b""

    def _on_command(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Do it, and acknowledge it."""
        command, mode_before, extra = message.command, self._commander.mode, b""
        result = dialect.MAV_RESULT_UNSUPPORTED
        if command in USE_TWO_PARAMETERS and not is_finite(message, "param1", "param2"):
            result = dialect.MAV_RESULT_DENIED
        elif command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            result = self._arm_or_disarm(message)
        elif command == dialect.MAV_CMD_DO_SET_MODE:
            result = self._set_mode(_main_and_sub_mode(message))
        elif command == dialect.MAV_CMD_NAV_LAND:
            result = self._set_mode(Mode.LAND.value)
        elif command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL and link.set_interval(int(message.param1), message.param2):
            result = dialect.MAV_RESULT_ACCEPTED
        elif command == dialect.MAV_CMD_REQUEST_MESSAGE and is_finite(message, "param1"):
            told = link.request(int(message.param1), self._snapshot())
            if told is not None:
                result, extra = dialect.MAV_RESULT_ACCEPTED, told
        self._take_over(mode_before)
        return link.acknowledge(message, result) + extra

    def _arm_or_disarm(self, message: MavMessage) -> int:
        now = self._condition()
        if message.param1 == 1.0:
            was_armed = self._commander.armed
            reason = self._commander.arm(now)
            if self._commander.armed and not was_armed:
                self._home_ned_m = self._estimator.pos_ned_m
        elif message.param1 == 0.0:
            reason = self._commander.disarm(now, force=message.param2 == FORCE)
        else:
            return int(dialect.MAV_RESULT_DENIED)
        return int(dialect.MAV_RESULT_TEMPORARILY_REJECTED if reason else dialect.MAV_RESULT_ACCEPTED)

    def _set_mode(self, main_and_sub: tuple[int, int] | None) -> int:
        mode = MODES.get(main_and_sub) if main_and_sub else None
        if mode is None:
            return int(dialect.MAV_RESULT_DENIED)
        reason = self._commander.set_mode(mode, self._condition())
        return int(dialect.MAV_RESULT_TEMPORARILY_REJECTED if reason else dialect.MAV_RESULT_ACCEPTED)

    # -- what it tells -------------------------------------------------------------------------------------

    def _tell(self, inbox: Inbox) -> Iterator[Output]:
        said = self._commander.take_said()
        commander = self._commander
        state = (commander.mode.custom_mode, commander.armed, self._flight.detector.landed)
        for name, link in self._links.items():
            if not inbox.is_up(name):
                continue
            data = b"".join(link.text(severity, text) for severity, text in said)
            if self._t_us and link.is_due(self._t_us, state):
                data += link.stream(self._snapshot())
            if data:
                yield Send(name, data)
        health = self._judge(inbox)
        if health != self._health:
            self._health = health
            yield health

    def _judge(self, inbox: Inbox) -> Health:
        if not inbox.is_up(HIL):
            return Health("starting", "waiting for the simulator")
        text = "flying" if not self._flight.detector.landed else "connected to the simulator"
        malformed = self._hil.malformed + sum(link.malformed for link in self._links.values())
        return Health("ok", f"{text}; {malformed} malformed messages" if malformed else text)

    def _snapshot(self) -> Snapshot:
        estimator, commander = self._estimator, self._commander
        variance: Vec3 = (float(estimator.P[6, 6]), float(estimator.P[7, 7]), float(estimator.P[8, 8]))
        return Snapshot(
            t_us=self._t_us,
            armed=commander.armed,
            failsafe=commander.failsafe,
            custom_mode=commander.mode.custom_mode,
            landed=self._flight.detector.landed,
            armable=commander.armed or not self._not_armable(),
            estimated=estimator.running,
            pos_ned_m=estimator.pos_ned_m,
            vel_ned_mps=estimator.vel_ned_mps,
            q_ned_from_frd=estimator.q_ned_from_frd,
            rates_frd_rps=estimator.rates_frd_rps,
            var_pos_ned_m2=variance,
            reset_counter=estimator.reset_counter,
            origin_deg=estimator.origin_deg,
            home_ned_m=self._home_ned_m,
        )


def _main_and_sub_mode(message: MavMessage) -> tuple[int, int] | None:
    """PX4's mode of a DO_SET_MODE; None when it asks for a mode that is not custom."""
    if not int(message.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return None
    return int(message.param2), int(message.param3) if is_finite(message, "param3") else 0


def _offboard_setpoint(message: MavMessage) -> Setpoint | None:
    """What SET_POSITION_TARGET_LOCAL_NED asks for; None when it is not in local NED, not finite, or empty."""
    mask = message.type_mask
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz")
    used = [name for bit, name in enumerate(names) if not mask >> bit & 1]
    yaw = None if mask & 1024 else message.yaw
    yaw_rate = None if mask & 2048 else message.yaw_rate
    turn = [name for name, value in (("yaw", yaw), ("yaw_rate", yaw_rate)) if value is not None]
    if message.coordinate_frame != dialect.MAV_FRAME_LOCAL_NED or not used or not is_finite(message, *used, *turn):
        return None
    value: dict[str, float] = {name: getattr(message, name) for name in used}

    def axes(x: str, y: str, z: str) -> Axes:
        return (value.get(x), value.get(y), value.get(z))

    return Setpoint(axes("x", "y", "z"), axes("vx", "vy", "vz"), axes("afx", "afy", "afz"), yaw, yaw_rate)
