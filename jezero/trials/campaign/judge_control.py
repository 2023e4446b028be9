"""Judges of who commands the vehicle: the bridge on one side of MAVLink, the autopilot on the other.

The bridge has one owner of control and sends only fresh setpoints of that owner; no hover point jumps. In offboard mode
the autopilot gets setpoints or leaves the mode.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import dist, hypot, isfinite

from jezero.base.frames import Vec3, add, altitude_m, horizontal, subtract
from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.runtime.service import Inbox, Output, Publish, Reply, Send, Service
from jezero.schemas import topics
from jezero.schemas.commands import AcquireReply, Setpoint
from jezero.schemas.fence import FenceState
from jezero.schemas.state import Odometry, Status
from jezero.schemas.state import StatusCode as Code
from jezero.schemas.struct import Message
from jezero.schemas.units import NS_PER_S
from jezero.services.autopilot.service import HIL, OFFBOARD
from jezero.trials.campaign.fence import FenceShape
from jezero.trials.campaign.judge import ALLOWED, IN_PROGRESS, Judge

AGE_MAX_S = 0.3
LEAD_MAX_S = 0.05
SAME_DISTANCE_MAX_M = 0.02
STREAM_GAP_MAX_S = 0.2
LATE_OWNER_MAX_S, SILENT_OWNER_MAX_S = 0.6, 1.3
"""Longest time without a setpoint of the goal in charge until the vehicle hovers, and until the goal ends. In each of
them the bridge may have been frozen for a moment."""
LATE_OWNER_MIN_S = 0.3
"""Shortest time without a setpoint after which the bridge may hover."""
TAKE_BACK_TIMEOUT_S = 6.0
HOVER_START_DISTANCE_MAX_M = 3.0
FENCE_REACH_M = 0.5
"""The fence changes targets that lead to less than this distance from it, by position or by the way until a stop."""
POS_IGNORED, VEL_IGNORED, ACC_IGNORED = 7, 56, 448
FLYING = tuple(code for code in Code if code not in (Code.IDLE, Code.EXTERNAL))


@dataclass
class SentTarget:
    """Content of one SET_POSITION_TARGET_LOCAL_NED to the autopilot.

    Attributes:
        pos_ned_m: position setpoint; None if the type mask ignores it.
        vel_ned_mps: velocity setpoint; None if the type mask ignores it.
        finite: whether all numbers in use are finite.
    """

    pos_ned_m: Vec3 | None
    vel_ned_mps: Vec3 | None
    finite: bool


class BridgeJudge:
    """Service that runs a vehicle bridge and checks its outputs against its inputs.

    Args:
        bridge: the bridge.
        judge: collects the violations.
        flights: control ids with which each goal id flew, in any run of the bridge; added to.
        limits: limits of the vehicle, which the bridge holds.
    """

    def __init__(
        self, bridge: Service, judge: Judge, flights: dict[str, set[str]], limits: VehicleLimitsConfig
    ) -> None:
        self.spec = bridge.spec
        self._bridge = bridge
        self._judge = judge
        self._flights = flights
        self._limits = limits
        self._codec = MavlinkCodec(1, 200)
        self._status: Status | None = None
        self._previous: Status | None = None
        """Status of the previous step."""
        self._offsets: dict[int, Vec3] = {0: (0.0, 0.0, 0.0)}
        self._offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._odometry: Odometry | None = None
        self._fence: FenceShape | None = None
        self._followed: list[Setpoint] = []
        """Latest setpoints that the bridge might fly, which the fence limits anew in each step."""
        self._newest: Setpoint | None = None
        """The last setpoint that the bridge might fly."""
        self._target: SentTarget | None = None
        self._target_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._streamed_ns: int | None = None
        self._control_ids: dict[int, str] = {}
        """Control ids by the numbers of their grants, which the status has."""
        self._owner = ("", 0)
        """Control id of the last grant or accepted setpoint, and its time."""
        self._take_back_ns: int | None = None
        self._stepped_ns = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Step the bridge, then check its outputs."""
        sent: list[MavMessage] = []
        self._previous = self._status
        if any(request.payload.hover_req for request in inbox.requests(topics.HOVER)):
            self._take_back_ns = t_ns
        for output in self._bridge.step(t_ns, inbox):
            if type(output) is Send:
                sent += self._codec.parse(output.data)
            elif type(output) is Publish:
                self._on_publish(t_ns, output.message)
            elif type(output) is Reply and isinstance(output.payload, AcquireReply) and output.payload.granted:
                self._on_grant(t_ns, output.payload, inbox)
            yield output
        if self._status is not None:
            self._judge_step(t_ns, inbox, self._status, sent)
        self._stepped_ns = t_ns

    # -- the bus -------------------------------------------------------------------------------------------

    def _on_publish(self, t_ns: int, message: Message) -> None:
        if type(message) is Odometry:
            self._on_odometry(message)
        elif type(message) is Status:
            self._on_status(t_ns, message)
        elif type(message) is FenceState:
            self._fence = None if message.fence is None else FenceShape(message.fence)

    def _on_odometry(self, odometry: Odometry) -> None:
        last = self._odometry
        # A bridge that has just started doesn't know the epoch yet and publishes 0.
        if last is not None and (
            last.epoch_id not in (0, odometry.epoch_id) or odometry.reset_counter < last.reset_counter
        ):
            self._offsets = {}
            self._target = None
        self._odometry = odometry
        self._offset_ned_m = odometry.reset_offset_ned_m
        self._offsets[odometry.reset_counter] = odometry.reset_offset_ned_m

    def _on_status(self, t_ns: int, status: Status) -> None:
        previous, self._status = self._status, status
        code = Code(status.code)
        if previous is None:
            self._judge.states[code.name] += 1
            starts = code in (Code.IDLE, Code.EXTERNAL)
            self._judge.check(starts, t_ns, "only allowed status transitions", f"a bridge starts in {code.name}")
        elif previous.code != code:
            self._judge.states[code.name] += 1
            text = f"{previous.name} to {code.name}: {status.text}"
            allowed = (Code(previous.code), code) in ALLOWED
            self._judge.check(allowed, t_ns, "only allowed status transitions", text)

        if (control_id := self._control_id(status)) and code in IN_PROGRESS:
            flights = self._flights.setdefault(status.goal_id, set())
            flights.add(control_id)
            text = f"goal {status.goal_id} flies for the {len(flights)}th time"
            self._judge.check(len(flights) == 1, t_ns, "a goal sent twice runs once", text)

    def _on_grant(self, t_ns: int, reply: AcquireReply, inbox: Inbox) -> None:
        """Check that control is granted to one goal at a time."""
        self._control_ids[reply.grants] = reply.control_id
        held = self._control_id(self._previous)
        ended = any(inbox.requests(e) for e in (topics.RELEASE, topics.HOVER, topics.ABORT, topics.KILL))
        once = held in ("", reply.control_id) or ended
        text = f"{reply.control_id} is granted while {held} is in charge"
        self._judge.check(once, t_ns, "one owner at most", text)
        self._owner = (reply.control_id, t_ns) if self._owner[0] != reply.control_id else self._owner

    def _control_id(self, status: Status | None) -> str:
        """Control id of the goal in charge by a status, "" without one."""
        return "" if status is None else self._control_ids.get(status.grant, "")

    # -- MAVLink -------------------------------------------------------------------------------------------

    def _judge_step(self, t_ns: int, inbox: Inbox, status: Status, sent: list[MavMessage]) -> None:
        allowed = [setpoint for setpoint in inbox.new(topics.SETPOINT) if self._is_allowed(t_ns, setpoint, status)]
        if allowed:
            self._owner = (self._control_id(status), t_ns)
            self._followed = allowed
            self._newest = allowed[-1]
        self._judge_owner(t_ns, inbox, status)
        silent = status.code == Code.EXTERNAL and self._previous is not None and self._previous.code == Code.EXTERNAL
        if silent and not self._is_taking_back(t_ns):
            self._judge_silence(t_ns, status, sent)
        for message in sent:
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                self._on_target(t_ns, inbox, status, _read(message), allowed)
        self._judge_stream(t_ns, status)

    def _is_allowed(self, t_ns: int, setpoint: Setpoint, status: Status) -> bool:
        """Whether the bridge may fly this setpoint, by its owner, age and number."""
        owner = self._control_id(status) or self._control_id(self._previous)
        now_ns = t_ns if self._odometry is None else max(t_ns, self._odometry.t_ns)  # the later one, as the bridge's
        age_s = (now_ns - setpoint.t_ns) / NS_PER_S
        newest = self._newest
        is_next = newest is None or newest.control_id != owner or setpoint.sequence > newest.sequence
        return bool(owner) and setpoint.control_id == owner and is_next and -LEAD_MAX_S <= age_s <= AGE_MAX_S

    def _judge_owner(self, t_ns: int, inbox: Inbox, status: Status) -> None:
        in_charge = self._control_id(status)
        if not in_charge:
            return
        owner, since_ns = self._owner
        silent_s = (t_ns - since_ns) / NS_PER_S
        if in_charge != owner or silent_s > SILENT_OWNER_MAX_S:
            text = f"{in_charge} is in charge, its last setpoint came {silent_s:.2f} s ago"
            self._judge.check(False, t_ns, "a silent goal loses control", text)
        elif silent_s > LATE_OWNER_MAX_S and not (self._target is None or self._target.vel_ned_mps is None):
            text = f"{in_charge} sent its last setpoint {silent_s:.2f} s ago, and the vehicle flies on"
            self._judge.check(self._may_be_changed(self._target), t_ns, "a late goal hovers", text)
        if any(request.payload.control_id == owner for request in inbox.requests(topics.RELEASE)):
            text = f"{owner} released control and is still in charge"
            self._judge.check(False, t_ns, "released control stays released", text)

    def _is_taking_back(self, t_ns: int) -> bool:
        since_ns = self._take_back_ns
        return since_ns is not None and t_ns - since_ns <= TAKE_BACK_TIMEOUT_S * NS_PER_S

    def _judge_silence(self, t_ns: int, status: Status, sent: list[MavMessage]) -> None:
        """Check that in status 13 the bridge sends no setpoint and no flight command unless hover was requested."""
        flight_commands = (dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_CMD_COMPONENT_ARM_DISARM)
        for message in sent:
            kind = message.get_msgId()
            streams = kind == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
            is_command = kind == dialect.MAVLINK_MSG_ID_COMMAND_LONG and message.command in flight_commands
            forces = is_command and message.param1 == 0.0 and "motors cut" in status.text
            text = f"{message.get_type()} in status 13 ({status.text})"
            self._judge.check(forces or not (streams or is_command), t_ns, "silence after a failsafe or takeover", text)

    def _on_target(self, t_ns: int, inbox: Inbox, status: Status, sent: SentTarget, allowed: list[Setpoint]) -> None:
        if not sent.finite:
            self._judge.check(False, t_ns, "only finite setpoints", f"{sent} was sent to the autopilot")
        gap_s = 0.0 if self._streamed_ns is None else (t_ns - self._streamed_ns) / NS_PER_S
        self._streamed_ns = t_ns
        moved_ned_m = subtract(self._offset_ned_m, self._target_offset_ned_m)
        previous, self._target, self._target_offset_ned_m = self._target, sent, self._offset_ned_m
        hovers_on = status.code == Code.HOVER and self._previous is not None and self._previous.code == Code.HOVER
        if previous is not None and (gap_s < 1.0 or hovers_on) and _is_same(previous, sent, moved_ned_m):
            return
        if self._may_be_changed(sent):
            return
        if sent.pos_ned_m is not None and self._is_late(t_ns, status):
            self._judge_hover_point(t_ns, inbox, sent.pos_ned_m, previous, moved_ned_m)
        elif status.grant and not self._is_requested_hover(inbox, status, sent):
            explained = any(self._matches_setpoint(setpoint, sent) for setpoint in allowed)
            text = f"{sent.pos_ned_m}, {sent.vel_ned_mps} matches no recent setpoint of {self._control_id(status)}"
            self._judge.check(explained, t_ns, "only the owner's fresh setpoints", text)
        elif status.code == Code.HOVER and sent.pos_ned_m is not None:
            self._judge_hover_point(t_ns, inbox, sent.pos_ned_m, previous, moved_ned_m)

    def _is_late(self, t_ns: int, status: Status) -> bool:
        """Whether the goal in charge has been silent for so long that the vehicle may hover."""
        return bool(status.grant) and t_ns - self._owner[1] > LATE_OWNER_MIN_S * NS_PER_S

    def _may_be_changed(self, sent: SentTarget) -> bool:
        """Whether a target that nobody asked for may be sent, because the fence or the vehicle's limits are near."""
        return self._may_fence_change(sent) or self._may_limits_change()

    def _may_limits_change(self) -> bool:
        """Whether the setpoints lead beyond the limits of height and distance, or the vehicle brakes before them."""
        if self._odometry is None:
            return False

        def room_m(point_ned_m: Vec3) -> float:
            height_m, away_m = altitude_m(point_ned_m[2]), horizontal(point_ned_m)
            return min(self._limits.altitude_max_m - height_m, self._limits.distance_max_m - away_m)

        points = [setpoint.pos_ned_m for setpoint in self._followed if setpoint.pos_ned_m is not None]
        speed_mps = hypot(*self._odometry.vel_uav_ned_mps)
        brakes = room_m(self._odometry.pos_uav_ned_m) < FENCE_REACH_M + speed_mps * speed_mps / 2.0
        return brakes or any(room_m(point) < 0.0 for point in points)

    def _may_fence_change(self, sent: SentTarget) -> bool:
        """Whether the bridge may send another target as the fence is near; `FenceJudge` judges where that leads.

        The floor counts from what the altimeter measures, so that it may be near at any height.
        """
        if self._fence is None or self._odometry is None:
            return False
        here_ned_m = self._odometry.pos_uav_ned_m
        points = [sent.pos_ned_m, *(setpoint.pos_ned_m for setpoint in self._followed)]
        lead_m = max((dist(point, here_ned_m) for point in points if point is not None), default=0.0)
        velocities = [self._odometry.vel_uav_ned_mps, *(setpoint.vel_ned_mps for setpoint in self._followed)]
        speed_mps = max(hypot(*velocity) for velocity in velocities if velocity is not None)
        reach_m = FENCE_REACH_M + max(lead_m, speed_mps * speed_mps / 2.0)
        return self._fence.fence.floor_over_ground_m > 0.0 or self._fence.beyond_m(here_ned_m) > -reach_m

    def _judge_hover_point(
        self, t_ns: int, inbox: Inbox, pos_ned_m: Vec3, previous: SentTarget | None, moved_ned_m: Vec3
    ) -> None:
        """Check that a hover point starts near the vehicle and moves on request only, also after a pause."""
        was_ned_m = None if previous is None else previous.pos_ned_m
        stays = was_ned_m is not None and dist(add(was_ned_m, moved_ned_m), pos_ned_m) < SAME_DISTANCE_MAX_M
        if stays or inbox.requests(topics.HOVER):
            return
        if self._previous is not None and self._previous.code == Code.HOVER and not self._previous.grant:
            text = f"from {was_ned_m} to {pos_ned_m} without a request"
            self._judge.check(False, t_ns, "no jump of a hover point", text)
        elif self._odometry is not None:
            distance_m = dist(pos_ned_m, self._odometry.pos_uav_ned_m)
            text = f"the hover starts {distance_m:.1f} m from the vehicle"
            self._judge.check(distance_m <= HOVER_START_DISTANCE_MAX_M, t_ns, "no jump of a hover point", text)

    def _is_requested_hover(self, inbox: Inbox, status: Status, sent: SentTarget) -> bool:
        """Whether a hover was requested in this step, before control was granted in the same step."""
        if status.code != Code.HOVER or sent.pos_ned_m is None or self._odometry is None:
            return False
        here_ned_m = self._odometry.pos_uav_ned_m
        hovers = (request.payload for request in inbox.requests(topics.HOVER) if request.payload.hover_req)
        return any(
            dist(sent.pos_ned_m, hover.hover_pos or here_ned_m)
            <= (SAME_DISTANCE_MAX_M if hover.hover_pos else HOVER_START_DISTANCE_MAX_M)
            for hover in hovers
        )

    def _matches_setpoint(self, setpoint: Setpoint, sent: SentTarget) -> bool:
        offset_ned_m = self._offsets.get(setpoint.reset_counter)
        if (setpoint.pos_ned_m is None) != (sent.pos_ned_m is None):
            return False
        if setpoint.pos_ned_m is None or sent.pos_ned_m is None:
            return (setpoint.vel_ned_mps is None) == (sent.vel_ned_mps is None) and (
                setpoint.vel_ned_mps is None
                or dist(setpoint.vel_ned_mps, sent.vel_ned_mps or ()) <= SAME_DISTANCE_MAX_M
            )
        if offset_ned_m is None:
            return False
        expected = add(setpoint.pos_ned_m, subtract(self._offset_ned_m, offset_ned_m))
        return dist(expected, sent.pos_ned_m) <= SAME_DISTANCE_MAX_M

    def _judge_stream(self, t_ns: int, status: Status) -> None:
        """Check that the bridge streams setpoints while it flies the vehicle, unless the bridge itself was frozen."""
        flies = status.code in FLYING and status.armed and not status.landed
        if not flies or self._previous is None or self._previous.code not in FLYING or t_ns - self._stepped_ns > 5e7:
            self._streamed_ns = t_ns if flies else None
            return
        gap_s = 0.0 if self._streamed_ns is None else (t_ns - self._streamed_ns) / NS_PER_S
        if gap_s > STREAM_GAP_MAX_S:
            text = f"no setpoint for {gap_s:.2f} s in status {status.name}"
            self._judge.check(False, t_ns, "never without a commander", text)


