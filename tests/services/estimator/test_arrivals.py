"""Measurements that arrive too late or are stamped in the future: dropped, counted and named."""

import pytest

from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.arrivals import Arrivals
from jezero.services.estimator.config import ValidityConfig

NOW_NS = 10 * NS_PER_S


def arrivals(age_s: float) -> tuple[Arrivals, bool]:
    """A check after one measurement of that age, and its verdict."""
    check = Arrivals(ValidityConfig(max_age_s=0.4, max_lead_s=0.05))
    return check, check.is_timely(NOW_NS, NOW_NS - round(age_s * NS_PER_S), "the tag")


@pytest.mark.parametrize(("age_s", "timely"), [(0.0, True), (0.4, True), (0.45, False), (-0.04, True), (-0.1, False)])
def test_a_measurement_counts_up_to_its_greatest_age_and_lead(age_s: float, timely: bool) -> None:
    check, verdict = arrivals(age_s)
    assert verdict is timely
    assert check.dropped == (not timely)
    assert (check.late_reason(NOW_NS, "the tag") == "") is timely


def test_a_late_input_is_named_with_its_delay_the_limit_and_what_to_check_for_a_second() -> None:
    check, _ = arrivals(0.45)
    reason = check.late_reason(NOW_NS, "the tag")
    assert reason.startswith(
        "measurements by the tag arrive 0.45 s late, 0.4 s are permitted (max_age_s): check the load"
    )
    assert check.late_reason(NOW_NS, "UWB") == ""
    assert check.late_reason(NOW_NS + NS_PER_S, "the tag") == ""


def test_an_input_with_a_clock_that_is_ahead_is_named() -> None:
    check, _ = arrivals(-0.5)
    assert check.late_reason(NOW_NS, "the tag").startswith("measurements by the tag are stamped 0.50 s in the future")


@pytest.mark.parametrize("t_ns", [0, NS_PER_S // 2, NOW_NS])
def test_an_input_that_was_never_late_is_not_named(t_ns: int) -> None:
    assert Arrivals(ValidityConfig()).late_reason(t_ns, "UWB") == ""


def test_a_measurement_of_a_former_epoch_is_dropped_without_blame() -> None:
    check = Arrivals(ValidityConfig())
    check.since_ns = NOW_NS
    assert not check.is_timely(NOW_NS, NOW_NS - 1, "the tag")
    assert check.late_reason(NOW_NS, "the tag") == ""
