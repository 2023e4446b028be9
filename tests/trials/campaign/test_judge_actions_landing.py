"""The campaign's rules of landings find what breaks them."""

from collections.abc import Iterator
from typing import Any

import pytest

from jezero.runtime.service import Inbox, Output, Publish, Reply, Request, Spec
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Result
from jezero.schemas.commands import Phase, Setpoint
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import LandOnSpotGoal, LandResult
from jezero.schemas.state import Truth
from jezero.trials.campaign.judge import Judge
from jezero.trials.campaign.judge_actions import LandOnSpotJudge

S = 1_000_000_000
STILL = (0.0, 0.0, 0.0)
BOTH = LandOnSpotGoal()


class Blind:
    """Accepts a goal and goes down, whatever it sees; then it has succeeded."""

    spec = Spec(name="land_on_spot", outputs=(topics.SETPOINT,))

    def __init__(self, down_mps: float) -> None:
        self.down_mps = down_mps

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        yield Reply(1, Accepted(goal_id="g"), final=False)
        yield Publish(
            topics.SETPOINT,
            Setpoint(t_ns=t_ns, control_id="c", sequence=1, phase=Phase.LANDING, vel_ned_mps=(0.0, 0.0, self.down_mps)),
        )
        result = LandResult(completed=True, touchdown_ned_m=STILL)
        yield Reply(1, Result(goal_id="g", t_ns=t_ns, outcome="succeeded", result=result))


class OneGoal:
    """An inbox with one goal and one estimate."""

    def __init__(self, relative: Relative | None, goal: LandOnSpotGoal) -> None:
        self._relative = relative
        self._goal = goal

    def requests(self, endpoint: Any) -> tuple[Request, ...]:
        return (Request(1, "me", self._goal),)

    def latest(self, topic: Any) -> Relative | None:
        return self._relative


def estimate(*, valid: bool = True, goal_id: str = "g", t_ns: int = 10 * S) -> Relative:
    return Relative(
        t_ns=t_ns,
        epoch_id=1,
        valid=valid,
        pos_uav_rel_rover_ned_m=(0.0, 0.0, -2.0),
        vel_uav_rel_rover_ned_mps=STILL,
        cov=(0.0,) * 21,
        vel_rover_ned_mps=STILL,
        yaw_rover_rad=0.0,
        yaw_rate_rover_rps=0.0,
        use_uwb=True,
        use_tag=True,
        goal_id=goal_id,
    )


def truth(forward_m: float, up_m: float) -> Truth:
    return Truth(
        t_ns=10 * S,
        epoch_id=1,
        pos_uav_ned_m=(forward_m, 0.0, -0.5 - up_m),
        vel_uav_ned_mps=STILL,
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=STILL,
        pos_rover_ned_m=(0.0, 0.0, -0.5),
        vel_rover_ned_mps=STILL,
        yaw_rover_rad=0.0,
        wind_ned_mps=STILL,
        contact_force_n=0.0,
        armed_motors=True,
    )


def violations(
    relative: Relative | None,
    where: Truth,
    *,
    goal: LandOnSpotGoal = BOTH,
    down_mps: float = 0.5,
) -> list[str]:
    judge = Judge()
    judged = LandOnSpotJudge(Blind(down_mps), judge, lambda: where)
    inbox: Any = OneGoal(relative, goal)
    list(judged.step(10 * S, inbox))
    return [violation.rule for violation in judge.violations]


DESCENT = "no descent without a valid estimate of the goal's own selection"
ABOVE = "no landing succeeds above the platform"
TOUCHDOWN = "no touchdown more than 0.2 m off the platform without aborted"


@pytest.mark.parametrize(
    ("relative", "broken"),
    [
        (estimate(), []),
        (None, [DESCENT]),
        (estimate(valid=False), [DESCENT]),
        (estimate(goal_id="another"), [DESCENT]),
        (estimate(t_ns=9 * S), [DESCENT]),
    ],
)
def test_going_down_needs_a_valid_and_fresh_estimate_of_its_own(relative: Relative | None, broken: list[str]) -> None:
    assert violations(relative, truth(0.0, 2.0)) == [*broken, ABOVE]


def test_holding_the_height_and_the_last_half_metre_need_none() -> None:
    assert violations(None, truth(0.0, 2.0), down_mps=0.2) == [ABOVE]
    assert violations(None, truth(0.0, 0.4)) == [ABOVE]


def test_success_in_the_air_is_none() -> None:
    assert violations(estimate(), truth(0.3, 0.09)) == []
    assert violations(estimate(), truth(0.3, 0.11)) == [ABOVE]


def test_a_landing_without_sensors_of_the_rover_is_not_meant() -> None:
    plain = LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=STILL)
    assert violations(None, truth(3.0, 2.0), goal=plain) == []


def test_a_goal_that_is_sent_again_after_its_end_is_not_judged_again() -> None:
    judge = Judge()
    place = truth(0.0, 0.0)
    judged = LandOnSpotJudge(Blind(0.2), judge, lambda: place)
    inbox: Any = OneGoal(estimate(), BOTH)
    list(judged.step(10 * S, inbox))
    place = truth(0.8, 2.3)
    list(judged.step(20 * S, inbox))
    assert judge.violations == []


def test_success_beside_the_board_is_none() -> None:
    assert violations(estimate(), truth(0.69, 0.0)) == []
    assert violations(estimate(), truth(0.71, 0.0)) == [TOUCHDOWN]
