"""Position steps of the autopilot's estimate."""

import pytest

from jezero.services.vehicle_bridge.vehicle import ResetHistory, Target

S = 1_000_000_000


def test_a_reset_steps_by_what_motion_does_not_explain() -> None:
    resets = ResetHistory()
    assert resets.update(3 * S, 5, (0.0, 0.0, -2.0), (1.0, 0.0, 0.0)) is None
    step = resets.update(3 * S + S // 10, 6, (1.6, -0.5, -2.0), (1.0, 0.0, 0.0))
    assert step == pytest.approx((1.5, -0.5, 0.0))
    assert resets.counter == 6
    assert resets.offset_ned_m == pytest.approx((1.5, -0.5, 0.0))


def test_a_point_of_an_older_counter_moves_by_all_steps_since() -> None:
    resets = ResetHistory()
    resets.update(0, 254, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    resets.update(S, 255, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    resets.update(2 * S, 0, (1.0, 2.0, 0.0), (0.0, 0.0, 0.0))
    assert resets.counter == 256
    assert resets.step_since(254) == pytest.approx((1.0, 2.0, 0.0))
    assert resets.step_since(255) == pytest.approx((0.0, 2.0, 0.0))
    assert resets.step_since(256) == pytest.approx((0.0, 0.0, 0.0))


def test_counters_of_the_future_and_of_long_ago_are_unknown() -> None:
    resets = ResetHistory()
    for count in range(33):
        resets.update(count * S, count, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert resets.step_since(0) is None
    assert resets.step_since(1) is not None
    assert resets.step_since(33) is None


def test_a_step_moves_the_point_of_a_target_and_leaves_a_velocity_as_it_is() -> None:
    step_ned_m = (0.5, -0.25, 0.125)
    moved = Target((1.0, 2.0, -3.0), (1.0, 0.0, 0.0), None, 0.3).moved(step_ned_m)
    assert moved == Target((1.5, 1.75, -2.875), (1.0, 0.0, 0.0), None, 0.3)
    by_velocity = Target(None, (1.0, 0.0, 0.0), None, 0.3)
    assert by_velocity.moved(step_ned_m) == by_velocity
