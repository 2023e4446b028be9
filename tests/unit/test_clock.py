"""Vehicle time on a host: what delays, bursts and a master that stands still do to it."""

import pytest

from jezero.runtime.clock import JUMP_BACK_NS, VehicleClock

MS = 1_000_000
AHEAD_NS = 5_000 * MS
"""Vehicle time at wall time 0."""


def running(until_ms: int = 1000) -> VehicleClock:
    """A clock that has heard its master every 100 ms, without delay."""
    clock = VehicleClock()
    for wall_ms in range(0, until_ms + 1, 100):
        clock.update(AHEAD_NS + wall_ms * MS, 1, wall_ms * MS)
    return clock


def test_there_is_no_time_before_the_first_message() -> None:
    assert VehicleClock().now_ns(123) == 0


def test_the_message_that_came_first_decides() -> None:
    clock = running()
    clock.update(AHEAD_NS + 1100 * MS, 1, 1180 * MS)
    assert clock.now_ns(1200 * MS) == AHEAD_NS + 1200 * MS


def test_without_messages_time_goes_on() -> None:
    assert running().now_ns(4000 * MS) == AHEAD_NS + 4000 * MS


def test_messages_that_a_link_held_back_don_t_turn_time_back() -> None:
    clock = running()
    for number, t_ms in enumerate(range(1100, 2600, 100)):
        wall_ns = 2500 * MS + number * 50_000
        before_ns = clock.now_ns(wall_ns)
        clock.update(AHEAD_NS + t_ms * MS, 1, wall_ns)
        assert clock.now_ns(wall_ns) >= before_ns
    assert clock.now_ns(2501 * MS) == pytest.approx(AHEAD_NS + 2501 * MS, abs=2 * MS)


def test_a_master_that_stood_still_is_believed_after_a_while() -> None:
    clock = running()
    for wall_ms in range(4000, 4300, 100):
        t_ns = AHEAD_NS + (wall_ms - 3000) * MS
        clock.update(t_ns, 1, wall_ms * MS)
    assert clock.now_ns(4200 * MS) == AHEAD_NS + 1200 * MS


def test_late_messages_now_and_then_change_nothing() -> None:
    clock = running()
    for wall_ms in range(1100, 3000, 100):
        late = wall_ms % 200 == 0
        clock.update(AHEAD_NS + wall_ms * MS - (JUMP_BACK_NS + 50 * MS if late else 0), 1, wall_ms * MS)
    assert clock.now_ns(3000 * MS) == AHEAD_NS + 3000 * MS


def test_a_new_epoch_is_believed_at_once() -> None:
    clock = running()
    clock.update(7 * MS, 2, 1100 * MS)
    assert clock.epoch_id == 2 and clock.now_ns(1100 * MS) == 7 * MS


def test_a_slow_master_slows_vehicle_time() -> None:
    clock = VehicleClock()
    for number in range(20):
        clock.update(number * 50 * MS, 1, number * 100 * MS)
    assert clock.now_ns(2900 * MS) == pytest.approx(1450 * MS, abs=5 * MS)
