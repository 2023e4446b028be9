"""The bridge's timer, whose time-outs a correction of vehicle time neither shortens nor prolongs by much."""

import pytest

from jezero.services.vehicle_bridge.service import Timer


@pytest.mark.parametrize(
    ("vehicle_times_ms", "timer_ms"),
    [
        ((5000, 5500, 5600), (0, 500, 600)),
        ((5000, 5500, 5450, 5500, 5600), (0, 500, 500, 500, 600)),
        ((5000, 5500, 5450, 5520, 5600), (0, 500, 500, 520, 600)),
        ((5000, 5500, 5200, 5300, 5400), (0, 500, 500, 500, 600)),
        ((5000, 5500, 5200, 5190, 5290, 5390), (0, 500, 500, 500, 500, 600)),
    ],
    ids=["forwards", "50 ms back", "50 ms back, and past it", "300 ms back", "back twice"],
)
def test_time_that_steps_back_is_not_counted_twice_for_a_tenth_of_a_second_at_most(
    vehicle_times_ms: tuple[int, ...], timer_ms: tuple[int, ...]
) -> None:
    timer, found = Timer(), []
    for t_ms in vehicle_times_ms:
        timer.update(t_ms * 1_000_000)
        found.append(timer.now_ns // 1_000_000)
    assert tuple(found) == timer_ms


def test_the_start_is_the_vehicle_time_of_the_first_update() -> None:
    timer = Timer()
    assert timer.started_ns == 0
    for t_ms in (5000, 5500, 7600):
        timer.update(t_ms * 1_000_000)
        assert timer.started_ns == 5_000_000_000
