"""Twists of ROS as velocities of jezero."""

from math import inf, nan
from types import SimpleNamespace
from typing import Any

import pytest

from jezero.services.ros2_bridge.velocity import Velocity, header_refusal, velocity_from

T_NS = 20_000_000_000


def twist(*linear: float, angular: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    axes = [dict(zip("xyz", each, strict=True)) for each in (linear, angular)]
    return SimpleNamespace(linear=SimpleNamespace(**axes[0]), angular=SimpleNamespace(**axes[1]))


def header(frame_id: str, t_ns: int) -> Any:
    return SimpleNamespace(frame_id=frame_id, stamp=SimpleNamespace(sec=t_ns // 10**9, nanosec=t_ns % 10**9))


def test_left_and_anticlockwise_are_right_and_clockwise_with_the_other_sign() -> None:
    made = velocity_from(twist(1.0, 2.0, 3.0, angular=(0.0, 0.0, 0.5)))
    assert made == Velocity(forward_mps=1.0, right_mps=-2.0, up_mps=3.0, yaw_rate_rps=-0.5)
    assert not made.is_zero
    assert velocity_from(twist(0.0, 0.0, 0.0)).is_zero


@pytest.mark.parametrize("bad", [twist(nan, 0.0, 0.0), twist(0.0, 0.0, inf), twist(0, 0, 0, angular=(0.0, 0.0, nan))])
def test_a_number_that_is_not_finite_is_refused(bad: Any) -> None:
    with pytest.raises(ValueError, match="NaN or infinite"):
        velocity_from(bad)


def test_a_twist_that_rolls_or_pitches_is_refused() -> None:
    with pytest.raises(ValueError, match="tilts by itself"):
        velocity_from(twist(1.0, 0.0, 0.0, angular=(0.1, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("frame", "t_ns", "now_ns", "words"),
    [
        ("uav1/base_link", T_NS, T_NS + 400_000_000, ""),
        ("base_link", 0, T_NS, ""),
        ("", T_NS, None, ""),
        ("map", T_NS, T_NS, "its frame is 'map': expected uav1/base_link, or none"),
        ("", T_NS, T_NS + 600_000_000, "0.6 s behind vehicle time: run the node with use_sim_time"),
        ("", 1_700_000_000 * 10**9, T_NS, "ahead of vehicle time"),
    ],
)
def test_a_stamped_twist_needs_the_frame_and_vehicle_time(
    frame: str, t_ns: int, now_ns: int | None, words: str
) -> None:
    refusal = header_refusal(header(frame, t_ns), ("uav1/base_link", "base_link"), now_ns)
    assert (words in refusal) if words else refusal == ""
