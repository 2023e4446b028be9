"""The landing judge and the trials' initial conditions, on numbers worked out by hand."""

from math import hypot, inf

import pytest

from jezero.base.codec import encode
from jezero.base.frames import Vec3
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import LandFeedback, LandPhase
from jezero.schemas.state import Truth
from jezero.trials.landing.judge import LandingJudge, percentile
from jezero.trials.landing.trial import Conditions, draw_trial

STILL: Vec3 = (0.0, 0.0, 0.0)
MS = 1_000_000


def truth(t_ms: int, pos: Vec3, vel: Vec3 = STILL, yaw_rad: float = 0.0, force_n: float = 0.0) -> Truth:
    """The rover is at (10, 0, -0.5) and drives north at 1 m/s."""
    return Truth(
        t_ns=t_ms * MS,
        epoch_id=1,
        pos_uav_ned_m=pos,
        vel_uav_ned_mps=vel,
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=STILL,
        pos_rover_ned_m=(10.0 + t_ms / 1000.0, 0.0, -0.5),
        vel_rover_ned_mps=(1.0, 0.0, 0.0),
        yaw_rover_rad=yaw_rad,
        wind_ned_mps=STILL,
        contact_force_n=force_n,
        armed_motors=True,
    )


def relative(t_ms: int, pos: Vec3, vel: Vec3) -> Relative:
    """With a variance of 0.04 in each dimension."""
    diagonal = (0, 6, 11, 15, 18, 20)
    return Relative(
        t_ns=t_ms * MS,
        epoch_id=1,
        valid=True,
        pos_uav_rel_rover_ned_m=pos,
        vel_uav_rel_rover_ned_mps=vel,
        cov=tuple(0.04 if i in diagonal else 0.0 for i in range(21)),
        vel_rover_ned_mps=(1.0, 0.0, 0.0),
        yaw_rover_rad=0.0,
        yaw_rate_rover_rps=0.0,
        use_uwb=True,
        use_tag=True,
        goal_id="g",
    )


def test_the_estimate_is_compared_with_the_truth_of_its_own_time() -> None:
    judge = LandingJudge()
    judge.start(0)
    judge(0, topics.TRUTH.name, encode(truth(0, (10.0, 1.0, -2.5))))
    judge(0, topics.RELATIVE.name, encode(relative(10, (0.1, 1.0, -2.0), (-1.0, 0.0, 0.0))))
    judge(0, topics.RELATIVE.name, encode(relative(30, (0.0, 0.0, 0.0), STILL)))
    judge(0, topics.TRUTH.name, encode(truth(20, (10.02, 1.0, -2.5))))
    # the vehicle keeps pace with the rover: offset (0, 1, -2), relative velocity of its truth (-1, 0, 0)
    assert judge.errors.count == [1, 0]
    assert judge.errors.rmse_m(0) == pytest.approx(0.1)
    assert judge.errors.nees == pytest.approx(0.1**2 / 0.04 / 6)


def test_impact_is_the_speed_towards_the_platform_before_the_first_force() -> None:
    judge = LandingJudge()
    judge.start(0)
    for message in (
        truth(0, (10.0, 0.0, -0.6), (1.0, 0.0, 0.4)),
        truth(20, (10.02, 0.0, -0.5), (1.0, 0.0, 0.1), force_n=9.0),
    ):
        judge(0, topics.TRUTH.name, encode(message))
    assert judge.impact_mps == pytest.approx(0.4)


def test_a_failed_flight_counts_as_infinite_in_every_percentile() -> None:
    values = [0.01 * i for i in range(1, 20)] + [inf]
    assert percentile(values, 0.5) == pytest.approx(0.10)
    assert percentile(values, 0.95) == pytest.approx(0.19)
    assert percentile(values, 1.0) == inf
    assert percentile([inf], 0.5) == inf


@pytest.mark.parametrize("case", ["uwb+tag", "uwb", "tag"])
def test_a_trial_is_what_the_benchmark_says(case: str) -> None:
    conditions = Conditions(case=case)  # type: ignore[arg-type]
    trials = [draw_trial(seed, conditions) for seed in range(200)]
    assert trials[7] == draw_trial(7, conditions)
    for trial in trials:
        away_m = hypot(*trial.pos_rover_ned_m)
        assert 4.0 <= trial.altitude_m <= 8.0
        assert 1.5 <= away_m <= (0.6 * trial.altitude_m if case == "tag" else 8.0) + 1e-9
        assert 1.0 <= hypot(*trial.rover_position_error_m) <= 3.0
    assert max(hypot(*trial.pos_rover_ned_m) for trial in trials) > (3.5 if case == "tag" else 7.5)
    goal = trials[0].goal((1.0, 2.0, -0.5))
    assert (goal.use_uwb, goal.use_tag) == ("uwb" in case, "tag" in case)
    assert (goal.landing_spot_ned_m is None) == ("uwb" in case)


def test_each_go_around_counts_once_however_many_messages_it_has() -> None:
    judge = LandingJudge()
    judge.start(0)
    phases: tuple[LandPhase, ...] = ("descent", "go_around", "go_around", "approach", "contact", "go_around")
    for phase in phases:
        feedback = LandFeedback(pos_uav_ned_m=STILL, phase=phase)
        message = FeedbackMessage(t_ns=0, goal_id="g", action="land_on_spot", code=8, feedback=feedback)
        judge(0, topics.feedback_of(topics.LAND_ON_SPOT).name, encode(message))
    assert judge.go_arounds == 2


def test_a_vehicle_with_large_rotors_does_not_start_under_the_rover() -> None:
    conditions = Conditions(case="uwb+tag")
    usual, clear = ([draw_trial(seed, conditions, clear_m) for seed in range(200)] for clear_m in (0.0, 2.6))
    assert min(hypot(*trial.pos_rover_ned_m) for trial in clear) >= 2.6
    assert [trial.altitude_m for trial in usual] == [trial.altitude_m for trial in clear]
    assert [trial.yaw_rover_rad for trial in usual] == [trial.yaw_rover_rad for trial in clear]
