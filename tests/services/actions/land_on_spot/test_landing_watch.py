"""A landing that goes wrong, or flies in too much wind, ends with a reason that names the cause; a gust ends none."""

from math import hypot

import pytest

from jezero.base.frames import Vec3, add
from jezero.schemas.goals import LandPhase
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import LandingBoundsConfig, RoverLandingConfig
from jezero.services.actions.land_on_spot.landing_watch import (
    LandingWatch,
    WindLimit,
    wind_refusal,
    wind_words,
)
from jezero.services.actions.motion.behaviour import VehicleState
from tests.services.actions.land_on_spot.landing_rig import BOTH, TAG, Landing

BOUNDS = LandingBoundsConfig()


def test_a_vehicle_that_stands_on_the_ground_while_the_estimate_says_it_is_high_up_is_disarmed() -> None:
    landing = Landing(BOTH, (5.0, -3.0, -9.5))
    landing.landed = True
    done = landing.run(5.0)
    assert done is not None
    assert (done.outcome, done.then) == ("aborted", "disarm")
    assert "the vehicle stands on the ground, but UWB and tag say 8.9 m above the platform" in done.reason
    assert landing.t_s < 1.0


def test_an_estimate_that_its_inputs_contradict_is_not_followed_and_its_reason_ends_the_landing() -> None:
    landing = Landing(BOTH)
    assert landing.run(1.0) is None
    landing.contradicted = "the estimate says 9.0 m above the platform, the altimeter 0.3 m above what is below"
    before_m = landing.pos_m
    done = landing.run(10.0)
    assert done is not None
    assert (done.outcome, done.then, done.reason) == ("aborted", "hover", landing.contradicted)
    assert landing.t_s == pytest.approx(4.0, abs=0.1)
    assert hypot(landing.pos_m[0] - before_m[0], landing.pos_m[1] - before_m[1]) < 1.5


@pytest.mark.parametrize(
    ("vel_rover_ned_mps", "ends"),
    [
        ((5.1, 0.0, 0.0), True),
        ((0.0, 5.1, 0.0), True),
        ((0.0, -5.1, 0.0), True),
        ((3.6, -3.6, 0.0), True),
        ((0.0, 4.9, 0.0), False),
        ((3.5, -3.5, 0.0), False),
        ((0.0, 4.9, -1.5), False),
    ],
)
def test_a_rover_above_its_top_speed_in_any_direction_for_a_second_ends_the_landing(
    vel_rover_ned_mps: Vec3, ends: bool
) -> None:
    """3.6 m/s on both axes are 5.09 m/s, 3.5 m/s are 4.95 m/s; the bound is 5 m/s, and a heave does not count."""
    rig = Landing(BOTH)
    rig.vel_rover_error_mps = vel_rover_ned_mps
    watch = LandingWatch(RoverLandingConfig(), 0, rig.state())
    assert watch.update(NS_PER_S, rig.state(), "approach", "") is None
    assert watch.update(2 * NS_PER_S - 1, rig.state(), "approach", "") is None
    done = watch.update(2 * NS_PER_S, rig.state(), "approach", "")
    assert (done is not None) is ends
    assert done is None or "the bound is 5 m/s (speed_rover_max_mps)" in done.reason


def test_a_contradiction_that_ends_soon_only_delays_the_landing() -> None:
    landing = Landing(BOTH)
    assert landing.run(1.0) is None
    landing.contradicted = "UWB and tag contradict each other"
    assert landing.run(2.5) is None
    landing.contradicted = ""
    done = landing.run(40.0)
    assert done is not None and done.outcome == "succeeded"


