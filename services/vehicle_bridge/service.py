"""The vehicle bridge: it connects the autopilot's MAVLink with the bus, with `Authority` in between."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from math import inf

from jezero.base.frames import Quat, Vec3, add, altitude_m, horizontal
from jezero.base.mavlink import Signing
from jezero.base.vehicle_config import VehicleConfig
from jezero.keys.controller_key import CONTROLLER_KEY_VARIABLE
from jezero.runtime.service import Health, Inbox, Output, Publish, Reply, Send, Spec, Subscribe
from jezero.schemas.fence import Fence
from jezero.schemas.health import ServiceState
from jezero.schemas.preflight import Check
from jezero.schemas.rows import FLYING_ODOMETRY_MIN_HZ
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.struct import TEXT_MAX
from jezero.schemas.topics import (
    ABORT,
    ACQUIRE,
    ACTIONS,
    ALTIMETER,
    CAMERA_ATTITUDE,
    CAMERA_PITCH,
    CLOCK,
    FENCE,
    HOVER,
    KILL,
    ODOMETRY,
    PREFLIGHT,
    RELEASE,
    SET_FENCE,
    SETPOINT,
    STATUS,
    UNKNOWN_ACTION,
)
from jezero.schemas.units import NS_PER_S
from jezero.services.vehicle_bridge.admission import in_words, status_words
from jezero.services.vehicle_bridge.authority import Authority, ControlState
from jezero.services.vehicle_bridge.autopilot_link import (
    AUTOPILOT_COMPONENT_ID,
    COMPONENT_ID,
    AutopilotLink,
    TelemetryBatch,
    version_refusal,
    version_text,
)
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.fence import FenceKeeper
from jezero.services.vehicle_bridge.gimbal import GimbalClient
from jezero.services.vehicle_bridge.narrow_line import rate_refusal
from jezero.services.vehicle_bridge.requests import RequestQueue, unknown_action_reply
from jezero.services.vehicle_bridge.takeover import ForeignSetpointDetector
from jezero.services.vehicle_bridge.time_sync import ControllerClock, KeptEpoch
from jezero.services.vehicle_bridge.vehicle import LINK_TIMEOUT_S, OFFBOARD, Target, VehicleSnapshot
from jezero.services.vehicle_bridge.wind_estimator import WindEstimator

LINK = "autopilot"
STATUS_PERIOD_NS = 100_000_000
STREAM_PERIOD_NS = 50_000_000
"""Period of an unchanged target: the autopilot needs more than 2 Hz in offboard mode, a hover is streamed at 10 Hz."""
NARROW_STREAM_PERIOD_NS = 33_000_000
"""Shortest period of setpoints on a narrow line. More would wait in its buffer until the autopilot follows old
ones, which look like somebody else's."""
HEARTBEAT_PERIOD_NS = 1_000_000_000
INTERVALS_PERIOD_NS = 5_000_000_000
"""Period of the requests for telemetry: an autopilot that has restarted needs a new one."""
ALTIMETER_MAX_AGE_NS = 300_000_000
PREFLIGHT_MAX_AGE_NS = 30_000_000_000
"""The preflight service checks a vehicle that stands every ten seconds."""
FIRST_STATUS_TIMEOUT_NS = 1_500_000_000
"""A bridge that has just started waits this long for telemetry before it publishes status 0: the vehicle may be
flying."""

SPEC = Spec(
    name="vehicle_bridge",
    inputs=(CLOCK, SETPOINT, PREFLIGHT),
    on_demand=(ALTIMETER,),
    outputs=(ODOMETRY, STATUS, FENCE, CAMERA_ATTITUDE),
    last_value=(STATUS, FENCE),
    serves=(ACQUIRE, RELEASE, HOVER, ABORT, KILL, SET_FENCE, UNKNOWN_ACTION),
    links=(LINK,),
    triggers=(LINK, SETPOINT.name, ACQUIRE.name, RELEASE.name, HOVER.name, ABORT.name, KILL.name, UNKNOWN_ACTION.name),
    watches="service",
)

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


