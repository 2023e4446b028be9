"""Plausible and implausible readings of the rover's odometry."""

from math import pi, sin
from random import Random

import msgspec
import pytest

from jezero.base.frames import wrap_pi
from jezero.schemas.sensors import RoverOdometry
from jezero.services.estimator.rover_plausibility import RoverPlausibilityCheck

MS = 1_000_000


def reading(t_ms: int, yaw_rad: float = 0.0, speed_mps: float = 0.0) -> RoverOdometry:
    return RoverOdometry(
        t_ns=t_ms * MS,
        pos_odom_m=(0.0, 0.0),
        yaw_rover_rad=yaw_rad,
        speed_rover_body_mps=speed_mps,
        yaw_rate_rover_rps=0.0,
    )


def test_a_rover_that_turns_and_brakes_is_plausible() -> None:
    check, rng = RoverPlausibilityCheck(), Random(1)
    for number in range(500):
        yaw_rad = wrap_pi(3.0 + 1.0 * number * 0.04 + rng.gauss(0.0, 0.03))
        speed_mps = 2.0 * sin(0.6 * number * 0.04) + rng.gauss(0.0, 0.03)
        assert check.is_plausible(reading(40 * number, yaw_rad, speed_mps))


@pytest.mark.parametrize("jump", [{"yaw_rover_rad": pi / 2}, {"speed_rover_body_mps": 1.0}])
def test_after_a_jump_everything_is_rejected_for_half_a_second(jump: dict[str, float]) -> None:
    check = RoverPlausibilityCheck()
    assert check.is_plausible(reading(0))
    for t_ms in range(40, 540, 40):
        assert not check.is_plausible(msgspec.structs.replace(reading(t_ms), **jump))
    assert check.is_plausible(msgspec.structs.replace(reading(560), **jump))


def test_an_impossible_speed_is_rejected_from_the_first_reading_on() -> None:
    check = RoverPlausibilityCheck()
    assert not check.is_plausible(reading(0, speed_mps=50.0))
    assert not check.is_plausible(reading(1000, speed_mps=50.0))


def test_after_a_pause_the_heading_may_be_another() -> None:
    check = RoverPlausibilityCheck()
    assert check.is_plausible(reading(0))
    assert check.is_plausible(reading(2000, yaw_rad=pi))


def test_a_late_reading_is_compared_but_is_not_the_last() -> None:
    check = RoverPlausibilityCheck()
    assert check.is_plausible(reading(100, yaw_rad=1.0))
    assert check.is_plausible(reading(60, yaw_rad=0.9))
    assert check.is_plausible(reading(140, yaw_rad=1.3))


def test_after_clear_any_reading_is_plausible() -> None:
    check = RoverPlausibilityCheck()
    check.is_plausible(reading(0, speed_mps=50.0))
    check.clear()
    assert check.is_plausible(reading(40, yaw_rad=2.0))


@pytest.mark.parametrize(
    ("passed_ms", "turned_rad", "faster_mps", "plausible"),
    [
        (40, 0.3, 0.0, True),
        (40, 0.5, 0.0, False),
        (1000, 2.1, 0.0, True),
        (1000, 2.5, 0.0, False),
        (1000, -2.5, 0.0, False),
        (40, 0.0, 0.3, True),
        (40, 0.0, 0.5, False),
        (1000, 0.0, 3.1, True),
        (1000, 0.0, 3.5, False),
        (1000, 0.0, -3.5, False),
    ],
)
def test_a_reading_differs_from_the_one_before_by_noise_and_by_what_a_rover_can_turn_and_accelerate(
    passed_ms: int, turned_rad: float, faster_mps: float, plausible: bool
) -> None:
    """Noise of 0.3 rad and 0.3 m/s, besides 2 rad/s and 3 m/s²."""
    check = RoverPlausibilityCheck()
    assert check.is_plausible(reading(60_000))
    assert check.is_plausible(reading(60_000 + passed_ms, turned_rad, faster_mps)) is plausible


@pytest.mark.parametrize(("speed_mps", "plausible"), [(5.9, True), (-5.9, True), (6.1, False), (-6.1, False)])
def test_a_rover_drives_up_to_six_metres_per_second(speed_mps: float, plausible: bool) -> None:
    assert RoverPlausibilityCheck().is_plausible(reading(0, speed_mps=speed_mps)) is plausible