def test_a_platform_that_always_stays_ahead_is_followed_to_the_bound_and_no_farther() -> None:
    landing = Landing(BOTH, speed_mps=1.5)
    start_m = landing.pos_m
    landing.offset_of_estimate_m = (-4.0, 0.0, 0.0)
    while (done := landing.run(1.0)) is None:
        landing.offset_of_estimate_m = add(landing.offset_of_estimate_m, (-1.0, 0.0, 0.0))
    assert done.outcome == "aborted"
    assert "the bound is 150 m (distance_max_m)" in done.reason
    assert hypot(landing.pos_m[0] - start_m[0], landing.pos_m[1] - start_m[1]) < BOUNDS.distance_max_m + 1.0


def test_an_estimate_that_leads_upwards_is_followed_to_the_bound_and_no_higher() -> None:
    landing = Landing(BOTH, (5.0, -3.0, -1.5))
    landing.offset_of_estimate_m = (3.0, 0.0, 20.0)
    done = landing.run(60.0)
    assert done is not None
    assert "the bound is 12 m (climb_max_m)" in done.reason


def test_a_rover_that_is_said_to_drive_faster_than_it_can_ends_the_landing() -> None:
    landing = Landing(BOTH)
    landing.vel_rover_error_mps = (7.4, 0.0, 0.0)
    done = landing.run(10.0)
    assert done is not None
    assert done.reason.startswith("the estimate says that the rover drives at 7.4 m/s, the bound is 5 m/s")
    assert landing.t_s < 1.5


def test_a_descent_that_is_interrupted_again_and_again_ends() -> None:
    landing = Landing(BOTH, sees=lambda t_s, offset_m: offset_m[2] < -3.2 or t_s % 3.0 > 2.7)
    landing.forget_s = 0.6
    landing.grounded = False
    done = landing.run(120.0)
    assert done is not None
    begin = "the descent was interrupted 4 times, "
    assert done.reason.startswith(begin)
    low_m = float(done.reason.removeprefix(begin).split()[0])
    assert 0.2 < low_m < 2.7
    assert " to 2.8 m above the platform: no measurement of the rover for " in done.reason
    assert "check what hides the tags there" in done.reason
    assert "check that the UWB anchors are powered" in done.reason


def test_an_interrupted_descent_by_the_tags_alone_is_not_blamed_on_the_anchors() -> None:
    landing = Landing(TAG, sees=lambda t_s, offset_m: offset_m[2] < -3.2 or t_s % 3.0 > 2.7)
    landing.forget_s = 0.6
    landing.grounded = False
    done = landing.run(120.0)
    assert done is not None
    assert "check what hides the tags there" in done.reason
    assert "anchors" not in done.reason


def test_a_landing_that_never_comes_down_ends_with_the_time_of_each_phase_and_what_to_check() -> None:
    landing = Landing(BOTH)
    landing.std_at = lambda offset_m: 0.45
    done = landing.run(200.0)
    assert done is not None
    assert done.reason.startswith("not landed after 180 s (timeout_s): 1")
    assert " s descent, " in done.reason and " s approach" in done.reason
    assert done.reason.endswith("check the wind and the rover's speed and turns")


@pytest.mark.parametrize(
    ("phases", "words"),
    [
        (
            (("approach", 30), ("search", 60), ("approach", 91)),
            "121 s approach, 60 s search; the rover was out of sight 150 s ago: hidden; the vehicle does not get",
        ),
        (
            (("approach", 80), ("hold", 5), ("search", 96)),
            "96 s search, 80 s approach, 5 s hold; the rover has been out of sight for 100 s: hidden; check what hides",
        ),
    ],
)
def test_a_landing_that_is_too_late_says_how_long_the_rover_was_out_of_sight(
    phases: tuple[tuple[LandPhase, int], ...], words: str
) -> None:
    rig = Landing(BOTH)
    watch, t_s, done = LandingWatch(RoverLandingConfig(), 0, rig.state()), 0, None
    for phase, duration_s in phases:
        for _ in range(duration_s):
            assert done is None
            t_s += 1
            done = watch.update(t_s * NS_PER_S, rig.state(), phase, "hidden")
    assert done is not None
    assert words in done.reason


