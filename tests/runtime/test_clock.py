"""Vehicle time on a host: what delays, bursts and a master that stands still do to it."""

import pytest

from jezero.runtime.clock import VehicleClock

MS = 1_000_000
AHEAD_NS = 5_000 * MS
"""Vehicle time at wall time 0."""
MASTER_NS = 70_000 * MS
"""The master's wall time at wall time 0."""


def tell(clock: VehicleClock, t_ms: float, sent_ms: float, arrived_ms: float | None = None, epoch_id: int = 1) -> None:
    """One message; all times are wall times in ms but `t_ms`."""
    arrived_ns = int((sent_ms if arrived_ms is None else arrived_ms) * MS)
    clock.update(AHEAD_NS + int(t_ms * MS), epoch_id, MASTER_NS + int(sent_ms * MS), arrived_ns)


def now_ms(clock: VehicleClock, wall_ms: float) -> float:
    return (clock.now_ns(int(wall_ms * MS)) - AHEAD_NS) / MS


def running(until_ms: int = 1000) -> VehicleClock:
    """A clock that has heard its master every 100 ms, without delay."""
    clock = VehicleClock()
    for wall_ms in range(0, until_ms + 1, 100):
        tell(clock, wall_ms, wall_ms)
    return clock


def test_there_is_no_time_before_the_first_message() -> None:
    assert VehicleClock().now_ns(123) == 0


def test_a_step_that_began_before_the_first_message_was_read_is_not_before_the_beginning() -> None:
    clock = VehicleClock()
    clock.update(t_ns=0, epoch_id=1, wall_master_ns=MASTER_NS, wall_ns=10 * MS)
    assert clock.now_ns(9 * MS) == 0
    assert clock.now_ns(11 * MS) == 1 * MS


def test_the_message_that_came_first_decides() -> None:
    clock = running()
    tell(clock, 1100, 1100, arrived_ms=1180)
    assert now_ms(clock, 1200) == pytest.approx(1200, abs=0.1)


def test_without_messages_time_goes_on() -> None:
    assert now_ms(running(), 4000) == pytest.approx(4000, abs=0.1)


def test_messages_that_a_link_held_back_never_turn_time_back() -> None:
    clock = running()
    for number, sent_ms in enumerate(range(1100, 16_000, 100)):
        arrived_ms = 16_000 + 0.05 * number
        before_ms = now_ms(clock, arrived_ms)
        tell(clock, sent_ms, sent_ms, arrived_ms)
        assert now_ms(clock, arrived_ms) == pytest.approx(before_ms, abs=4.0)  # for clocks that drift apart
    assert now_ms(clock, 16_010) == pytest.approx(16_010, abs=4.0)


def test_messages_that_overtake_each_other_change_nothing() -> None:
    clock = running()
    tell(clock, 1200, 1200)
    tell(clock, 1100, 1100, arrived_ms=1201)
    assert now_ms(clock, 1300) == pytest.approx(1300, abs=0.1)


def test_a_master_that_stood_still_is_believed_at_once() -> None:
    clock = running()
    assert now_ms(clock, 1399) == pytest.approx(1399, abs=0.1)
    tell(clock, 1004, sent_ms=1400)
    assert now_ms(clock, 1400) == pytest.approx(1004, abs=0.1)
    assert now_ms(clock, 1500) == pytest.approx(1104, abs=0.1)  # it is not taken for a slow one


def test_a_host_whose_own_clock_stood_still_catches_up_with_the_next_message() -> None:
    clock = running()
    tell(clock, 1500, sent_ms=1500, arrived_ms=1100)
    assert now_ms(clock, 1200) == pytest.approx(1600, abs=0.1)


@pytest.mark.parametrize("ppm", [-100, 100])
def test_monotonic_clocks_that_drift_apart_are_followed(ppm: int) -> None:
    clock = VehicleClock()
    for number in range(36_000):
        sent_ms = 100.0 * number
        tell(clock, sent_ms, sent_ms, arrived_ms=sent_ms * (1.0 + ppm * 1e-6) + (number % 7))
    assert now_ms(clock, sent_ms * (1.0 + ppm * 1e-6)) == pytest.approx(sent_ms, abs=1.0)


def test_a_message_with_a_false_time_of_its_master_does_not_shut_out_the_true_ones() -> None:
    clock = running()
    tell(clock, 1150, sent_ms=10_000_000, arrived_ms=1150)
    tell(clock, 1204, sent_ms=1600)  # the true one stood still
    assert now_ms(clock, 1700) == pytest.approx(1304, abs=0.1)


def test_a_new_epoch_is_believed_at_once() -> None:
    clock = running()
    clock.update(7 * MS, 2, 3 * MS, 1100 * MS)
    assert clock.epoch_id == 2
    assert clock.now_ns(1110 * MS) == 17 * MS


def test_a_slow_master_slows_vehicle_time() -> None:
    clock = VehicleClock()
    for number in range(20):
        tell(clock, number * 50, number * 100)
    assert now_ms(clock, 2900) == pytest.approx(1450, abs=5)


def paced(clock: VehicleClock, t_ms: float, sent_ms: float, pace: float) -> None:
    """One message of a master at another pace than that of real time."""
    sent_ns = int(sent_ms * MS)
    clock.update(AHEAD_NS + int(t_ms * MS), 1, MASTER_NS + sent_ns, sent_ns, pace)


def test_time_stands_still_while_the_master_says_that_it_has_paused() -> None:
    clock = running()
    for wall_ms in range(1050, 60_000, 100):
        paced(clock, 1040, wall_ms, 0.0)
        assert now_ms(clock, wall_ms + 90) == pytest.approx(1040)
    assert clock.pace_now(59_990 * MS) == 0.0
    paced(clock, 1040, 60_000, 1.0)
    assert now_ms(clock, 60_050) == pytest.approx(1090)


def test_a_paused_master_that_is_silent_counts_as_gone_after_a_second() -> None:
    clock = running()
    paced(clock, 1000, 1000, 0.0)
    assert now_ms(clock, 1990) == pytest.approx(1000)
    assert now_ms(clock, 2500) == pytest.approx(1500)
    assert clock.pace_now(2500 * MS) == 1.0


@pytest.mark.parametrize("pace", [0.1, 0.5, 3.0])
def test_time_follows_the_pace_from_its_first_message_on(pace: float) -> None:
    clock = running()
    paced(clock, 1000, 1000, pace)
    assert now_ms(clock, 1050) == pytest.approx(1000 + 50 * pace)
    for wall_ms in range(1100, 2000, 100):
        paced(clock, 1000 + (wall_ms - 1000) * pace, wall_ms, pace)
    assert now_ms(clock, 1950) == pytest.approx(1000 + 950 * pace, rel=0.01)


def test_a_pause_in_the_step_of_another_message_counts() -> None:
    clock = running()
    paced(clock, 1000, 1000, 0.0)
    assert clock.pace_now(1000 * MS) == 0.0
    paced(clock, 1000, 1000, 0.0)
    assert now_ms(clock, 1100) == pytest.approx(1000)
