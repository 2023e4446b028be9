"""Judge of pauses: they come into force, hover at one point, and begin and end without a jump of the setpoints."""

from collections.abc import Iterator
from math import dist
from typing import Any

from jezero.frames import norm
from jezero.plugins import find_action
from jezero.runtime.service import Inbox, Output, Publish, Reply, Service
from jezero.schemas.actions import Accepted, PauseReply, Result, ResumeReply
from jezero.schemas.commands import Phase, Setpoint
from jezero.schemas.goals import Goal
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.judge import Judge

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