def test_a_vehicle_on_the_ground_without_an_estimate_is_disarmed() -> None:
    landing = Landing(BOTH)
    landing.landed = landing.silent = True
    done = landing.run(5.0)
    assert done is not None and (done.outcome, done.then) == ("aborted", "disarm")
    assert done.reason == "the vehicle stands on the ground before it has found the platform"
    assert landing.t_s == pytest.approx(0.5, abs=0.05)


def test_a_silent_estimator_is_named_in_what_to_check() -> None:
    rig = Landing(BOTH)
    rig.silent = True
    watch = LandingWatch(RoverLandingConfig(), 0, rig.state())
    watch.update(NS_PER_S, rig.state(), "search", "")
    done = watch.update(181 * NS_PER_S, rig.state(), "search", "the estimator is silent")
    assert done is not None and done.reason.endswith("check that the estimator runs (`jezero ps`)")


def test_the_way_to_the_platform_does_not_lead_below_a_metre_by_the_altimeter() -> None:
    landing = Landing(BOTH, (-1.0, -3.0, -3.0))
    landing.offset_of_estimate_m = (0.0, 0.0, -9.0)
    for _ in range(40):
        landing.range_m = -landing.pos_m[2]
        if landing.run(0.1) is not None:
            break
    assert -landing.pos_m[2] > 0.8


WIND_MAX_MPS = 9.0
STEP_S = 0.1


def in_wind(mean_mps: float | None) -> VehicleState:
    wind_ned_mps = None if mean_mps is None else (0.6 * mean_mps, 0.8 * mean_mps, 0.0)
    return VehicleState(
        (0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), armed=True, landed=False,
        wind_ned_mps=wind_ned_mps, std_gust_mps=2.0,
    )  # fmt: skip


def reasons(*winds: tuple[float | None, float], force: bool = False) -> list[str]:
    """Reasons of all steps in pairs of a mean wind and its duration in s."""
    limit, t_ns, found = WindLimit(WIND_MAX_MPS, force), 0, []
    for mean_mps, duration_s in winds:
        for _ in range(round(duration_s / STEP_S)):
            t_ns += int(STEP_S * NS_PER_S)
            limit.update(t_ns, in_wind(mean_mps))
            found.append(limit.reason)
    return found


def test_a_refusal_names_the_wind_the_limit_its_setting_and_what_to_do() -> None:
    refusal = wind_refusal((6.0, 8.0, 0.0), 2.5, WIND_MAX_MPS)
    assert refusal == (
        "the wind is 10.0 m/s with gusts to 12.5 m/s, and a landing is limited to 9 m/s (wind_max_mps): "
        "wait for less wind, or use force"
    )


def test_the_wind_is_named_as_far_as_it_is_known() -> None:
    assert wind_words(None, None) == "the wind is unknown"
    assert wind_words((3.0, -4.0, 9.0), None) == "the wind is 5.0 m/s"


def test_gusts_above_the_limit_are_none_of_its_business() -> None:
    assert wind_refusal((6.0, 6.0, 0.0), 5.0, WIND_MAX_MPS) == ""


def test_only_the_horizontal_wind_is_compared_with_the_limit() -> None:
    assert wind_refusal((6.0, 6.0, 30.0), None, WIND_MAX_MPS) == ""


def test_an_unknown_wind_is_no_reason() -> None:
    assert wind_refusal(None, None, WIND_MAX_MPS) == ""
    assert not any(reasons((None, 6.0)))


def test_a_wind_that_stays_above_the_limit_ends_an_approach() -> None:
    assert "a landing is limited to 9 m/s" in reasons((8.0, 1.0), (10.0, 4.0))[-1]


def test_a_wind_that_is_above_the_limit_for_a_moment_ends_nothing() -> None:
    moment = (10.0, 2.0)
    assert not any(reasons(moment, (8.0, 0.2), moment))


def test_force_lands_in_any_wind() -> None:
    assert not any(reasons((30.0, 6.0), force=True))
