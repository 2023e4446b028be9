"""How many requests of a flood pass."""

from hypothesis import given
from hypothesis import strategies as st

from jezero.services.ros2_bridge.limits import RequestLimit


def test_of_a_flood_ten_a_second_pass_after_the_first_ten() -> None:
    limit = RequestLimit(10.0)
    passed = [i for i in range(5000) if not limit.refusal(100.0 + i * 0.001)]
    assert len(passed) == 10 + 50 - 1 or len(passed) == 10 + 50, "of 5 s"


def test_one_request_a_second_always_passes_and_a_refusal_says_the_limit() -> None:
    limit = RequestLimit(1.0)
    assert [limit.refusal(float(t_s)) for t_s in range(5, 10)] == [""] * 5
    assert limit.refusal(9.0) == "the bridge passes 1 requests a second"


def test_refusals_in_a_row_are_counted_from_the_last_that_passed() -> None:
    limit = RequestLimit(1.0)
    found = []
    for t_s in (1.0, 1.0, 1.0, 2.0, 2.0):
        limit.refusal(t_s)
        found.append(limit.refused)
    assert found == [0, 1, 2, 0, 1]


@given(st.lists(st.floats(0.0, 0.5), max_size=200))
def test_in_no_time_more_than_the_limit_passes(steps_s: list[float]) -> None:
    limit, now_s, passed_s = RequestLimit(10.0), 50.0, []
    for step_s in steps_s:
        now_s += step_s
        if not limit.refusal(now_s):
            passed_s.append(now_s)
    for first_s in passed_s:
        assert sum(first_s <= t_s < first_s + 1.0 for t_s in passed_s) <= 21
