"""How many requests of a flood pass."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jezero.services.ros2_bridge.limits import Announcements, RequestLimit


def test_of_a_flood_ten_a_second_pass_after_the_first_ten() -> None:
    limit = RequestLimit(10.0)
    passed = [i for i in range(5000) if not limit.refusal(100.0 + i * 0.001)]
    assert len(passed) == 10 + 50 - 1 or len(passed) == 10 + 50, "of 5 s"


def test_one_request_a_second_always_passes_and_a_refusal_says_the_limit() -> None:
    limit = RequestLimit(1.0)
    assert [limit.refusal(float(t_s)) for t_s in range(5, 10)] == [""] * 5
    assert limit.refusal(9.0) == "the bridge passes 1 requests a second"


def test_a_refusal_that_repeats_itself_is_published_every_two_seconds_whatever_its_numbers_are() -> None:
    announcements = Announcements()
    times_s = [0.02 * step for step in range(300)]
    due_s = [t_s for t_s in times_s if announcements.is_due("cmd_vel", f"its stamp is {0.6 + t_s:.1f} s behind", t_s)]
    assert due_s == pytest.approx([0.0, 2.0, 4.0], abs=0.03)


def test_another_refusal_and_that_of_another_request_are_published_at_once() -> None:
    announcements = Announcements()
    assert announcements.is_due("go_to", "take off first", 1.0)
    assert announcements.is_due("go_to", "the fence is in the way", 1.0)
    assert announcements.is_due("takeoff", "take off first", 1.0)
    assert not announcements.is_due("go_to", "take off first", 1.1)


@given(st.lists(st.floats(0.0, 0.5), max_size=200))
def test_in_no_time_more_than_the_limit_passes(steps_s: list[float]) -> None:
    limit, now_s, passed_s = RequestLimit(10.0), 50.0, []
    for step_s in steps_s:
        now_s += step_s
        if not limit.refusal(now_s):
            passed_s.append(now_s)
    for first_s in passed_s:
        assert sum(first_s <= t_s < first_s + 1.0 for t_s in passed_s) <= 21
