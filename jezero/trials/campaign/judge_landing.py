"""Judge of landings on the rover: no descent without an estimate, and no success beside or above the platform."""

from collections.abc import Callable, Iterator

from jezero.runtime.service import Inbox, Output, Publish, Reply, Service
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Result
from jezero.schemas.commands import Setpoint
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.state import Truth
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.judge import Judge
from jezero.trials.platform import STANDING_HEIGHT_MAX_M, on_platform_m

DESCENT_SPEED_MIN_MPS = 0.25
"""A lower speed relative to the rover counts as holding the height."""
BLIND_HEIGHT_MAX_M = 0.5
"""Below this height over the platform the landing may continue without an estimate."""
ESTIMATE_AGE_MAX_NS = 350_000_000
OFF_PLATFORM_MAX_M = 0.2
PLATFORM_HALF_SIDE_M = 0.5


class LandOnSpotJudge:
    """Service that runs the action server of land_on_spot and checks its setpoints and results.

    Args:
        server: the action server.
        judge: collects the violations.
        truth: returns the latest truth.
    """

    def __init__(self, server: Service, judge: Judge, truth: Callable[[], Truth | None]) -> None:
        self.spec = server.spec
        self._server = server
        self._judge = judge
        self._truth = truth
        self._requests: dict[int, LandOnSpotGoal] = {}
        self._goal: LandOnSpotGoal | None = None
        self._goal_id = ""
        self._ended: set[str] = set()

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for request in inbox.requests(topics.LAND_ON_SPOT.endpoint):
            self._requests[request.request_id] = request.payload
        for output in self._server.step(t_ns, inbox):
            if isinstance(output, Reply):
                self._on_reply(t_ns, output)
            elif isinstance(output, Publish) and isinstance(output.message, Setpoint):
                self._on_setpoint(t_ns, output.message, inbox.latest(topics.RELATIVE))
            yield output

    def _on_reply(self, t_ns: int, reply: Reply) -> None:
        payload, goal = reply.payload, self._requests.get(reply.request_id)
        if isinstance(payload, Accepted | Result) and payload.goal_id in self._ended:
            pass  # a goal sent again gets its old result, wherever the vehicle is by now
        elif isinstance(payload, Accepted) and goal is not None and (goal.use_uwb or goal.use_tag):
            self._goal, self._goal_id = goal, payload.goal_id
        elif isinstance(payload, Result) and payload.goal_id == self._goal_id:
            if payload.outcome == "succeeded" and self._goal is not None:
                self._on_success(t_ns)
            self._goal = None
            self._ended.add(payload.goal_id)
        if reply.final:
            self._requests.pop(reply.request_id, None)

    def _on_setpoint(self, t_ns: int, setpoint: Setpoint, relative: Relative | None) -> None:
        truth, velocity = self._truth(), setpoint.vel_ned_mps
        if self._goal is None or truth is None or velocity is None or on_platform_m(truth)[2] > -BLIND_HEIGHT_MAX_M:
            return
        if setpoint.paused:  # it returns to the height of the pause when the autopilot's own estimate moves
            return
        if velocity[2] - truth.vel_rover_ned_mps[2] <= DESCENT_SPEED_MIN_MPS:
            return
        is_own = relative is not None and relative.valid and relative.goal_id == self._goal_id
        is_fresh = relative is not None and t_ns - relative.t_ns <= ESTIMATE_AGE_MAX_NS
        rule = "no descent without a valid estimate of the goal's own selection"
        estimate = "no estimate"
        if relative is not None:
            age_s = (t_ns - relative.t_ns) / NS_PER_S
            estimate = (
                f"an estimate of {relative.goal_id or 'no goal'}, {age_s:.2f} s old, {relative.reason or 'valid'}"
            )
        self._judge.check(
            is_own and is_fresh, t_ns, rule, f"{self._goal_id} descends at {velocity[2]:.2f} m/s with {estimate}"
        )

    def _on_success(self, t_ns: int) -> None:
        truth = self._truth()
        if truth is None:
            return
        forward_m, right_m, down_m = on_platform_m(truth)
        off_m = max(abs(forward_m), abs(right_m)) - PLATFORM_HALF_SIDE_M
        rule = "no touchdown more than 0.2 m off the platform without aborted"
        text = f"{self._goal_id} succeeded {off_m:.2f} m off the platform, {-down_m:.2f} m above it"
        self._judge.check(off_m <= OFF_PLATFORM_MAX_M, t_ns, rule, text)
        if off_m <= 0.0:
            self._judge.check(-down_m <= STANDING_HEIGHT_MAX_M, t_ns, "no landing succeeds above the platform", text)
