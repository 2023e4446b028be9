"""The arithmetic of the benchmarks; their figures are asserted nowhere."""

import os
import time

import numpy as np
import pytest

from benchmarks.quality.map import M_PER_PX, MARGIN_PX, Comparison, compare
from benchmarks.speed.latency import pair, row
from benchmarks.speed.stack import cpu_ns, memory_mb, percentile

MS = 1_000_000


def test_a_setpoint_belongs_to_the_odometry_before_it() -> None:
    assert pair([0, 20 * MS, 40 * MS], [2 * MS, 23 * MS], [(-1, 50 * MS)]) == ([2.0, 3.0], 0)


def test_an_odometry_with_no_setpoint_or_two_is_left_out() -> None:
    assert pair([0, 20 * MS, 40 * MS], [21 * MS, 22 * MS], [(-1, 50 * MS)]) == ([], 2)


def test_only_messages_during_a_goal_count() -> None:
    assert pair([0, 20 * MS, 40 * MS], [2 * MS, 23 * MS], [(10 * MS, 50 * MS)]) == ([3.0], 0)


def test_a_ratio_is_that_of_the_medians() -> None:
    compared = row([3.0, 2.0, 90.0], [1.0, 2.0, 1.5], [2.0, 40.0, 1.0])
    assert (compared.ratio, compared.ratio_by_hand) == (2.0, 1.5)


def test_a_percentile_of_nothing_is_no_number() -> None:
    assert percentile([], 0.5) != percentile([], 0.5)
    assert percentile([3.0, 1.0, 2.0], 0.95) == 3.0


def test_the_clock_of_a_process_counts_its_processor_time() -> None:
    before = cpu_ns(os.getpid()), time.process_time_ns()
    sum(range(1_000_000))
    spent, expected = cpu_ns(os.getpid()) - before[0], time.process_time_ns() - before[1]
    assert abs(spent - expected) < 5 * MS
    assert memory_mb(os.getpid())[0] >= memory_mb(os.getpid())[1] > 1.0


def test_a_map_is_compared_place_by_place_and_its_common_translation_is_separated() -> None:
    rng = np.random.default_rng(3)
    reference = rng.integers(0, 255, (420, 420, 3), dtype=np.uint8)
    up, left = 12, 7
    part = reference[MARGIN_PX + up : 320 + up, MARGIN_PX + left : 320 + left].copy()
    part[:110] = reference[MARGIN_PX + up + 3 : MARGIN_PX + up + 113, MARGIN_PX + left : 320 + left]
    found = compare(part, reference)
    assert found.found_share > 0.8
    assert found.offset_m == pytest.approx((M_PER_PX * up, -M_PER_PX * left), abs=0.01 + 3 * M_PER_PX)
    assert np.ptp(found.errors_m[:, 0]) == pytest.approx(3 * M_PER_PX, abs=0.01)
    assert np.abs(found.errors_m[:, 1] + M_PER_PX * left).max() < 0.01


def test_a_rotation_of_the_whole_map_is_separated() -> None:
    places_m = np.random.default_rng(1).uniform(0.0, 5.0, (40, 2))
    errors_m = np.array((0.2, -0.1)) + 0.01 * np.column_stack((-places_m[:, 1], places_m[:, 0]))
    found = Comparison(places_m, errors_m, 1.0)
    assert found.turn_rad == pytest.approx(0.01)
    assert found.unturned_m.max() < 1e-9
    assert found.rest_m.max() > 0.01


def test_a_stretch_and_a_shear_of_the_whole_map_are_separated() -> None:
    places_m = np.random.default_rng(1).uniform(0.0, 5.0, (40, 2))
    errors_m = np.array((0.2, -0.1)) + places_m @ np.array(((0.01, 0.003), (0.0, -0.02)))
    found = Comparison(places_m, errors_m, 1.0)
    assert found.undistorted_m.max() < 1e-9
    assert found.unturned_m.max() > 0.01