class VehicleBridge:
    """Service that alone commands the autopilot and publishes `status`.

    Args:
        config: rate, limits and the autopilot's parameters.
        robot: the vehicle itself, with the limits of a hover point.
        system_id: MAVLink system id of the vehicle.
        boot_id: differs between two runs of the bridge.
        secret: part of the control ids that nobody can guess; differs between two runs of the bridge.
        actions: names of all actions; requests to others are refused.
        fence: the fence at the start; None for none.
        keep_fence: keeps a fence that was set by a request over a restart of the bridge.
        name: name of the vehicle, as in its keys.
        kept_epoch: the epoch of the bridge before, of a real vehicle; None without one.
        keep_epoch: keeps the epoch of a real vehicle over a restart of the bridge.
        key: of the signatures of the autopilot's link, 32 bytes; b"" for a link without signatures.
        since_2015_s: wall time at the start, for the time stamps of signatures.
    """

    def __init__(
        self,
        config: VehicleBridgeConfig,
        robot: VehicleConfig,
        system_id: int,
        boot_id: int,
        secret: str,
        actions: Collection[str] = tuple(ACTIONS),
        fence: Fence | None = None,
        keep_fence: Callable[[Fence | None], None] = lambda fence: None,
        name: str = "uav1",
        kept_epoch: KeptEpoch | None = None,
        keep_epoch: Callable[[KeptEpoch], None] = lambda epoch: None,
        key: bytes = b"",
        since_2015_s: float = 0.0,
    ) -> None:
        made_with = {
            "config": config,
            "robot": robot,
            "system_id": system_id,
            "boot_id": boot_id,
            "secret": secret,
            "actions": tuple(actions),
            "fence": fence,
            "name": name,
            "kept_epoch": kept_epoch,
        }
        has_gimbal = bool(config.link) and robot.camera.gimbal == "mavlink"
        inputs = (*SPEC.inputs, *((CAMERA_PITCH,) if has_gimbal else ()))
        outputs = (*SPEC.outputs, *((CLOCK, ALTIMETER) if config.link else ()))
        self.spec = replace(SPEC, inputs=inputs, outputs=outputs, rate_hz=config.rate_hz, made_with=made_with)
        self._config = config
        self._boot_id = boot_id
        self._actions = actions
        self._since_2015_10us = int(since_2015_s * 1e5)
        # No message from before the start is accepted again. A kept time stamp would make the bridge deaf for seconds.
        self._signing = Signing(key, self._since_2015_10us) if key else None
        parameters = {} if config.link else config.parameters
        self._gimbal: GimbalClient | None = None
        if has_gimbal:
            rest_rad = (robot.camera.pitch_rest_rad, robot.camera.roll_offset_rad)
            self._gimbal = GimbalClient((system_id, COMPONENT_ID), (system_id, AUTOPILOT_COMPONENT_ID), rest_rad)
        self._link = AutopilotLink(
            system_id, parameters, on_hardware=bool(config.link), gimbal=self._gimbal, signing=self._signing
        )
        self._controller = ControllerClock(boot_id, kept_epoch, keep_epoch) if config.link else None
        """The clock of a real vehicle's flight controller; None where the simulator is the master of vehicle time."""
        self._foreign_setpoints = ForeignSetpointDetector()
        self._fence = FenceKeeper(config.on_fence, robot.limits, self._link.fence, fence, keep_fence)
        self._authority = Authority(config, robot, self._fence, secret)
        self._wind = WindEstimator(robot)
        self._epoch_id: int | None = None
        """Epoch of the vehicle; None before the first message of the clock."""
        self._timer = Timer()
        self._ground_ned_m: Vec3 | None = None
        """Place where the vehicle last stood disarmed; None before this run of the bridge has seen it."""
        self._requests = RequestQueue(self._authority, self._link, boot_id, name)
        self._dropped_setpoints = 0
        self._drop_reason = ""
        self._sent: tuple[Target | None, int] = (None, 0)
        self._last_visible: tuple[object, ...] = ()
        self._status_wall_ns: int | None = None
        self._heartbeat_wall_ns = -HEARTBEAT_PERIOD_NS
        self._intervals_wall_ns = -INTERVALS_PERIOD_NS
        self._router_seen_wall_ns: int | None = None
        self._started_wall_ns: int | None = None
        self._altimeter_subscribed = False
        self._health: tuple[ServiceState, str] | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Read telemetry, handle requests and setpoints, judge safety and time-outs, fly, publish; see `Service`."""
        if self._started_wall_ns is None:
            self._started_wall_ns = inbox.wall_ns
        if self._signing is not None:
            self._signing.clock_10us = self._since_2015_10us + (inbox.wall_ns - self._started_wall_ns) // 10_000
        if inbox.connected or self._router_seen_wall_ns is None:
            self._router_seen_wall_ns = inbox.wall_ns
        clock, before = inbox.latest(CLOCK), self._epoch_id
        self._epoch_id = None if clock is None else clock.epoch_id
        respawned = before not in (None, self._epoch_id)
        if not respawned:  # else the last odometry is of the vehicle before
            t_ns = self._vehicle_time_ns(t_ns)
        if self._epoch_id is not None:  # before, there is no vehicle time
            self._timer.update(t_ns)
        batch = self._read_link(inbox, respawned=respawned)
        yield from self._keep_time(batch, inbox)
        self._digest(batch, t_ns, inbox, respawned=respawned)
        self._judge_rate(inbox.wall_ns)
        for odometry in batch.odometry:  # first: the goal in charge waits for it
            yield Publish(ODOMETRY, odometry)
        if self._controller is not None:
            for altimeter in batch.altimeter:
                yield Publish(ALTIMETER, altimeter)
            for attitude in batch.camera:
                yield Publish(CAMERA_ATTITUDE, attitude)
        if self._gimbal is not None:
            self._gimbal.point(inbox.new(CAMERA_PITCH), inbox.wall_ns)
        vehicle = self._snapshot(self._vehicle_time_ns(t_ns), inbox)
        for odometry in batch.odometry:
            self._wind.update(odometry, vehicle)
        yield from self._fence.handle(self._authority.code, vehicle, inbox)
        yield from self._handle_requests(vehicle, inbox)
        self._authority.update(vehicle, inbox.departed)
        yield from self._requests.reply_to_pending(vehicle, inbox.wall_ns)
        yield from self._stream(vehicle.t_ns)
        yield from self._send_commands(vehicle, inbox)
        yield from self._fence.publish(self._link.telemetry.origin_deg, vehicle, inbox.wall_ns)
        yield from self._publish_status(vehicle, inbox.wall_ns)
        yield from self._subscribe()
        yield from self._publish_health(vehicle, inbox.wall_ns)

    # -- inputs --------------------------------------------------------------------------------------------

    def _vehicle_time_ns(self, t_ns: int) -> int:
        """Vehicle time by the bus or, if that is later, by the autopilot: the bridge may be cut off from the bus."""
        odometry = self._link.telemetry.odometry
        return t_ns if odometry is None else max(t_ns, odometry.t_ns)

    def _read_link(self, inbox: Inbox, *, respawned: bool) -> TelemetryBatch:
        if respawned:
            self._link.reset()
        return self._link.receive(inbox.received(LINK), self._timer.now_ns, inbox.wall_ns, self._epoch_id or 0)

    def _keep_time(self, batch: TelemetryBatch, inbox: Inbox) -> Iterator[Output]:
        """Publish the flight controller's time; the bridge hears its own message, as all services do."""
        if self._controller is None:
            return
        host_ns = inbox.wall_ns + inbox.stalled_ns
        for controller_ns, asked_ns in batch.time_replies:
            self._controller.sync.on_reply(controller_ns, asked_ns, host_ns)
        if (clock := self._controller.due(host_ns)) is not None:
            yield Publish(CLOCK, clock)
        if inbox.is_up(LINK) and self._controller.sync.due(host_ns):
            yield Send(LINK, self._link.request_time(host_ns))

    def _judge_rate(self, wall_ns: int) -> None:
        """On a line that is too narrow for ODOMETRY, request the smaller messages at once."""
        received_ns, rate = self._link.telemetry.received_wall_ns, self._link.rate
        if rate is None or received_ns is None:
            return
        if self._link.refusal or wall_ns - received_ns > LINK_TIMEOUT_S * NS_PER_S:
            rate.restart()
        elif rate.update(wall_ns, self._round_trip_ns):
            self._intervals_wall_ns = -INTERVALS_PERIOD_NS

    @property
    def _odometry_hz(self) -> float | None:
        return None if self._link.rate is None else self._link.rate.hz

    @property
    def _round_trip_ns(self) -> int | None:
        offset = None if self._controller is None else self._controller.sync.offset
        return None if offset is None else offset.round_trip_ns

    def _digest(self, batch: TelemetryBatch, t_ns: int, inbox: Inbox, *, respawned: bool) -> None:
        """Update everything that depends on what the autopilot sent."""
        if respawned or batch.restarted:
            self._sent = (None, 0)
            reason = "the vehicle was respawned" if respawned else "the autopilot restarted"
            if self._controller is not None:
                reason = "the flight controller was booted anew"
            self._authority.on_restart(reason, self._snapshot(t_ns, inbox))
        offboard = self._link.telemetry.mode == OFFBOARD  # in another mode the autopilot sets its own targets
        if batch.setpoint_echo is not None and offboard:
            self._foreign_setpoints.update(batch.setpoint_echo, t_ns, self._timer.now_ns)
        for step_ned_m in batch.steps_ned_m:
            self._authority.on_position_step(step_ned_m, self._snapshot(t_ns, inbox))
            self._ground_ned_m = None if self._ground_ned_m is None else add(self._ground_ned_m, step_ned_m)
        telemetry = self._link.telemetry
        if telemetry.armed is False and telemetry.odometry is not None and telemetry.landed is not False:
            self._ground_ned_m = telemetry.odometry.pos_uav_ned_m

    def _snapshot(self, t_ns: int, inbox: Inbox) -> VehicleSnapshot:
        telemetry = self._link.telemetry
        odometry = telemetry.odometry
        telemetry_age_s, q = inf, LEVEL
        idle = self._authority.code is StatusCode.IDLE
        if odometry is not None:
            q = odometry.q_ned_from_frd
            if telemetry.received_wall_ns is not None:
                telemetry_age_s = max(inbox.wall_ns - telemetry.received_wall_ns, t_ns - odometry.t_ns) * 1e-9
        range_m = self._range_m(t_ns, inbox, q) if self._altimeter_subscribed else None
        timer_ns = self._timer.now_ns
        return VehicleSnapshot(
            t_ns=t_ns,
            timer_ns=timer_ns,
            started_ns=self._timer.started_ns,
            armed=telemetry.armed,
            landed=telemetry.armed is False if telemetry.landed is None else telemetry.landed,
            mode=telemetry.mode,
            failsafe=telemetry.failsafe,
            armable=telemetry.armable,
            foreign_setpoints=telemetry.landed is False and self._foreign_setpoints.is_detected(timer_ns),
            pos_ned_m=None if odometry is None else odometry.pos_uav_ned_m,
            vel_ned_mps=(0.0, 0.0, 0.0) if odometry is None else odometry.vel_uav_ned_mps,
            q_ned_from_frd=q,
            range_m=range_m,
            height_m=self._height_m(range_m),
            takeoff_ned_m=self._ground_ned_m,
            telemetry_age_s=telemetry_age_s,
            failed_checks=self._failed_checks(t_ns, inbox) if idle else (),
            not_ready_reason=self._not_ready_reason(telemetry_age_s) if idle else "",
            acknowledged=self._link.acknowledged,
            command_failure=self._link.command_failure(timer_ns),
            router_lost_s=(inbox.wall_ns - (self._router_seen_wall_ns or 0)) * 1e-9,
            odometry_hz=self._odometry_hz,
            line=self._config.link,
        )

    def _failed_checks(self, t_ns: int, inbox: Inbox) -> tuple[Check, ...]:
        """Failed checks of a young report of a vehicle that was ready.

        While it is not, the refusal gives that reason, and position and heading are still converging.
        """
        report = inbox.latest(PREFLIGHT)
        if report is None or report.epoch_id != self._epoch_id or t_ns - report.t_ns > PREFLIGHT_MAX_AGE_NS:
            return ()
        failed = report.failed()
        return () if any(check.name == "autopilot" for check in failed) else failed

    def _range_m(self, t_ns: int, inbox: Inbox, q_ned_from_frd: Quat) -> float | None:
        altimeter = inbox.latest(ALTIMETER)
        if altimeter is None or altimeter.range_m is None or t_ns - altimeter.t_ns > ALTIMETER_MAX_AGE_NS:
            return None
        _, x, y, _ = q_ned_from_frd
        return altimeter.range_m * (1.0 - 2.0 * (x * x + y * y))

    def _height_m(self, range_m: float | None) -> float | None:
        """Height above ground or platform by the altimeter, else above the place where the vehicle last stood."""
        odometry = self._link.telemetry.odometry
        if odometry is None or range_m is not None:
            return None if odometry is None else range_m
        z_ground_ned_m = 0.0 if self._ground_ned_m is None else self._ground_ned_m[2]
        return altitude_m(odometry.pos_uav_ned_m[2] - z_ground_ned_m)

    def _handle_requests(self, vehicle: VehicleSnapshot, inbox: Inbox) -> Iterator[Output]:
        """Kill, abort and hover go before the setpoints of the same step, release and acquire after them."""
        if inbox.has_requests:
            yield from self._requests.handle_before_setpoints(vehicle, inbox)
        for setpoint in inbox.new(SETPOINT):
            refusal = self._authority.accept(setpoint, vehicle, self._link.telemetry.resets)
            if refusal:
                self._dropped_setpoints += 1
                self._drop_reason = refusal
        if inbox.has_requests:
            yield from self._requests.handle_after_setpoints(vehicle, inbox)
            for request in inbox.requests(UNKNOWN_ACTION):
                yield Reply(request.request_id, unknown_action_reply(request.payload.key, self._actions))

    # -- readiness -----------------------------------------------------------------------------------------

    def _not_ready_reason(self, telemetry_age_s: float) -> str:
        """Reason why a takeoff isn't possible now, for people, or "".

        Args:
            telemetry_age_s: age of the newest telemetry, or of the newest odometry if that is older.
        """
        reason = next(self._missing(telemetry_age_s), "")
        if not reason and self._authority.code is StatusCode.IDLE:
            return self._moving_ground_reason()
        return reason

    def _missing(self, telemetry_age_s: float) -> Iterator[str]:
        """What the system lacks for a takeoff, the first thing first."""
        link, telemetry = self._link, self._link.telemetry
        if link.refusal:
            yield link.refusal
        if self._epoch_id is None:
            yield self._no_time_reason()
        if telemetry.received_wall_ns is None:
            yield self._signature_reason if link.bad_signatures else "no telemetry from the autopilot yet"
        if refusal := version_refusal(telemetry.version):
            yield refusal
        if telemetry.odometry is None:
            yield "the autopilot sends no odometry yet: its estimator is still converging"
        if refusal := rate_refusal(self._odometry_hz, FLYING_ODOMETRY_MIN_HZ, "any flight", self._config.link):
            yield refusal
        if telemetry_age_s > LINK_TIMEOUT_S:
            yield f"the autopilot's telemetry has been missing for {telemetry_age_s:.0f} s"
        if telemetry.origin_deg is None:
            yield "the autopilot has no origin yet: it waits for GNSS"
        if telemetry.armed is None:
            yield "the autopilot has not reported yet whether it is armed"
        if setting := link.parameters.pending:
            yield f"the autopilot's parameters are being set: {', '.join(setting)}"
        if link.rate is not None and link.rate.hz is None:
            yield f"the rate of odometry over {self._config.link} is being measured, for some seconds"
        if not telemetry.armable:
            warning = link.warning(self._timer.now_ns)
            because = f": {warning}" if warning else ""
            yield f"the autopilot's arming checks don't pass yet in mode {telemetry.mode}{because}"

    def _too_rare_reason(self) -> str:
        """Reason why odometry comes too rarely for one of jezero's actions, or ""."""
        most = max(ACTIONS.values(), key=lambda action: action.odometry_min_hz)
        return rate_refusal(self._odometry_hz, most.odometry_min_hz, in_words(most.name), self._config.link)

    def _no_time_reason(self) -> str:
        if self._controller is None:
            return "no vehicle time yet: is the simulator running?"
        if self._link.telemetry.received_wall_ns is None:
            if (other := self._link.other_system_id) is not None:
                return f"the flight controller has MAVLink's system id {other}: set system_id in vehicle_bridge.toml"
            if self._link.bad_signatures:
                return self._signature_reason
            return f"nothing comes from the flight controller at {self._config.link}: is it plugged in and switched on?"
        if self._link.unchecked_signatures:
            return (
                f"the flight controller signs its messages and takes no others: name its key with "
                f"{CONTROLLER_KEY_VARIABLE}"
            )
        return f"the flight controller at {self._config.link} doesn't answer TIMESYNC yet"

    @property
    def _signature_reason(self) -> str:
        return (
            f"{self._link.bad_signatures} messages of the flight controller had no valid signature: give it the key in "
            f"{CONTROLLER_KEY_VARIABLE}, or unset that"
        )

    def _moving_ground_reason(self) -> str:
        """Reason why nothing can take off from a moving rover, or "" while the vehicle stands still."""
        odometry, limit_mps = self._link.telemetry.odometry, self._config.takeoff_speed_max_mps
        speed_mps = 0.0 if odometry is None else horizontal(odometry.vel_uav_ned_mps)
        if speed_mps <= limit_mps:
            return ""
        moves = f"the ground under the vehicle moves at {speed_mps:.2f} m/s"
        return f"{moves}: stop the rover, {limit_mps:g} m/s is the limit"

    # -- outputs -------------------------------------------------------------------------------------------

    def _stream(self, t_ns: int) -> Iterator[Output]:
        """Send the target to the autopilot, when it is another one or due again.

        Each accepted setpoint is another target, even with the numbers of the last one, and goes out at once, but on a
        narrow line.
        """
        target, (last, sent_ns), timer_ns = self._authority.streamed, self._sent, self._timer.now_ns
        is_narrow = self._link.rate is not None and self._link.rate.narrow
        period_ns = STREAM_PERIOD_NS if target is last else NARROW_STREAM_PERIOD_NS if is_narrow else 0
        if target is None:
            self._foreign_setpoints.reset()
        elif timer_ns - sent_ns >= period_ns:
            yield Send(LINK, self._link.setpoint(target, t_ns))
            self._foreign_setpoints.add_sent(target, timer_ns)
            self._sent = (target, timer_ns)

    def _send_commands(self, vehicle: VehicleSnapshot, inbox: Inbox) -> Iterator[Output]:
        """Send commands, heartbeat and requests to the autopilot, after the setpoint: offboard mode needs a stream."""
        data = self._link.command(self._authority.command, self._timer.now_ns)
        wall_ns = inbox.wall_ns
        if wall_ns - self._heartbeat_wall_ns >= HEARTBEAT_PERIOD_NS:
            self._heartbeat_wall_ns = wall_ns
            data += self._link.heartbeat()
        data += self._configure(vehicle, wall_ns)
        if data:
            yield Send(LINK, data)

    def _configure(self, vehicle: VehicleSnapshot, wall_ns: int) -> bytes:
        """Request telemetry and set parameters; neither while others fly and telemetry arrives."""
        if self._link.telemetry.received_wall_ns is None or self._link.refusal:
            return b""
        data = b""
        code = self._authority.code
        blind = vehicle.telemetry_age_s > LINK_TIMEOUT_S
        if blind or code is not StatusCode.EXTERNAL:
            if wall_ns - self._intervals_wall_ns >= INTERVALS_PERIOD_NS:
                self._intervals_wall_ns = wall_ns
                data += self._link.request_intervals()
            data += self._link.request_origin(wall_ns)
            data += self._link.request_battery_critical(wall_ns)
            data += self._link.request_version(wall_ns)
        if code is not StatusCode.EXTERNAL:
            data += self._link.point_camera(wall_ns)
        if code not in (StatusCode.IDLE, StatusCode.EXTERNAL) or self._authority.taking_back:
            data += self._link.request_heartbeat(wall_ns)
        if vehicle.armed is False and code is StatusCode.IDLE:
            data += self._link.set_parameters(wall_ns)
            data += self._link.send_fence(self._timer.now_ns)
        return data

    def _publish_status(self, vehicle: VehicleSnapshot, wall_ns: int) -> Iterator[Output]:
        last_ns = self._status_wall_ns
        waited_ns = wall_ns - (self._started_wall_ns or 0)
        if last_ns is None and vehicle.armed is None and waited_ns < FIRST_STATUS_TIMEOUT_NS:
            return
        changes, self._authority.changes = self._authority.changes, []
        for control_state in changes:
            yield Publish(STATUS, self._status(control_state, vehicle))
        control_state = self._authority.control_state
        visible = (*control_state.visible, vehicle.armed, vehicle.landed, vehicle.mode)
        changed = visible != self._last_visible and not (changes and changes[-1] == control_state)
        if changed or last_ns is None or wall_ns - last_ns >= STATUS_PERIOD_NS:
            yield Publish(STATUS, self._status(control_state, vehicle))
            self._status_wall_ns = wall_ns
        self._last_visible = visible

    def _status(self, control_state: ControlState, vehicle: VehicleSnapshot) -> Status:
        telemetry, wind = self._link.telemetry, self._wind.wind
        if control_state.code is StatusCode.EXTERNAL:
            not_ready_reason = f"not under the bridge's command: {control_state.text}"
        elif control_state.code is not StatusCode.IDLE and vehicle.telemetry_age_s <= LINK_TIMEOUT_S:
            not_ready_reason = ""
        else:
            not_ready_reason = self._not_ready_reason(vehicle.telemetry_age_s)
        return Status(
            t_ns=max(0, vehicle.t_ns),
            code=int(control_state.code),
            name=control_state.code.name,
            odometry=telemetry.odometry,
            armed=bool(vehicle.armed),
            landed=vehicle.landed,
            autopilot_mode=vehicle.mode,
            in_charge=control_state.in_charge,
            goal_id=control_state.goal_id,
            action=control_state.action,
            grant=control_state.grant,
            bridge_boot_id=self._boot_id,
            grants=control_state.grants,
            interventions=control_state.interventions,
            epoch_id=self._epoch_id or 0,
            ready=not not_ready_reason,
            not_ready_reason=not_ready_reason,
            battery=telemetry.battery,
            text=control_state.text[:TEXT_MAX],
            wind_ned_mps=None if wind is None else wind.mean_ned_mps,
            std_gust_mps=None if wind is None else wind.std_gust_mps,
            paused=control_state.paused,
            takeoff_ned_m=self._ground_ned_m if vehicle.armed else None,
            fence_id=self._fence.fence_id,
        )

    def _subscribe(self) -> Iterator[Output]:
        """Subscribe to the altimeter, which is needed while armed only."""
        needed = bool(self._link.telemetry.armed) or self._authority.code is not StatusCode.IDLE
        if needed != self._altimeter_subscribed:
            self._altimeter_subscribed = needed
            yield Subscribe((ALTIMETER,) if needed else ())

    def _publish_health(self, vehicle: VehicleSnapshot, wall_ns: int) -> Iterator[Output]:
        state: ServiceState = "ok"
        text = f"{status_words(self._authority.code)}; the autopilot is linked"
        if vehicle.telemetry_age_s > LINK_TIMEOUT_S or self._epoch_id is None:
            state = "starting" if self._link.telemetry.received_wall_ns is None else "degraded"
            text = self._not_ready_reason(vehicle.telemetry_age_s)
        elif self._authority.code is StatusCode.IDLE and (reason := self._not_ready_reason(vehicle.telemetry_age_s)):
            state, text = "degraded", reason
        elif too_rare := self._too_rare_reason():
            state = "degraded"
            text += f"; {too_rare}"
        if self._dropped_setpoints:
            text += f"; {self._dropped_setpoints} setpoints dropped, the last: {self._drop_reason}"
        if self._fence.outside:
            state = "degraded"
        text += self._fence.health_text
        if self._gimbal is not None and (problem := self._gimbal.problem(wall_ns)):
            state = "degraded"
            text += f"; {problem}"
        text += "".join(f"; {sentence}" for sentence in self._link_sentences())
        if (state, text) != self._health:
            self._health = (state, text)
            yield Health(state, text)

    def _link_sentences(self) -> Iterator[str]:
        """What there is to say about the link and the autopilot behind it."""
        link = self._link
        rate, version = link.rate, link.telemetry.version
        if rate is not None and rate.narrow and rate.hz is not None:
            yield f"the line is too narrow for ODOMETRY: position and attitude instead, {rate.hz:.0f} Hz"
        if self._controller is not None and (offset := self._controller.sync.offset) is not None:
            yield offset.text
            if version is not None:
                yield version_text(version)
            if link.telemetry.altimeter is None:
                yield "the flight controller sends no DISTANCE_SENSOR: without a rangefinder nothing lands"
        if link.parameters.failed:
            yield link.parameters.failure_text
        if link.malformed:
            yield f"{link.malformed} malformed MAVLink messages"
        if link.bad_signatures:
            yield f"{link.bad_signatures} messages without a valid signature were dropped"
        if link.unchecked_signatures:
            yield f"the autopilot signs its messages: name its key with {CONTROLLER_KEY_VARIABLE}"


