"""Fences drawn at random, the requests that set them, action servers that know of no fence, and the judge of fences.

The judge checks that the vehicle stays inside, that goals that leave are refused with the zone, and that none ends
outside.

**The promise** is by the vehicle's own estimate, as nothing that flies knows more: while the bridge flies the vehicle,
the estimate is never more than `BEYOND_MAX_M` beyond the fence. No bridge can prevent that an estimate jumps over the
fence while the vehicle stays where it is. The judge sees such a jump in the difference between estimate and truth. A
jump that is longer than the distance that targets keep from the fence excuses as much as it is long.

Left out, until the vehicle is inside again, because the bridge couldn't act: status 13 (a failsafe, a pilot or a kill
has control), and gaps in the odometry or in the setpoints that reach the autopilot (the bridge or the link was gone).

Distances come from a library: the judge shares no geometry with the bridge.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from math import cos, hypot, sin, tau
from random import Random
from typing import Any

from msgspec.structs import replace
from shapely import Point, Polygon

from jezero.base.codec import decode
from jezero.base.frames import Vec3, add, altitude_m, scale, subtract
from jezero.base.plugins import action_names
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.service import Inbox, Output, Service
from jezero.schemas import topics
from jezero.schemas.actions import Rejected
from jezero.schemas.fence import Fence, FenceReply, FenceState, SetFence, Zone
from jezero.schemas.goals import Goal, GoToGoal, LandOnSpotGoal
from jezero.schemas.state import Odometry, Status, StatusCode, Truth
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.clients import SentGoal
from jezero.trials.campaign.judge import Judge
from jezero.trials.campaign.judge_actions import GoalRecord

FENCED_PROBABILITY = 1.0 / 3.0
"""Share of the seeds that fly with fences."""
UNAWARE_PROBABILITY = 0.5
"""Share of those in which some action servers know of no fence, so that the bridge alone holds the vehicle."""
START_CLEARANCE_M = 1.5
"""Least distance of a zone to stay out of from the place where the vehicle first stands."""
CLIENT = "alice"


class FenceSetter:
    """Sends the requests for fences of one mission.

    Args:
        bus: the bus of the stack.
        rng: draws everything.
        last_s: time of the latest request.
        on_event: called with a sentence for each request.

    Attributes:
        unaware: names of the action servers that know of no fence.
    """

    def __init__(self, bus: MemoryBus, rng: Random, last_s: float, on_event: Callable[[str], None]) -> None:
        self._bus = bus
        self._on_event = on_event
        self._requests: list[SentRequest] = []
        self.unaware: frozenset[str] = frozenset()
        self._drawn: list[tuple[float, Fence | None]] = []
        """Time of each request, after the vehicle was first ready, and its fence."""
        if rng.random() >= FENCED_PROBABILITY:
            return
        if rng.random() < UNAWARE_PROBABILITY:
            self.unaware = frozenset(rng.sample(sorted(action_names()), rng.randint(1, 3)))
        self._drawn.append((0.0, draw_fence(rng)))
        for _ in range(rng.randint(0, 2)):
            fence = draw_fence(rng) if rng.random() < 0.8 else None
            self._drawn.append((rng.uniform(0.0, last_s), fence))

    def start(self) -> None:
        """Send the requests from now on."""
        for after_s, fence in self._drawn:
            self._bus.at(self._bus.t_ns + int(after_s * NS_PER_S), "", partial(self._send, fence))

    def _send(self, fence: Fence | None) -> None:
        self._on_event(f"{CLIENT} requests {'no fence' if fence is None else fence}")
        self._requests.append(self._bus.send_request(topics.SET_FENCE, SetFence(fence=fence), CLIENT))

    @property
    def accepted(self) -> int:
        """Number of requests that were accepted."""
        replies = [reply for request in self._requests for reply in request.replies]
        return sum(isinstance(reply, FenceReply) and reply.accepted for reply in replies)


def draw_fence(rng: Random) -> Fence:
    """Draw a fence around the place where the vehicle first stands, near enough for goals to meet it."""
    center_m = (rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0))
    field = _draw_zone(rng, "field", center_m, (5.0, 13.0))
    zones = [_draw_crater(rng, number) for number in range(rng.choice((0, 0, 1, 1, 2)))]
    return Fence(
        name="mars",
        keep_in=field if rng.random() < 0.9 else None,
        keep_out=tuple(zones),
        ceiling_m=rng.uniform(3.5, 8.0) if rng.random() < 0.5 else None,
        floor_over_ground_m=rng.uniform(0.5, 1.5) if rng.random() < 0.3 else 0.0,
    )


def _draw_crater(rng: Random, number: int) -> Zone:
    while True:
        center_m = (rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0))
        radius_max_m = rng.uniform(1.0, 3.0)
        if hypot(*center_m) > radius_max_m + START_CLEARANCE_M:
            return _draw_zone(rng, f"crater {number}", center_m, (0.7, radius_max_m))


def _draw_zone(rng: Random, name: str, center_m: Sequence[float], radii_m: tuple[float, float]) -> Zone:
    """Draw a polygon whose corners have increasing bearings from its centre, so that its edges don't cross."""
    count = rng.randint(4, 9)
    corners = []
    for index in range(count):
        bearing_rad, radius_m = tau * (index + rng.uniform(0.0, 0.6)) / count, rng.uniform(*radii_m)
        corners.append((center_m[0] + radius_m * cos(bearing_rad), center_m[1] + radius_m * sin(bearing_rad)))
    return Zone(name=name, corners_ned_m=tuple(corners))