def _read(message: MavMessage) -> SentTarget:
    mask = message.type_mask
    pos = None if mask & POS_IGNORED else (message.x, message.y, message.z)
    vel = None if mask & VEL_IGNORED else (message.vx, message.vy, message.vz)
    acc = (0.0, 0.0, 0.0) if mask & ACC_IGNORED else (message.afx, message.afy, message.afz)
    numbers = (*(pos or ()), *(vel or ()), *acc, message.yaw)
    return SentTarget(pos, vel, all(isfinite(number) for number in numbers))


def _is_same(previous: SentTarget, current: SentTarget, moved_ned_m: Vec3) -> bool:
    if (previous.pos_ned_m is None) != (current.pos_ned_m is None) or (previous.vel_ned_mps is None) != (
        current.vel_ned_mps is None
    ):
        return False
    same_pos = (
        current.pos_ned_m is None
        or dist(add(previous.pos_ned_m or current.pos_ned_m, moved_ned_m), current.pos_ned_m) < SAME_DISTANCE_MAX_M
    )
    return same_pos and (
        current.vel_ned_mps is None or dist(previous.vel_ned_mps or (), current.vel_ned_mps) < SAME_DISTANCE_MAX_M
    )


# -- the autopilot ---------------------------------------------------------------------------------------