# -- time -------------------------------------------------------------------------------------------------

AHEAD_MAX_NS = 100_000_000
"""No time-out may be exceeded by more than this."""


class Timer:
    """Elapsed vehicle time that never steps back, from an estimate of vehicle time that may.

    The estimate steps back when the time master stood still and its clock message arrives afterwards. The time until
    the estimate is where it was has been counted already, and is not counted twice, within `AHEAD_MAX_NS`.

    Attributes:
        now_ns: vehicle time since the first update; never steps back.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self._t_ns: int | None = None
        self._ahead_ns = 0
        """Vehicle time that is counted already and has yet to pass."""

    @property
    def started_ns(self) -> int:
        """Vehicle time of the first update."""
        return 0 if self._t_ns is None else self._t_ns - self.now_ns + self._ahead_ns

    def update(self, t_ns: int) -> None:
        """Count the time since the last update; `t_ns` is the present vehicle time."""
        passed_ns = 0 if self._t_ns is None else t_ns - self._t_ns
        self._t_ns = t_ns
        ahead_ns = self._ahead_ns - passed_ns
        if ahead_ns > 0:
            self._ahead_ns = min(ahead_ns, AHEAD_MAX_NS)
        else:
            self._ahead_ns = 0
            self.now_ns -= ahead_ns
