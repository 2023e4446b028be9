"""Readings of a rover's odometry, and those that can be none."""

from math import pi, sin
from random import Random

import msgspec
import pytest

from jezero.frames import wrap_pi
from jezero.schemas.sensors import RoverOdometry
from jezero.services.estimator.rover_screen import RoverScreen

MS = 1_000_000


def reading(t_ms: int, yaw_rad: float = 0.0, speed_mps: float = 0.0) -> RoverOdometry:
    return RoverOdometry(
        t_ns=t_ms * MS,
        pos_odom_m=(0.0, 0.0),
        yaw_rover_rad=yaw_rad,
        speed_rover_body_mps=speed_mps,
        yaw_rate_rover_rps=0.0,
    )


def test_a_rover_that_turns_about_and_brakes_is_believed() -> None:
    screen, rng = RoverScreen(), Random(1)
    for number in range(500):
        yaw_rad = wrap_pi(3.0 + 1.0 * number * 0.04 + rng.gauss(0.0, 0.03))
        speed_mps = 2.0 * sin(0.6 * number * 0.04) + rng.gauss(0.0, 0.03)
        assert screen.believes(reading(40 * number, yaw_rad, speed_mps))


@pytest.mark.parametrize("jump", [{"yaw_rover_rad": pi / 2}, {"speed_rover_body_mps": 1.0}])
def test_after_a_jump_nothing_is_believed_for_half_a_second(jump: dict[str, float]) -> None:
    screen = RoverScreen()
    assert screen.believes(reading(0))
    for t_ms in range(40, 540, 40):
        assert not screen.believes(msgspec.structs.replace(reading(t_ms), **jump))
    assert screen.believes(msgspec.structs.replace(reading(560), **jump))


def test_a_speed_that_no_rover_has_is_not_believed_from_the_first_reading_on() -> None:
    screen = RoverScreen()
    assert not screen.believes(reading(0, speed_mps=50.0))
    assert not screen.believes(reading(1000, speed_mps=50.0))


def test_after_a_pause_the_heading_may_be_another() -> None:
    screen = RoverScreen()
    assert screen.believes(reading(0))
    assert screen.believes(reading(2000, yaw_rad=pi))


def test_a_late_reading_is_compared_but_is_not_the_last() -> None:
    screen = RoverScreen()
    assert screen.believes(reading(100, yaw_rad=1.0))
    assert screen.believes(reading(60, yaw_rad=0.9))
    assert screen.believes(reading(140, yaw_rad=1.3))


def test_forgetting_lets_anything_come_next() -> None:
    screen = RoverScreen()
    screen.believes(reading(0, speed_mps=50.0))
    screen.clear()
    assert screen.believes(reading(40, yaw_rad=2.0))
