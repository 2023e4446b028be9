"""The vehicle bridge: MAVLink on one side, the bus on the other, `Authority` between them."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import cos, inf
from typing import Any

from jezero.frames import altitude_m, horizontal, tilt_from_quat, yaw_from_quat
from jezero.runtime.service import Health, Inbox, Listen, Output, Publish, Reply, Request, Send, Spec
from jezero.schemas.commands import (
    Abort,
    AbortReply,
    Acquire,
    AcquireReply,
    Hover,
    HoverReply,
    Kill,
    KillReply,
    Release,
    ReleaseReply,
)
from jezero.schemas.health import ServiceState
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.struct import Payload
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
    Endpoint,
)
from jezero.services.vehicle_bridge.authority import Authority
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink, Received
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.followed import Followed
from jezero.services.vehicle_bridge.timer import Timer
from jezero.services.vehicle_bridge.vehicle import OFFBOARD, Situation, Standing, Target

LINK = "autopilot"
STATUS_PERIOD_NS = 100_000_000
STREAM_PERIOD_NS = 50_000_000
"""A target that nobody renews is sent again after this: the autopilot wants more than 2 Hz, a hover 10 Hz."""
HEARTBEAT_PERIOD_NS = 1_000_000_000
INTERVALS_PERIOD_NS = 5_000_000_000
ALTIMETER_MAX_AGE_NS = 300_000_000
KILL_REPLY_NS = 3_000_000_000
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

Handle = Callable[[Any, "Situation"], Payload | None]
"""Answers what was asked; None: later."""


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
        self._waiting: list[tuple[Request, int]] = []
        """Releases, hovers and kills that are being done, and the wall time at which each came."""
        self._urgent: tuple[tuple[Endpoint[Any, Any], Handle], ...] = (
            (KILL, self._on_kill),
            (ABORT, self._on_abort),
            (HOVER, self._on_hover),
        )
        self._orderly: tuple[tuple[Endpoint[Any, Any], Handle], ...] = (
            (RELEASE, self._on_release),
            (ACQUIRE, self._on_acquire),
        )
        self._dropped = 0
        self._drop_reason = ""
        self._fresh = False
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
        """Telemetry first, then what was asked, then time; see `Service`."""
        if self._started_wall_ns is None:
            self._started_wall_ns = inbox.wall_ns
        if inbox.connected or self._router_seen_wall_ns is None:
            self._router_seen_wall_ns = inbox.wall_ns
        t_ns = self._not_before_autopilot(t_ns)
        if inbox.latest(CLOCK) is not None:  # before, there is no vehicle time
            self._timer.tell(t_ns)
        received = self._receive(t_ns, inbox)
        t_ns = self._not_before_autopilot(t_ns)
        for odometry in received.odometry:
            yield Publish(ODOMETRY, odometry)
        now = self._situation(t_ns, inbox)
        yield from self._serve(now, inbox)
        self._authority.tick(now)
        if self._waiting:
            yield from self._answer(now, inbox.wall_ns)
        yield from self._command(now, t_ns, inbox)
        yield from self._publish_status(now, inbox.wall_ns)
        yield from self._listen()
        yield from self._report(now)

    # -- in ------------------------------------------------------------------------------------------------

    def _not_before_autopilot(self, t_ns: int) -> int:
        """The autopilot tells vehicle time as well: it goes on where the bridge is cut off from the bus."""
        odometry = self._link.telemetry.odometry
        return t_ns if odometry is None else max(t_ns, odometry.t_ns)

    def _receive(self, t_ns: int, inbox: Inbox) -> Received:
        respawned = False
        for clock in inbox.new(CLOCK):
            respawned |= self._epoch_id not in (None, clock.epoch_id)
            self._epoch_id = clock.epoch_id
        if respawned:
            self._link.forget()
        data = inbox.received(LINK)
        if not (data or respawned):
            return Received()
        received = self._link.receive(data, self._timer.now_ns, inbox.wall_ns, self._epoch_id or 0)
        if respawned or received.restarted:
            self._sent = (None, 0)
            why = "the vehicle was respawned" if respawned else "the autopilot restarted"
            self._authority.restart(why, self._situation(t_ns, inbox))
        if received.followed is not None and self._link.telemetry.mode == OFFBOARD:  # another mode has its own targets
            told_ns, pos_ned_m, vel_ned_mps = received.followed
            self._followed.tell(pos_ned_m, vel_ned_mps, t_ns - told_ns, self._timer.now_ns)
        for step_ned_m in received.steps_ned_m:
            self._authority.moved(step_ned_m, self._situation(t_ns, inbox))
            self._ground_z_ned_m += step_ned_m[2]
        telemetry = self._link.telemetry
        if telemetry.armed is False and telemetry.odometry is not None and telemetry.landed is not False:
            self._ground_z_ned_m = telemetry.odometry.pos_uav_ned_m[2]
        return received

    def _situation(self, t_ns: int, inbox: Inbox) -> Situation:
        telemetry = self._link.telemetry
        odometry = telemetry.odometry
        silent_s = inf
        if telemetry.heard_wall_ns is not None:
            silent_s = (inbox.wall_ns - telemetry.heard_wall_ns) * 1e-9
            silent_s = max(silent_s, (t_ns - odometry.t_ns) * 1e-9) if odometry is not None else inf
        q = (1.0, 0.0, 0.0, 0.0) if odometry is None else odometry.q_ned_from_frd
        tilt_rad = tilt_from_quat(q)
        range_m = self._range_m(t_ns, inbox, tilt_rad)
        return Situation(
            t_ns=t_ns,
            timer_ns=self._timer.now_ns,
            armed=telemetry.armed,
            landed=telemetry.armed is False if telemetry.landed is None else telemetry.landed,
            mode=telemetry.mode,
            failsafe=telemetry.failsafe,
            armable=telemetry.armable,
            contested=telemetry.landed is False and self._followed.by_others(self._timer.now_ns),
            pos_ned_m=None if odometry is None else odometry.pos_uav_ned_m,
            vel_ned_mps=(0.0, 0.0, 0.0) if odometry is None else odometry.vel_uav_ned_mps,
            yaw_rad=yaw_from_quat(q),
            tilt_rad=tilt_rad,
            range_m=range_m,
            height_m=self._height_m(range_m),
            silent_s=silent_s,
            not_ready=self._not_ready(silent_s) if self._authority.code is StatusCode.IDLE else "",
            accepted=self._link.accepted,
            complaint=self._link.complaint(self._timer.now_ns),
            router_lost_s=(inbox.wall_ns - (self._router_seen_wall_ns or 0)) * 1e-9,
        )

    def _range_m(self, t_ns: int, inbox: Inbox, tilt_rad: float) -> float | None:
        altimeter = inbox.latest(ALTIMETER) if self._listening else None
        if altimeter is None or altimeter.range_m is None or t_ns - altimeter.t_ns > ALTIMETER_MAX_AGE_NS:
            return None
        return altimeter.range_m * cos(tilt_rad)

    def _height_m(self, range_m: float | None) -> float | None:
        """Above ground or deck by the altimeter, else above the place where the vehicle last stood."""
        odometry = self._link.telemetry.odometry
        if odometry is None or range_m is not None:
            return None if odometry is None else range_m
        return altitude_m(odometry.pos_uav_ned_m[2] - self._ground_z_ned_m)

    def _not_ready(self, silent_s: float) -> str:
        return next(self._missing(silent_s), "") or self._carried()

    def _missing(self, silent_s: float) -> Iterator[str]:
        """Everything that a takeoff lacks, in words."""
        told = self._link.telemetry
        if self._epoch_id is None:
            yield "no vehicle time yet: is the simulator running?"
        if told.heard_wall_ns is None:
            yield "no autopilot heard yet"
        if told.odometry is None:
            yield "the autopilot sends no odometry yet: its estimator is still converging"
        if silent_s > self._config.link_timeout_s:
            yield f"the autopilot's telemetry has been missing for {silent_s:.0f} s"
        if told.origin_deg is None:
            yield "the autopilot has no origin yet: it waits for GNSS"
        if told.armed is None:
            yield "the autopilot has not told yet whether it is armed"
        if setting := self._link.parameters.pending:
            yield f"the autopilot's parameters are being set: {', '.join(setting)}"
        if not told.armable:
            warning = self._link.warning(self._timer.now_ns)
            because = f": {warning}" if warning else ""
            yield f"the autopilot's arming checks don't pass yet in mode {told.mode}{because}"

    def _carried(self) -> str:
        """Why nothing can take off from what the vehicle stands on, or ""."""
        odometry, limit_mps = self._link.telemetry.odometry, self._config.takeoff_speed_max_mps
        if self._authority.code is not StatusCode.IDLE or odometry is None:
            return ""
        speed_mps = horizontal(odometry.vel_uav_ned_mps)
        if speed_mps <= limit_mps:
            return ""
        return f"what the vehicle stands on moves at {speed_mps:.2f} m/s: stop it, {limit_mps:g} m/s is the limit"

    # -- what was asked ------------------------------------------------------------------------------------

    def _serve(self, now: Situation, inbox: Inbox) -> Iterator[Output]:
        """The urgent first; setpoints before the release that follows them."""
        for endpoint, handle in self._urgent:
            for request in inbox.requests(endpoint):
                yield from self._attend(request, handle, now, inbox)
        for setpoint in inbox.new(SETPOINT):
            refusal = self._authority.accept(setpoint, now, self._link.telemetry.resets)
            self._fresh |= not refusal
            if refusal:
                self._dropped += 1
                self._drop_reason = refusal
        for endpoint, handle in self._orderly:
            for request in inbox.requests(endpoint):
                yield from self._attend(request, handle, now, inbox)

    def _attend(self, request: Request, handle: Handle, now: Situation, inbox: Inbox) -> Iterator[Output]:
        """Reply at once where `handle` has an answer, else when it is done."""
        payload = handle(request.payload, now)
        if payload is None:
            self._waiting.append((request, inbox.wall_ns))
        else:
            yield Reply(request.request_id, payload)

    def _on_kill(self, request: Kill, now: Situation) -> KillReply | None:
        if not request.confirm:
            return KillReply(killed=False, reason="kill cuts the motors, in the air too: set confirm to true")
        self._authority.kill("killed on request", now)
        return None

    def _on_abort(self, request: Abort, now: Situation) -> AbortReply:
        text = self._authority.abort(request.reason, now)
        flying = self._authority.code not in (StatusCode.IDLE, StatusCode.EXTERNAL, StatusCode.LANDING_DONE)
        return AbortReply(hovering=flying and not now.landed, reason=text)

    def _on_hover(self, request: Hover, now: Situation) -> HoverReply | None:
        refusal = self._authority.hover(request, now)
        return HoverReply(hover_mode=False, reason=refusal) if refusal else None

    def _on_release(self, request: Release, now: Situation) -> ReleaseReply | None:
        refusal = self._authority.release(request, now, self._link.telemetry.resets)
        return ReleaseReply(released=False, code=int(self._authority.code), reason=refusal) if refusal else None

    def _on_acquire(self, request: Acquire, now: Situation) -> AcquireReply:
        refusal = self._authority.acquire(request, now)
        grant = self._authority.grant
        if refusal or grant is None:
            return AcquireReply(granted=False, reason=refusal, bridge_boot_id=self._boot_id)
        grants = self._authority.standing.grants
        return AcquireReply(granted=True, control_id=grant.control_id, bridge_boot_id=self._boot_id, grants=grants)

    def _answer(self, now: Situation, wall_ns: int) -> Iterator[Output]:
        """Reply to what has been done by now."""
        waiting, self._waiting = self._waiting, []
        for request, since_ns in waiting:
            payload = self._outcome(request.payload, now, wall_ns - since_ns)
            if payload is None:
                self._waiting.append((request, since_ns))
            else:
                yield Reply(request.request_id, payload)

    def _outcome(self, asked: Kill | Hover | Release, now: Situation, waited_ns: int) -> Payload | None:
        """The answer to what was asked, None while it is still being done."""
        authority = self._authority
        code = authority.code
        if isinstance(asked, Kill):
            if now.armed is False and not authority.killing:
                return KillReply(killed=True, reason="the motors are off")
            reason = "the autopilot has not confirmed it, the bridge keeps trying"
            reason += f": {now.complaint}" if now.complaint else ""
            return KillReply(killed=False, reason=reason) if waited_ns > KILL_REPLY_NS else None
        lost = code is StatusCode.EXTERNAL and not authority.taking_back
        moved_on = authority.grant is not None  # already done, and another goal is in charge
        if isinstance(asked, Hover):
            if code is StatusCode.HOVER or lost or moved_on or code is StatusCode.IDLE:
                return HoverReply(hover_mode=code is StatusCode.HOVER, reason=authority.text)
            return None
        if lost or moved_on or code in (StatusCode.HOVER, StatusCode.IDLE):
            return ReleaseReply(released=not lost, code=int(code), reason=authority.text if lost else "")
        return None

    # -- out -----------------------------------------------------------------------------------------------

    def _command(self, now: Situation, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """What goes to the autopilot; the stream at once, and before the order that needs it."""
        link, authority = self._link, self._authority
        if authority.target is None:
            self._followed.forget()
        else:
            last, sent_ns = self._sent
            due = self._fresh or authority.target is not last or self._timer.now_ns - sent_ns >= STREAM_PERIOD_NS
            if due:
                yield Send(LINK, link.setpoint(authority.target, t_ns))
                self._followed.send(authority.target, self._timer.now_ns)
                self._sent = (authority.target, self._timer.now_ns)
        self._fresh = False
        data = link.pursue(authority.wanted, self._timer.now_ns)
        wall_ns = inbox.wall_ns
        if wall_ns - self._heartbeat_wall_ns >= HEARTBEAT_PERIOD_NS:
            self._heartbeat_wall_ns = wall_ns
            data += link.heartbeat()
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
            yield Listen((ALTIMETER,) if needed else ())

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
