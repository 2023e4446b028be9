"""Judges of the action servers: of all goals, of pauses, and of landings on the rover.

Every accepted goal ends once. Pauses come into force, hover at one point, and begin and end without a jump of the
setpoints. A landing descends with an estimate only, and doesn't succeed beside or above the platform.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import dist
from typing import Any

from jezero.base.frames import norm
from jezero.base.plugins import find_action
from jezero.runtime.service import Inbox, Output, Publish, Reply, Service
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Modify, ModifyReply, PauseReply, Rejected, Result, ResumeReply
from jezero.schemas.commands import Phase, Setpoint
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import GetImagesGoal, Goal, ImagesResult, LandOnSpotGoal
from jezero.schemas.state import Truth
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.judge import Judge
from jezero.trials.platform import STANDING_HEIGHT_MAX_M, on_platform_m


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


# -- pauses ----------------------------------------------------------------------------------------------

BRAKING_MAX_S = 12.0
"""Longest time from the reply to a pause until the vehicle hovers, counted in steps of the server."""
STEP_MAX_S = 0.1
"""A server that was frozen for longer goes on with a step of this time."""
ACCELERATION_MAX_MPS2, SPEED_MARGIN_MPS = 1.5, 0.2
"""The speed of the last setpoint before a pause, and of the first one after it, is that of one step from rest; the
margin is for the noise of the positions from which it follows."""
HOVER_MAX_M = 0.02


class PauseJudge:
    """Service that runs an action server and checks the setpoints of its paused goals.

    A landing has a hover of its own, and a goal in the rover's frame hovers along with the rover: of them only the
    replies are judged.

    Args:
        server: the action server.
        judge: collects the violations.
    """

    def __init__(self, server: Service, judge: Judge) -> None:
        self.spec = server.spec
        self._server = server
        self._judge = judge
        self._action = find_action(server.spec.name)
        self._goals: dict[int, Goal] = {}
        """Goals by the ids of their requests."""
        self._ended: set[str] = set()
        """Ids of the goals that have ended."""
        self._moves_with_rover = False
        self._last: Setpoint | None = None
        self._point: Setpoint | None = None
        """First setpoint of the present pause."""
        self._wanted_s: float | None = None
        """Time since a pause was promised that isn't in force yet."""
        self._stepped_ns = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for request in inbox.requests(self._action.endpoint):
            self._goals[request.request_id] = request.payload
        if self._wanted_s is not None:
            self._wanted_s += min((t_ns - self._stepped_ns) / NS_PER_S, STEP_MAX_S)
        self._stepped_ns = t_ns
        for output in self._server.step(t_ns, inbox):
            if isinstance(output, Reply):
                self._on_reply(output)
            elif isinstance(output, Publish) and isinstance(output.message, Setpoint):
                self._on_setpoint(t_ns, output.message)
            yield output

    def _on_reply(self, reply: Reply) -> None:
        payload: Any = reply.payload
        if isinstance(payload, Accepted | Result) and payload.goal_id in self._ended:
            pass  # a goal that is sent again gets its old result, also while another goal is flown
        elif isinstance(payload, Accepted):
            goal = self._goals.get(reply.request_id)
            self._moves_with_rover = getattr(goal, "frame", "world") == "rover"
        elif isinstance(payload, Result):
            self._ended.add(payload.goal_id)
            self._wanted_s = self._last = self._point = None
        elif isinstance(payload, PauseReply) and payload.paused and self._point is None:
            self._wanted_s = 0.0 if self._wanted_s is None else self._wanted_s
        elif isinstance(payload, ResumeReply) and payload.resumed:
            self._wanted_s = None
        if reply.final:
            self._goals.pop(reply.request_id, None)

    def _on_setpoint(self, t_ns: int, setpoint: Setpoint) -> None:
        last, self._last = self._last, setpoint
        if setpoint.paused:
            self._wanted_s = None
        lands = setpoint.phase == Phase.LANDING
        if self._wanted_s is not None and not lands:
            text = f"no hover {self._wanted_s:.1f} s after the pause was promised"
            self._judge.check(self._wanted_s <= BRAKING_MAX_S, t_ns, "a pause comes into force", text)
        if lands or self._moves_with_rover:
            return
        if setpoint.paused:
            self._judge_hover(t_ns, setpoint)
        if last is not None and last.control_id == setpoint.control_id and last.paused is not setpoint.paused:
            self._judge_edge(t_ns, last, setpoint)
        if not setpoint.paused:
            self._point = None

    def _judge_hover(self, t_ns: int, setpoint: Setpoint) -> None:
        """Check that a paused goal keeps its point, but for the steps of the autopilot's position."""
        point = self._point
        if point is None or point.reset_counter != setpoint.reset_counter or point.control_id != setpoint.control_id:
            self._point = point = setpoint
        away_m = 0.0
        if setpoint.pos_ned_m is not None and point.pos_ned_m is not None:
            away_m = dist(setpoint.pos_ned_m, point.pos_ned_m)
        speed_mps = norm(setpoint.vel_ned_mps or (0.0, 0.0, 0.0))
        text = f"{setpoint.phase}: {setpoint.pos_ned_m} at {speed_mps:.2f} m/s, {away_m:.2f} m from the pause's begin"
        holds = setpoint.pos_ned_m is not None and away_m <= HOVER_MAX_M and speed_mps < SPEED_MARGIN_MPS
        self._judge.check(holds, t_ns, "a paused goal hovers at one point", text)

    def _judge_edge(self, t_ns: int, last: Setpoint, setpoint: Setpoint) -> None:
        """Check that a pause begins and ends at rest."""
        gap_s = (setpoint.t_ns - last.t_ns) / NS_PER_S
        if gap_s > STEP_MAX_S:
            return
        moving = setpoint if last.paused else last
        speed_mps = norm(moving.vel_ned_mps or (0.0, 0.0, 0.0))
        limit_mps = ACCELERATION_MAX_MPS2 * gap_s + SPEED_MARGIN_MPS
        edge = "end" if last.paused else "begin"
        text = f"{setpoint.phase}: {speed_mps:.2f} m/s at the {edge} of a pause"
        self._judge.check(speed_mps <= limit_mps, t_ns, "a pause begins and ends without a jump", text)
        if last.pos_ned_m and setpoint.pos_ned_m and last.reset_counter == setpoint.reset_counter:
            step_m = dist(last.pos_ned_m, setpoint.pos_ned_m)
            text = f"{setpoint.phase}: a step of {step_m:.2f} m at the {edge} of a pause"
            self._judge.check(step_m <= HOVER_MAX_M + gap_s, t_ns, "a pause begins and ends without a jump", text)


# -- landings on the rover -------------------------------------------------------------------------------

DESCENT_SPEED_MIN_MPS = 0.25
"""A lower speed relative to the rover counts as holding the height."""
BLIND_HEIGHT_MAX_M = 0.5
"""Greatest height over the platform at which a landing may go on without an estimate."""
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