class UnawareServer:
    """Service that runs an action server and hides the fence from it, as one would be that is older than fences.

    Args:
        server: the action server.
    """

    def __init__(self, server: Service) -> None:
        self.spec = server.spec
        self._server = server

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """See `Service`."""
        hidden: Any = _WithoutFence(inbox)
        yield from self._server.step(t_ns, hidden)


class _WithoutFence:
    """An inbox whose statuses name no fence."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox

    def latest(self, topic: Any) -> Any:
        message: Any = self._inbox.latest(topic)
        return replace(message, fence_id="") if topic is topics.STATUS and message is not None else message

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inbox, name)


# -- the judge -------------------------------------------------------------------------------------------

BEYOND_MAX_M = 0.3
"""Source: benchmarks/quality/fence.py, in a wind of 8 m/s."""
ESTIMATE_SHIFT_MIN_M = 0.4
"""The bridge keeps targets this far inside."""
SHIFT_WINDOW_NS = 5 * NS_PER_S
"""A motion of the estimate counts for this long after it: the vehicle may have been too fast for its new place."""
GAP_MAX_S = 0.3
SETTLE_NS = 3 * NS_PER_S
"""The vehicle may need this time to stop after the bridge was deaf, dumb or not in control."""
KNOWN_AFTER_NS = 5 * NS_PER_S
"""Time until all action servers know a new fence, also when most messages get lost."""
HISTORY_NS = NS_PER_S
RULE = "stays inside the fence"


class FenceShape:
    """A fence as shapes of a library.

    Attributes:
        names: words of which a refusal must contain one: the zones, the ceiling and the floor.
    """

    def __init__(self, fence: Fence) -> None:
        self.fence = fence
        self._zones = [(Polygon(zone.corners_ned_m), zone is fence.keep_in) for zone in fence.zones]
        self.names = (*(f"'{zone.name}'" for zone in fence.zones), "the ceiling of", "the floor of")

    def beyond_m(self, pos_ned_m: Vec3) -> float:
        """Distance beyond the edge or the ceiling that is violated most; negative inside."""
        place, beyond_m = Point(pos_ned_m[0], pos_ned_m[1]), -1e6
        for polygon, keep_in in self._zones:
            away_m = polygon.exterior.distance(place)
            beyond_m = max(beyond_m, -away_m if polygon.contains(place) is keep_in else away_m)
        if self.fence.ceiling_m is not None:
            beyond_m = max(beyond_m, altitude_m(pos_ned_m[2]) - self.fence.ceiling_m)
        return beyond_m


class FenceJudge:
    """Observer of a bus that checks that the vehicle stays inside the fence.

    Attributes:
        judged_s: time of flight inside a fence that was judged.
        fences: each fence in force, with the time from which on it was.
    """

    def __init__(self, judge: Judge) -> None:
        self.judged_s = 0.0
        self.fences: list[tuple[int, FenceShape | None]] = []
        self._judge = judge
        self._fence_id = ""
        self._shape: FenceShape | None = None
        self._status: Status | None = None
        self._odometry_ns = 0
        self._truths: deque[Truth] = deque()
        self._errors: deque[tuple[int, Vec3]] = deque()
        """Errors of the estimate, since some seconds before the vehicle was last inside."""
        self._judged = False
        """The vehicle was inside since the bridge could last not act."""
        self._excused_ns = 0
        """Last time at which the bridge couldn't act."""

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.FENCE.name:
            self._on_fence(t_ns, decode(FenceState, data))
        elif topic == topics.STATUS.name:
            self._on_status(t_ns, decode(Status, data))
        elif self._shape is None:
            return
        elif topic == topics.TRUTH.name:
            self._on_truth(t_ns, decode(Truth, data))
        elif topic == topics.ODOMETRY.name:
            self._on_odometry(t_ns, decode(Odometry, data))

    def on_gap(self, t_ns: int) -> None:
        """The autopilot gets no setpoints, or late ones."""
        self._excused_ns = t_ns

    def _on_fence(self, t_ns: int, state: FenceState) -> None:
        if state.fence_id == self._fence_id:
            return
        self._fence_id = state.fence_id
        on_ground = self._status is None or self._status.code == StatusCode.IDLE
        text = f"the fence changes in status {'' if self._status is None else self._status.name}"
        self._judge.check(on_ground, t_ns, "the fence changes on the ground only", text)
        self._shape = None if state.fence is None else FenceShape(state.fence)
        self.fences.append((t_ns, self._shape))
        self._judged = False

    def _on_status(self, t_ns: int, status: Status) -> None:
        self._status = status
        if status.code == StatusCode.EXTERNAL:
            self._excused_ns = t_ns

    def _on_truth(self, t_ns: int, truth: Truth) -> None:
        self._truths.append(truth)
        while t_ns - self._truths[0].t_ns > HISTORY_NS:
            self._truths.popleft()

    def _on_odometry(self, t_ns: int, odometry: Odometry) -> None:
        gap_s, self._odometry_ns = (odometry.t_ns - self._odometry_ns) / NS_PER_S, odometry.t_ns
        if max(gap_s, (t_ns - odometry.t_ns) / NS_PER_S) > GAP_MAX_S:
            self._excused_ns = t_ns
        shape, status = self._shape, self._status
        if shape is None or status is None or not self._truths:
            return
        flies = status.code not in (StatusCode.IDLE, StatusCode.EXTERNAL) and status.armed and not status.landed
        if not flies or t_ns - self._excused_ns < SETTLE_NS:
            self._judged = False
            self._errors.clear()
            return
        beyond_m = shape.beyond_m(odometry.pos_uav_ned_m)
        self._errors.append((t_ns, self._error_ned_m(odometry)))
        if beyond_m <= 0.0:
            self._judged = True
            while t_ns - self._errors[0][0] > SHIFT_WINDOW_NS:
                self._errors.popleft()
        if self._judged:
            self.judged_s += max(gap_s, 0.0)
            self._judge_place(t_ns, status, odometry, beyond_m)

    def _judge_place(self, t_ns: int, status: Status, odometry: Odometry, beyond_m: float) -> None:
        if beyond_m <= BEYOND_MAX_M:
            return
        shift_m = self._shift_m()
        north_m, east_m, down_m = odometry.pos_uav_ned_m
        text = (
            f"{beyond_m:.2f} m beyond the fence at {north_m:.2f} {east_m:.2f} {down_m:.2f} in status {status.name} "
            f"({status.text}), while the estimate moved by {shift_m:.2f} m itself"
        )
        excused_m = shift_m if shift_m > ESTIMATE_SHIFT_MIN_M else 0.0
        self._judge.check(beyond_m <= BEYOND_MAX_M + excused_m, t_ns, RULE, text)

    def _error_ned_m(self, odometry: Odometry) -> Vec3:
        """The estimate's error, with the truth of the same time."""
        truth = min(self._truths, key=lambda truth: abs(truth.t_ns - odometry.t_ns))
        moved_ned_m = scale(truth.vel_uav_ned_mps, (odometry.t_ns - truth.t_ns) / NS_PER_S)
        return subtract(odometry.pos_uav_ned_m, add(truth.pos_uav_ned_m, moved_ned_m))

    def _shift_m(self) -> float:
        """Diagonal of the box that holds the recent errors of the estimate."""
        errors = [error for _, error in self._errors]
        return hypot(*(max(axis) - min(axis) for axis in zip(*errors, strict=True)))

    def judge_goals(self, records: Iterable[GoalRecord], goals: Mapping[str, Goal]) -> None:
        """Check that no accepted goal ends outside the fence that was in force.

        Args:
            records: accepted goals.
            goals: all goals by their ids.
        """
        for record in records:
            shape = self._shape_at(record.accepted_ns)
            end_ned_m = end_of(goals[record.goal_id]) if record.goal_id in goals else None
            if shape is not None and end_ned_m is not None:
                beyond_m = shape.beyond_m(end_ned_m)
                text = f"{record.action} {record.goal_id} was accepted and ends {beyond_m:.1f} m beyond the fence"
                self._judge.check(beyond_m <= 0.0, record.accepted_ns, "no goal ends outside the fence", text)

    def judge_refusals(self, sent: Mapping[str, SentGoal]) -> None:
        """Check that each refusal by the fence names the zone, by goals' ids."""
        names = {name for _, shape in self.fences if shape is not None for name in shape.names}
        for goal_id, each in sent.items():
            for reply in (reply for query in each.queries for reply in query.replies):
                if is_fence_refusal(reply):
                    named = any(name in reply.reason for name in names)
                    text = f"{goal_id}: {reply.reason}"
                    self._judge.check(named, self._odometry_ns, "a refusal by the fence names the zone", text)

    def _shape_at(self, t_ns: int) -> FenceShape | None:
        """The fence that every action server knew at a time; None if there was none or another one shortly before."""
        since_ns, shape = next(
            ((since, shape) for since, shape in reversed(self.fences) if since <= t_ns), (t_ns, None)
        )
        return shape if t_ns - since_ns >= KNOWN_AFTER_NS else None


def is_fence_refusal(reply: object) -> bool:
    """Whether a goal was refused because its way leaves the fence."""
    return isinstance(reply, Rejected) and ("leaves the fence" in reply.reason or "outside the fence" in reply.reason)


def end_of(goal: Goal) -> Vec3 | None:
    """Where a goal ends, of goals that say so."""
    if isinstance(goal, GoToGoal) and goal.frame == "world":
        return goal.target_ned_m
    if isinstance(goal, LandOnSpotGoal) and not (goal.use_uwb or goal.use_tag):
        return goal.landing_spot_ned_m
    return None
