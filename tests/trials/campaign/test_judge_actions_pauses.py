"""The campaign's rules of pauses find what breaks them, and leave goals in the rover's frame alone."""

from collections.abc import Iterator
from typing import Any

import pytest

from jezero.base.frames import Vec3
from jezero.runtime.service import Inbox, Output, Publish, Reply, Request, Spec
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Result
from jezero.schemas.commands import Phase, Setpoint
from jezero.schemas.goals import Goal, GoToGoal, MoveResult
from jezero.trials.campaign.judge import Judge
from jezero.trials.campaign.judge_actions import PauseJudge

STEP_NS = 20_000_000
TARGET_NED_M = (1.0, 0.0, -3.0)
WORLD = GoToGoal(goal_id="world", target_ned_m=TARGET_NED_M)
ROVER = GoToGoal(goal_id="rover", target_ned_m=TARGET_NED_M, frame="rover")
STILL = (0.0, 0.0, 0.0)


class Script:
    """An action server whose outputs a test writes, and its inbox."""

    spec = Spec(name="go_to", outputs=(topics.SETPOINT,))

    def __init__(self) -> None:
        self.judge = Judge()
        self._judged = PauseJudge(self, self.judge)
        self._outputs: tuple[Output, ...] = ()
        self._request: Request | None = None
        self._steps = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        yield from self._outputs

    def requests(self, endpoint: Any) -> tuple[Request, ...]:
        return () if self._request is None else (self._request,)

    def goal(self, goal: Goal, *outputs: Output) -> None:
        """Let the server get a goal and answer it."""
        self._request = Request(self._steps, "me", goal)
        self.play(Reply(self._steps, Accepted(goal_id=goal.goal_id), final=False), *outputs)
        self._request = None

    def end(self, goal: Goal) -> None:
        """Let the server end a goal."""
        self.play(self.result(goal))

    def result(self, goal: Goal) -> Reply:
        result = MoveResult(completed=True, pos_uav_ned_m=TARGET_NED_M)
        return Reply(self._steps, Result(goal_id=goal.goal_id, t_ns=0, outcome="succeeded", result=result))

    def hover(self, pos_ned_m: Vec3) -> None:
        """Let the server publish a setpoint of a paused goal."""
        t_ns = self._steps * STEP_NS
        setpoint = Setpoint(
            t_ns=t_ns,
            control_id="c",
            sequence=self._steps,
            phase=Phase.GO_TO,
            pos_ned_m=pos_ned_m,
            vel_ned_mps=STILL,
            paused=True,
        )
        self.play(Publish(topics.SETPOINT, setpoint))

    def play(self, *outputs: Output) -> None:
        self._outputs = outputs
        list(self._judged.step(self._steps * STEP_NS, self))  # type: ignore[arg-type]
        self._steps += 1

    def rules_broken(self) -> list[str]:
        return [violation.rule for violation in self.judge.violations]


@pytest.mark.parametrize(
    ("goal", "broken"), [(WORLD, ["a paused goal hovers at one point"]), (ROVER, [])], ids=["world", "rover"]
)
def test_a_paused_goal_hovers_at_one_point_unless_it_moves_with_the_rover(goal: Goal, broken: list[str]) -> None:
    script = Script()
    script.goal(goal)
    script.hover(TARGET_NED_M)
    script.hover((1.1, 0.0, -3.0))
    assert script.rules_broken() == broken


def test_an_old_goal_that_is_sent_again_says_nothing_about_the_present_one() -> None:
    script = Script()
    script.goal(WORLD)
    script.end(WORLD)
    script.goal(ROVER)
    script.hover(TARGET_NED_M)
    script.goal(WORLD, script.result(WORLD))
    script.hover((1.1, 0.0, -3.0))
    assert script.rules_broken() == []
