"""The arithmetic of the benchmarks; what they measure is asserted nowhere."""

import os
import time

from benchmarks.latency import delays, pair
from benchmarks.stack import cpu_ns, memory_mb, percentile

MS = 1_000_000


def test_a_setpoint_belongs_to_the_odometry_before_it() -> None:
    assert pair([0, 20 * MS, 40 * MS], [2 * MS, 23 * MS], [(-1, 50 * MS)]) == ([2.0, 3.0], 0)


def test_an_odometry_with_no_setpoint_or_two_is_left_out() -> None:
    assert pair([0, 20 * MS, 40 * MS], [21 * MS, 22 * MS], [(-1, 50 * MS)]) == ([], 2)


def test_only_what_passed_while_a_goal_flew_counts() -> None:
    assert pair([0, 20 * MS, 40 * MS], [2 * MS, 23 * MS], [(10 * MS, 50 * MS)]) == ([3.0], 0)


def test_a_ratio_is_that_of_the_medians() -> None:
    assert delays([3.0, 2.0, 90.0], [1.0, 2.0, 1.5]).ratio == 2.0


def test_a_percentile_of_nothing_is_no_number() -> None:
    assert percentile([], 0.5) != percentile([], 0.5)
    assert percentile([3.0, 1.0, 2.0], 0.95) == 3.0


def test_the_clock_of_a_process_counts_its_processor_time() -> None:
    before = cpu_ns(os.getpid()), time.process_time_ns()
    sum(range(1_000_000))
    spent, expected = cpu_ns(os.getpid()) - before[0], time.process_time_ns() - before[1]
    assert abs(spent - expected) < 5 * MS
    assert memory_mb(os.getpid())[0] >= memory_mb(os.getpid())[1] > 1.0
