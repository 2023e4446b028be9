"""Judges of the autopilot, the action servers and the vehicle's true attitude."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import cos, degrees, radians
from typing import Any

import msgspec

from jezero.frames import norm, tilt_from_quat
from jezero.mavlink import MavlinkCodec, dialect
from jezero.plugins import find_action
from jezero.runtime.service import Inbox, Output, Reply, Send, Service
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Modify, ModifyReply, Rejected, Result
from jezero.schemas.goals import GetImagesGoal, ImagesResult
from jezero.schemas.state import Truth
from jezero.schemas.units import NS_PER_S
from jezero.services.autopilot.service import HIL, OFFBOARD
from jezero.trials.campaign.judge import Judge

OFFBOARD_LOSS_S = 1.3
"""COM_OF_LOSS_T plus the time until the autopilot reacts."""
SETPOINT_AGE_MAX_S = 0.3
"""Highest age of a setpoint that reaches the autopilot, without the delays of link faults."""
MODE_REPORT_PERIOD_MAX_NS = 1_100_000_000
"""The autopilot sends its mode at least this often and at each change, but not while the link is down."""
OFFBOARD_MODE = 6 << 16
ARMED_BIT = dialect.MAV_MODE_FLAG_SAFETY_ARMED
UPSIDE_DOWN_COS = cos(radians(90.0))
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


@dataclass
class GoalRecord:
    """One accepted goal, from its server's replies.

    Attributes:
        goal_id: the goal's id.
        action: the action's name.
        run: number of the server's run, from 1.
        accepted_ns: time of acceptance.
        outcomes: (t_ns, outcome) of its results; more than one is a violation.
    """

    goal_id: str
    action: str
    run: int
    accepted_ns: int
    outcomes: list[tuple[int, str]] = field(default_factory=list)


class ServerJudge:
    """Service that runs an action server: every accepted goal ends once, every query gets one final reply.

    Args:
        server: the action server.
        run: number of the server's run, from 1.
        judge: collects the violations.
        goals: records of all servers' goals; added to.
    """

    def __init__(self, server: Service, run: int, judge: Judge, goals: list[GoalRecord]) -> None:
        self.spec = server.spec
        self._server = server
        self._run = run
        self._judge = judge
        self._all = goals
        self._goals: dict[str, GoalRecord] = {}
        self._queries: dict[int, str] = {}
        """State of each query for this action, by request id."""
        self._images_expected: dict[str, int] = {}
        """Number of images that each goal takes, by goal id."""
        self._changes: dict[int, Modify] = {}
        """Changes without a reply so far, by request id."""

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        endpoint = find_action(self.spec.name).endpoint
        for request in inbox.requests(endpoint):
            self._queries[request.request_id] = "sent"
            if isinstance(request.payload, GetImagesGoal):
                # A goal that is sent again may have been modified since.
                self._images_expected.setdefault(request.payload.goal_id, request.payload.num_images)
        changes = {
            request.request_id: request.payload for request in inbox.requests(find_action(self.spec.name).modify)
        }
        self._changes.update(changes)
        for output in self._server.step(t_ns, inbox):
            if isinstance(output, Reply) and output.request_id in self._queries:
                self._on_reply(t_ns, output)
            elif isinstance(output, Reply) and isinstance(output.payload, ModifyReply):
                self._on_change(self._changes.pop(output.request_id), output.payload)
            yield output

    def _on_change(self, change: Modify, reply: ModifyReply) -> None:
        """Expect the new number of images of a goal that was modified."""
        if reply.modified and change.goal_id in self._images_expected:
            expected = self._images_expected[change.goal_id]
            self._images_expected[change.goal_id] = change.fields.get("num_images", expected)

    def _on_reply(self, t_ns: int, reply: Reply) -> None:
        state = self._queries[reply.request_id]
        payload: Any = reply.payload
        goal_id = getattr(payload, "goal_id", "")
        rule = "every goal ends exactly once"
        text = f"{type(payload).__name__} for {goal_id} after its query was {state}"
        if isinstance(payload, Accepted):
            self._judge.check(state == "sent", t_ns, rule, text)
            if goal_id not in self._goals:
                self._goals[goal_id] = GoalRecord(goal_id, self.spec.name, self._run, t_ns)
                self._all.append(self._goals[goal_id])
        elif isinstance(payload, Result):
            self._judge.check(state == "accepted", t_ns, rule, text)
            outcomes = self._goals[goal_id].outcomes
            if (payload.t_ns, payload.outcome) not in outcomes:
                outcomes.append((payload.t_ns, payload.outcome))
            self._judge.check(len(outcomes) == 1, t_ns, rule, f"{goal_id} ended {len(outcomes)} times")
            self._check_images(t_ns, payload)
        else:
            expected = "sent" if isinstance(payload, Rejected) else "accepted"
            self._judge.check(state == expected, t_ns, rule, text)
        self._queries[reply.request_id] = "ended" if reply.final else "accepted"

    def _check_images(self, t_ns: int, result: Result[Any]) -> None:
        """Check that images come in order and once each, and that a goal that succeeded has all of them."""
        content = result.result
        if not isinstance(content, ImagesResult):
            return
        indices = [image.index for image in content.images]
        times = [image.t_ns for image in content.images]
        in_order = indices == sorted(set(indices)) and times == sorted(set(times))
        text = f"{result.goal_id} {result.outcome} with images {indices}"
        self._judge.check(in_order, t_ns, "images are taken in order", text)
        all_there = result.outcome != "succeeded" or len(indices) == self._images_expected.get(
            result.goal_id, len(indices)
        )
        self._judge.check(all_there, t_ns, "a goal that succeeded has all its images", text)


class TruthJudge:
    """Observer of a bus that checks the vehicle's true attitude.

    Attributes:
        truth: the latest truth.
        falls_in_epoch: epoch in which the autopilot was killed: the vehicle may fall in any attitude until its respawn.
    """

    def __init__(self, judge: Judge) -> None:
        self.truth: Truth | None = None
        self.falls_in_epoch: int | None = None
        self._judge = judge
        self._decoder = msgspec.json.Decoder(Truth)

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic != topics.TRUTH.name:
            return
        self.truth = truth = self._decoder.decode(data)
        tilt_rad = tilt_from_quat(truth.q_ned_from_frd)
        upright = cos(tilt_rad) > UPSIDE_DOWN_COS or truth.epoch_id == self.falls_in_epoch
        self._judge.check(upright, t_ns, "never upside down", f"tilted by {degrees(tilt_rad):.0f} degrees")

    @property
    def speed_mps(self) -> float:
        return 0.0 if self.truth is None else norm(self.truth.vel_uav_ned_mps)
