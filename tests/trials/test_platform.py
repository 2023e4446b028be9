"""Where the vehicle stands on the platform, on numbers worked out by hand."""

from math import cos, radians, sin

import msgspec
import pytest

from jezero.base.frames import quat_from_euler
from jezero.trials.platform import off_platform_reason, on_platform_m
from tests.trials.landing.test_judge import truth


def test_the_touchdown_error_is_in_the_rovers_axes() -> None:
    standing = truth(0, (10.0, 0.3, -0.52), yaw_rad=1.5707963)
    assert on_platform_m(standing) == pytest.approx((0.3, 0.0, -0.02), abs=1e-6)
    assert off_platform_reason(standing, 0.5) == ""
    assert "0.60 m from the middle" in off_platform_reason(truth(0, (10.0, 0.6, -0.5)), 0.5)
    assert "0.50 m above" in off_platform_reason(truth(0, (10.0, 0.0, -1.0)), 0.5)


def test_on_a_tilted_platform_a_vehicle_that_stands_in_the_middle_has_no_error() -> None:
    """With its centre of mass 0.15 m above the platform's middle, along the platform's own vertical."""
    roll_rad, height_m = radians(10.0), 0.15
    middle = truth(0, (10.0, 0.0, -0.5))
    leaning = msgspec.structs.replace(
        middle,
        pos_uav_ned_m=(10.0, height_m * sin(roll_rad), -0.5 - height_m * cos(roll_rad) + height_m),
        q_ned_from_frd=quat_from_euler(roll_rad, 0.0, 0.0),
        roll_rover_rad=roll_rad,
    )
    assert on_platform_m(leaning, height_m) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert off_platform_reason(leaning, 0.5, height_m) == ""
    upright = msgspec.structs.replace(leaning, q_ned_from_frd=quat_from_euler(radians(-10.0), 0.0, 0.0))
    assert off_platform_reason(upright, 0.5, height_m) == "tilted by 20 degrees"