OFFBOARD_LOSS_S = 1.3
"""COM_OF_LOSS_T plus the time until the autopilot reacts."""
SETPOINT_AGE_MAX_S = 0.3
"""Highest age of a setpoint that reaches the autopilot, without the delays of link faults."""
MODE_REPORT_PERIOD_MAX_NS = 1_100_000_000
"""The autopilot sends its mode at least this often and at each change, but not while the link is down."""
OFFBOARD_MODE = 6 << 16
ARMED_BIT = dialect.MAV_MODE_FLAG_SAFETY_ARMED
HEADER_BYTES = 10


class AutopilotJudge:
    """Service that runs an autopilot and checks that in offboard mode it gets setpoints or leaves the mode.

    Args:
        autopilot: the autopilot.
        judge: collects the violations.
        link_delay_max_ns: returns the longest delay by a fault of the MAVLink link so far.
        on_gap: called with the time while the autopilot, in offboard mode, gets no setpoints or late ones.
    """

    def __init__(
        self,
        autopilot: Service,
        judge: Judge,
        link_delay_max_ns: Callable[[], int],
        on_gap: Callable[[int], None] = lambda t_ns: None,
    ) -> None:
        self.spec = autopilot.spec
        self._autopilot = autopilot
        self._judge = judge
        self._codec = MavlinkCodec(1, 201)
        self._link_delay_max_ns = link_delay_max_ns
        self._on_gap = on_gap
        steps_at_once = OFFBOARD in autopilot.spec.triggers
        self._stale_s = SETPOINT_AGE_MAX_S + (0.0 if steps_at_once else 1.0 / autopilot.spec.rate_hz)
        self._commanded_ns: int | None = None
        self._offboard_ns: int | None = None
        """Time of the last heartbeat, if the vehicle was armed and in offboard mode; else None."""
        self._stepped_ns = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for message in self._codec.parse(inbox.received(OFFBOARD)):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                self._commanded_ns = t_ns
                age_s = t_ns / NS_PER_S - message.time_boot_ms / 1000.0
                if age_s > self._stale_s:
                    self._on_gap(t_ns)
                if age_s > self._stale_s + self._link_delay_max_ns() / NS_PER_S:
                    text = f"the autopilot gets a setpoint that is {age_s:.2f} s old"
                    self._judge.check(False, t_ns, "no stale setpoint", text)
        for output in self._autopilot.step(t_ns, inbox):
            if isinstance(output, Send) and output.link == OFFBOARD:
                self._read(t_ns, output.data)
            yield output
        if HIL in self.spec.links and not inbox.is_up(HIL):
            self._commanded_ns = t_ns  # without a simulator the autopilot's time stands still
        mode_ns = self._offboard_ns if inbox.is_up(OFFBOARD) else None
        if (
            mode_ns is not None
            and t_ns - mode_ns <= MODE_REPORT_PERIOD_MAX_NS
            and t_ns - self._stepped_ns < MODE_REPORT_PERIOD_MAX_NS / 10
        ):
            silent_s = (t_ns - (self._commanded_ns or 0)) / NS_PER_S
            if silent_s > SETPOINT_AGE_MAX_S:
                self._on_gap(t_ns)
            if silent_s > OFFBOARD_LOSS_S:
                text = f"armed in offboard mode, and no setpoint for {silent_s:.2f} s"
                self._judge.check(False, t_ns, "never without a commander", text)
        self._stepped_ns = t_ns

    def _read(self, t_ns: int, data: bytes) -> None:
        """Read the mode from heartbeats. The bytes come from the autopilot itself, so they are well-formed."""
        at = 0
        while at + HEADER_BYTES <= len(data) and data[at] == 0xFD:
            length = data[at + 1]
            if data[at + 7 : at + 10] == b"\0\0\0":
                payload = data[at + HEADER_BYTES : at + HEADER_BYTES + length].ljust(9, b"\0")
                custom_mode, _, _, base_mode = struct.unpack_from("<IBBB", payload)
                offboard = custom_mode == OFFBOARD_MODE and bool(base_mode & ARMED_BIT)
                self._offboard_ns = t_ns if offboard else None
            at += HEADER_BYTES + length + 2 + (13 if data[at + 2] & 1 else 0)
