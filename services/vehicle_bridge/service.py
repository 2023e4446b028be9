"""The vehicle bridge: MAVLink on one side, the bus on the other, `Authority` between them."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf

from jezero.frames import Quat, altitude_m
from jezero.runtime.service import Health, Inbox, Output, Publish, Send, Spec, Subscribe
from jezero.schemas.health import ServiceState
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.topics import (
    ABORT,
    ACQUIRE,
    ALTIMETER,
    CLOCK,
    HOVER,
    KILL,
    ODOMETRY,
    RELEASE,
    SETPOINT,
    STATUS,
)
from jezero.services.vehicle_bridge.authority import Authority
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink, Received
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.foreign_setpoints import Followed
from jezero.services.vehicle_bridge.readiness import why_carried, why_not_ready
from jezero.services.vehicle_bridge.request_queue import Questions
from jezero.services.vehicle_bridge.timer import Timer
from jezero.services.vehicle_bridge.vehicle import OFFBOARD, Situation, Standing, Target

LINK = "autopilot"
STATUS_PERIOD_NS = 100_000_000
STREAM_PERIOD_NS = 50_000_000
"""A target that nobody renews is sent again after this: the autopilot wants more than 2 Hz, a hover 10 Hz."""
HEARTBEAT_PERIOD_NS = 1_000_000_000
INTERVALS_PERIOD_NS = 5_000_000_000
ALTIMETER_MAX_AGE_NS = 300_000_000
FIRST_STATUS_NS = 1_500_000_000
"""A bridge that has just started waits this long for the autopilot before it reports 0: the vehicle may be flying."""

SPEC = Spec(
    name="vehicle_bridge",
    inputs=(CLOCK, SETPOINT),
    on_demand=(ALTIMETER,),
    outputs=(ODOMETRY, STATUS),
    last_value=(STATUS,),
    serves=(ACQUIRE, RELEASE, HOVER, ABORT, KILL),
    links=(LINK,),
    triggers=(LINK, SETPOINT.name, ACQUIRE.name, RELEASE.name, HOVER.name, ABORT.name, KILL.name),
)

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)


class VehicleBridge:
    """The one on the bus who commands the autopilot, and the one writer of `status`.

    Args:
        system_id: MAVLink system id of the vehicle.
        boot_id: differs between two runs of the bridge.
    """

    def __init__(self, config: VehicleBridgeConfig, system_id: int, boot_id: int) -> None:
        self.spec = replace(SPEC, rate_hz=config.rate_hz)
        self._config = config
        self._boot_id = boot_id
        self._link = AutopilotLink(system_id, config.parameters)
        self._followed = Followed()
        self._authority = Authority(config, boot_id)
        self._epoch_id: int | None = None
        self._timer = Timer()
        self._ground_z_ned_m = 0.0
        """Height of the last place where the vehicle stood disarmed."""
        self._questions = Questions(self._authority, self._link, boot_id)
        self._dropped = 0
        self._drop_reason = ""
        self._sent: tuple[Target | None, int] = (None, 0)
        self._published: tuple[object, ...] = ()
        self._status_wall_ns: int | None = None
        self._heartbeat_wall_ns = -HEARTBEAT_PERIOD_NS
        self._intervals_wall_ns = -INTERVALS_PERIOD_NS
        self._router_seen_wall_ns: int | None = None
        self._started_wall_ns: int | None = None
        self._listening = False
        self._health: tuple[ServiceState, str] | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Read telemetry, handle requests and setpoints, judge safety and time-outs, fly, publish; see `Service`."""
        if self._started_wall_ns is None:
            self._started_wall_ns = inbox.wall_ns
        if inbox.connected or self._router_seen_wall_ns is None:
            self._router_seen_wall_ns = inbox.wall_ns
        respawned = self._on_clock(inbox)
        t_ns = self._not_before_autopilot(t_ns)
        if self._epoch_id is not None:  # before, there is no vehicle time
            self._timer.tell(t_ns)
        received = self._receive(inbox, respawned=respawned)
        self._digest(received, t_ns, inbox, respawned=respawned)
        now = self._look(self._not_before_autopilot(t_ns), inbox)
        yield from self._handle_requests(now, inbox)
        self._authority.tick(now)
        yield from self._questions.late(now, inbox.wall_ns)
        yield from self._stream(now.t_ns)
        yield from self._order(now, inbox)
        for odometry in received.odometry:
            yield Publish(ODOMETRY, odometry)
        yield from self._publish_status(now, inbox.wall_ns)
        yield from self._listen()
        yield from self._report(now)

    # -- in ------------------------------------------------------------------------------------------------

    def _not_before_autopilot(self, t_ns: int) -> int:
        """Vehicle time by the bus or, if that is later, by the autopilot: where the bridge is cut off from the bus."""
        odometry = self._link.telemetry.odometry
        return t_ns if odometry is None else max(t_ns, odometry.t_ns)

    def _on_clock(self, inbox: Inbox) -> bool:
        """Returns whether the vehicle is another one than before."""
        respawned = False
        for clock in inbox.new(CLOCK):
            respawned |= self._epoch_id not in (None, clock.epoch_id)
            self._epoch_id = clock.epoch_id
        return respawned

    def _receive(self, inbox: Inbox, *, respawned: bool) -> Received:
        if respawned:
            self._link.forget()
        return self._link.receive(inbox.received(LINK), self._timer.now_ns, inbox.wall_ns, self._epoch_id or 0)

    def _digest(self, received: Received, t_ns: int, inbox: Inbox, *, respawned: bool) -> None:
        """Update everything that depends on what the autopilot sent."""
        if respawned or received.restarted:
            self._sent = (None, 0)
            why = "the vehicle was respawned" if respawned else "the autopilot restarted"
            self._authority.restart(why, self._look(t_ns, inbox))
        if received.followed is not None and self._link.telemetry.mode == OFFBOARD:  # another mode has its own targets
            told_ns, pos_ned_m, vel_ned_mps = received.followed
            self._followed.tell(pos_ned_m, vel_ned_mps, t_ns - told_ns, self._timer.now_ns)
        for step_ned_m in received.steps_ned_m:
            self._authority.moved(step_ned_m, self._look(t_ns, inbox))
            self._ground_z_ned_m += step_ned_m[2]
        telemetry = self._link.telemetry
        if telemetry.armed is False and telemetry.odometry is not None and telemetry.landed is not False:
            self._ground_z_ned_m = telemetry.odometry.pos_uav_ned_m[2]

    def _look(self, t_ns: int, inbox: Inbox) -> Situation:
        telemetry = self._link.telemetry
        odometry = telemetry.odometry
        silent_s, q = inf, LEVEL
        if odometry is not None:
            q = odometry.q_ned_from_frd
            if telemetry.heard_wall_ns is not None:
                silent_s = max(inbox.wall_ns - telemetry.heard_wall_ns, t_ns - odometry.t_ns) * 1e-9
        range_m = self._range_m(t_ns, inbox, q) if self._listening else None
        timer_ns = self._timer.now_ns
        return Situation(
            t_ns=t_ns,
            timer_ns=timer_ns,
            armed=telemetry.armed,
            landed=telemetry.armed is False if telemetry.landed is None else telemetry.landed,
            mode=telemetry.mode,
            failsafe=telemetry.failsafe,
            armable=telemetry.armable,
            contested=telemetry.landed is False and self._followed.by_others(timer_ns),
            pos_ned_m=None if odometry is None else odometry.pos_uav_ned_m,
            vel_ned_mps=(0.0, 0.0, 0.0) if odometry is None else odometry.vel_uav_ned_mps,
            q_ned_from_frd=q,
            range_m=range_m,
            height_m=self._height_m(range_m),
            silent_s=silent_s,
            not_ready=self._not_ready(silent_s) if self._authority.code is StatusCode.IDLE else "",
            accepted=self._link.accepted,
            complaint=self._link.complaint(timer_ns),
            router_lost_s=(inbox.wall_ns - (self._router_seen_wall_ns or 0)) * 1e-9,
        )

    def _range_m(self, t_ns: int, inbox: Inbox, q_ned_from_frd: Quat) -> float | None:
        altimeter = inbox.latest(ALTIMETER)
        if altimeter is None or altimeter.range_m is None or t_ns - altimeter.t_ns > ALTIMETER_MAX_AGE_NS:
            return None
        _, x, y, _ = q_ned_from_frd
        return altimeter.range_m * (1.0 - 2.0 * (x * x + y * y))

    def _height_m(self, range_m: float | None) -> float | None:
        """Above ground or deck by the altimeter, else above the place where the vehicle last stood."""
        odometry = self._link.telemetry.odometry
        if odometry is None or range_m is not None:
            return None if odometry is None else range_m
        return altitude_m(odometry.pos_uav_ned_m[2] - self._ground_z_ned_m)

    def _not_ready(self, silent_s: float) -> str:
        """Why nothing can take off now, or ""."""
        why = why_not_ready(self._link, self._epoch_id, silent_s, self._timer.now_ns, self._config)
        return why or (why_carried(self._link, self._config) if self._authority.code is StatusCode.IDLE else "")

    # -- what was asked ------------------------------------------------------------------------------------

    def _handle_requests(self, now: Situation, inbox: Inbox) -> Iterator[Output]:
        """Kill, abort and hover go before the setpoints of the same step, release and acquire after them."""
        if inbox.has_requests:
            yield from self._questions.urgent(now, inbox)
        for setpoint in inbox.new(SETPOINT):
            refusal = self._authority.accept(setpoint, now, self._link.telemetry.resets)
            if refusal:
                self._dropped += 1
                self._drop_reason = refusal
        if inbox.has_requests:
            yield from self._questions.orderly(now, inbox)

    # -- out -----------------------------------------------------------------------------------------------

    def _stream(self, t_ns: int) -> Iterator[Output]:
        """The setpoint for the autopilot, when it is another one, or due again.

        Each accepted setpoint is another target, even with the numbers of the last one, and goes out at once.
        """
        target, (last, sent_ns), timer_ns = self._authority.target, self._sent, self._timer.now_ns
        if target is None:
            self._followed.forget()
        elif target is not last or timer_ns - sent_ns >= STREAM_PERIOD_NS:
            yield Send(LINK, self._link.setpoint(target, t_ns))
            self._followed.send(target, timer_ns)
            self._sent = (target, timer_ns)

    def _order(self, now: Situation, inbox: Inbox) -> Iterator[Output]:
        """Orders for the autopilot, after the stream that they need, and what else it is told and asked."""
        data = self._link.pursue(self._authority.wanted, self._timer.now_ns)
        wall_ns = inbox.wall_ns
        if wall_ns - self._heartbeat_wall_ns >= HEARTBEAT_PERIOD_NS:
            self._heartbeat_wall_ns = wall_ns
            data += self._link.heartbeat()
        data += self._set_up(now, wall_ns)
        if data:
            yield Send(LINK, data)

    def _set_up(self, now: Situation, wall_ns: int) -> bytes:
        """Asks for telemetry and sets parameters; nothing of it while others fly and tell of it."""
        told = self._link.telemetry
        if told.heard_wall_ns is None:
            return b""
        data = b""
        others_fly = self._authority.code is StatusCode.EXTERNAL
        blind = now.silent_s > self._config.link_timeout_s
        if wall_ns - self._intervals_wall_ns >= INTERVALS_PERIOD_NS and (blind or not others_fly):
            self._intervals_wall_ns = wall_ns
            data += self._link.intervals()
        if (not others_fly and self._authority.code is not StatusCode.IDLE) or self._authority.taking_back:
            data += self._link.ask_for_heartbeat(wall_ns)
        if told.armed is False and self._authority.code is StatusCode.IDLE:
            data += self._link.set_parameters(wall_ns)
        return data

    def _publish_status(self, now: Situation, wall_ns: int) -> Iterator[Output]:
        last_ns = self._status_wall_ns
        waited_ns = wall_ns - (self._started_wall_ns or 0)
        if last_ns is None and now.armed is None and waited_ns < FIRST_STATUS_NS:
            return
        changes, self._authority.changes = self._authority.changes, []
        for standing in changes:
            yield Publish(STATUS, self._status(standing, now))
        standing = self._authority.standing
        visible = (standing.code, standing.in_charge, standing.control_id, now.armed, now.landed, now.mode)
        news = visible != self._published and not (changes and changes[-1] == standing)
        if news or last_ns is None or wall_ns - last_ns >= STATUS_PERIOD_NS:
            yield Publish(STATUS, self._status(standing, now))
            self._status_wall_ns = wall_ns
        self._published = visible

    def _status(self, standing: Standing, now: Situation) -> Status:
        telemetry = self._link.telemetry
        if standing.code is StatusCode.EXTERNAL:
            not_ready = f"not under the bridge's command: {standing.text}"
        elif standing.code is not StatusCode.IDLE and now.silent_s <= self._config.link_timeout_s:
            not_ready = ""
        else:
            not_ready = self._not_ready(now.silent_s)
        return Status(
            t_ns=max(0, now.t_ns),
            code=int(standing.code),
            name=standing.code.name,
            odometry=telemetry.odometry,
            armed=bool(now.armed),
            landed=now.landed,
            autopilot_mode=now.mode,
            in_charge=standing.in_charge,
            goal_id=standing.goal_id,
            control_id=standing.control_id,
            bridge_boot_id=self._boot_id,
            grants=standing.grants,
            epoch_id=self._epoch_id or 0,
            ready=not not_ready,
            not_ready_reason=not_ready,
            battery=telemetry.battery,
            text=standing.text[:2000],
        )

    def _listen(self) -> Iterator[Output]:
        """The altimeter is needed while armed only."""
        needed = bool(self._link.telemetry.armed) or self._authority.code is not StatusCode.IDLE
        if needed != self._listening:
            self._listening = needed
            yield Subscribe((ALTIMETER,) if needed else ())

    def _report(self, now: Situation) -> Iterator[Output]:
        state: ServiceState = "ok"
        text = f"{self._authority.code.name}, linked"
        if now.silent_s > self._config.link_timeout_s or self._epoch_id is None:
            state = "starting" if self._link.telemetry.heard_wall_ns is None else "degraded"
            text = self._not_ready(now.silent_s)
        elif self._authority.code is StatusCode.IDLE and (not_ready := self._not_ready(now.silent_s)):
            state, text = "degraded", not_ready
        if self._dropped:
            text += f"; {self._dropped} setpoints dropped, the last: {self._drop_reason}"
        if self._link.parameters.failed:
            text += f"; {self._link.parameters.complaint}"
        if self._link.malformed:
            text += f"; {self._link.malformed} malformed MAVLink messages"
        if (state, text) != self._health:
            self._health = (state, text)
            yield Health(state, text)
