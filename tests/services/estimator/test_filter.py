"""The relative filter finds the rover, keeps it, and knows how well."""

from collections.abc import Iterator

import numpy as np
import pytest

from jezero.base.arrays import Array
from jezero.base.vehicle_config import PlatformConfig
from jezero.services.estimator.config import Tuning, ValidityConfig
from jezero.services.estimator.kalman import FilterState, Kalman
from jezero.services.estimator.measurement_history import MeasurementHistory
from jezero.services.estimator.measurements import (
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
    UwbMeasurement,
)
from jezero.services.estimator.motion import SIZE, MotionModel, initial_state
from jezero.services.estimator.relative_filter import RelativeFilter
from jezero.services.estimator.trilateration import trilaterate

ANCHORS_M = np.array(((0.45, 0.45, 0.0), (0.45, -0.45, 0.0), (-0.45, -0.45, 0.0), (-0.45, 0.45, 0.0)))
POS_UAV_M = np.array((10.0, -4.0, -6.0))
POS_ROVER_M = np.array((9.0, -3.5, -0.5))
YAW_RAD = 0.7
MS = 1_000_000
LEVER_M = np.array((0.0, 0.0, -0.1))

GATE = (10.8, 16.3)


def kalman_at(pos_uav_m: Array, std_m: float) -> Kalman:
    """A filter over the rover at `POS_ROVER_M` whose relative position has a standard deviation of `std_m`."""
    kalman = Kalman(MotionModel(Tuning()))
    x, P = initial_state(pos_uav_m, Tuning())
    kalman.restore(FilterState(0, x, P))
    kalman.reset_rover_position(pos_uav_m - POS_ROVER_M, std_m**2 * np.eye(3), np.zeros((3, SIZE)))
    return kalman


def ranges_m(pos_rel_m: Array, yaw_rad: float = YAW_RAD) -> Array:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    body = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0))) @ (pos_rel_m + LEVER_M)
    distances: Array = np.linalg.norm(body - ANCHORS_M, axis=1)
    return distances


def uwb(t_ns: int, pos_rel_m: Array, rng: np.random.Generator | None = None, std_m: float = 0.01) -> UwbMeasurement:
    noise = np.zeros(4) if rng is None else rng.normal(0.0, std_m, 4)
    return UwbMeasurement(t_ns, LEVER_M, ANCHORS_M, ranges_m(pos_rel_m) + noise, np.zeros(4), 0.02)


def tag(t_ns: int, pos_rel_m: Array) -> TagMeasurement:
    return TagMeasurement(t_ns, pos_rel_m, pos_rel_m, 1e-4 * np.eye(3), 0.0, None, 1.0)


def hovering(seconds: float, start_ms: int = 0) -> Iterator[Measurement]:
    """Odometry and rover of a vehicle that stands still in the air over a rover that stands."""
    for ms in range(start_ms, start_ms + int(1000 * seconds), 20):
        yield OdometryMeasurement(ms * MS, np.concatenate((POS_UAV_M, np.zeros(3))))
        yield RoverOdometryMeasurement(ms * MS, 0.0, YAW_RAD, 0.0, 0.03, 0.03, 0.01)


def test_trilateration_finds_a_point_above_the_anchors() -> None:
    point = (1.2, -2.3, -5.0)
    found = trilaterate(
        [tuple(a) for a in ANCHORS_M.tolist()],
        np.linalg.norm(np.array(point) - ANCHORS_M, axis=1).tolist(),
    )
    assert found is not None
    assert found[0] == pytest.approx(point, abs=1e-6)


def test_trilateration_refuses_anchors_in_a_line() -> None:
    assert trilaterate([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)], [5.0, 5.0, 5.0]) is None


def test_the_rover_is_found_by_uwb() -> None:
    rng = np.random.default_rng(1)
    located = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    rel_m = POS_UAV_M - POS_ROVER_M
    assert not located.located
    for ms in range(0, 2000, 100):
        located.add([*hovering(0.1, start_ms=ms), uwb(ms * MS, rel_m, rng), uwb((ms + 50) * MS, rel_m, rng)])
    assert located.estimate is not None
    assert np.abs(located.estimate.pos_rel_m - rel_m).max() < 0.1
    assert located.std_pos_m < 0.1


def test_the_rover_is_found_by_its_tag() -> None:
    rel_m = POS_UAV_M - POS_ROVER_M
    located = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    located.add(list(hovering(1.0)))
    for ms in range(0, 1000, 66):
        located.add([tag(ms * MS, rel_m)])
    assert located.estimate is not None
    assert np.abs(located.estimate.pos_rel_m - rel_m).max() < 0.02


def test_the_order_of_arrival_does_not_matter() -> None:
    rng = np.random.default_rng(2)
    rel_m = POS_UAV_M - POS_ROVER_M
    tags = [tag(ms * MS, rel_m + rng.normal(0.0, 0.01, 3)) for ms in range(100, 900, 66)]
    in_order, late = (
        RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig()),
        RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig()),
    )
    first = tag(33 * MS, rel_m)
    for located in (in_order, late):
        located.add([*hovering(0.06), first])
    in_order.add(sorted([*hovering(1.0, start_ms=60), *tags], key=lambda m: m.t_ns))
    late.add(list(hovering(1.0, start_ms=60)))
    for i in rng.permutation(len(tags)).tolist():
        late.add([tags[i]])
    assert in_order.estimate is not None and late.estimate is not None
    assert late.estimate.pos_rel_m == pytest.approx(in_order.estimate.pos_rel_m, abs=1e-9)
    assert late.estimate.cov == pytest.approx(in_order.estimate.cov, abs=1e-9)


def test_a_prediction_to_an_earlier_time_changes_nothing() -> None:
    kalman = kalman_at(POS_UAV_M, 0.5)
    kalman.predict_to(100 * MS)
    before = kalman.save()
    kalman.predict_to(60 * MS)
    assert kalman.t_ns == 100 * MS
    assert np.array_equal(kalman.x, before.x) and np.array_equal(kalman.P, before.P)


def test_statistics_count_the_measurements_of_one_kind_since_a_time() -> None:
    rel_m = POS_UAV_M - POS_ROVER_M
    kalman = kalman_at(POS_UAV_M, 0.05)
    history = MeasurementHistory(kalman, kalman.save(), GATE)
    assert history.statistics("tag", 0) is None
    tags = [tag(ms * MS, rel_m + (0.0 if ms != 60 else 5.0)) for ms in range(10, 100, 10)]
    history.add(tags)
    found = history.statistics("tag", 50 * MS)
    assert found is not None
    assert found.newest is tags[-1]
    assert (found.measurements, found.first_ns, found.offered, found.used) == (5, 50 * MS, 15, 12)
    assert history.statistics("uwb", 0) is None
    assert history.used_ns == {"tag": 90 * MS} and history.rejected == {"tag": False}
    history.add([tag(100 * MS, rel_m + 5.0), uwb(95 * MS, rel_m)])
    assert history.used_ns == {"tag": 90 * MS, "uwb": 95 * MS} and history.rejected == {"tag": True, "uwb": False}
    since_20_ms = history.statistics("tag", 20 * MS)
    assert since_20_ms is not None and (since_20_ms.measurements, since_20_ms.used) == (9, 21)


def test_measurements_that_came_already_or_are_too_old_change_nothing() -> None:
    rel_m = POS_UAV_M - POS_ROVER_M
    kalman = kalman_at(POS_UAV_M, 0.05)
    history = MeasurementHistory(kalman, kalman.save(), GATE)
    known = tag(50 * MS, rel_m)
    history.add([known])
    before = kalman.save()
    history.add([known, tag(-10 * MS, rel_m)])
    history.add([])
    assert [entry.measurement for entry in history.entries] == [known]
    assert np.array_equal(kalman.x, before.x) and np.array_equal(kalman.P, before.P)


def test_a_filter_whose_state_is_no_number_any_more_begins_again_with_the_next_odometry() -> None:
    located, rel_m = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig()), POS_UAV_M - POS_ROVER_M
    located.add([*hovering(0.1), tag(0, rel_m)])
    located.add([OdometryMeasurement(100 * MS, np.array((0.0, 0.0, np.nan, 0.0, 0.0, 0.0)))])
    assert located.std_pos_m == np.inf and not located.inputs
    located.add([*hovering(0.1, start_ms=120), tag(120 * MS, rel_m)])
    found = located.estimate
    assert found is not None
    assert found.pos_rel_m == pytest.approx(rel_m, abs=0.02)


def test_uwb_and_tag_that_move_the_filter_to_and_fro_contradict_each_other_for_three_seconds() -> None:
    """Each of them measures alone for more than a second, so that the filter can't judge one by the other."""
    rel_m, elsewhere_m = POS_UAV_M - POS_ROVER_M, POS_UAV_M - POS_ROVER_M + np.array((0.0, 20.0, 0.0))
    located, conflicts_ms = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig()), list[int]()
    for ms in range(0, 12_000, 50):
        measured: list[Measurement] = []
        if ms < 2000 or ms >= 5500:
            measured.append(tag(ms * MS, rel_m))
        elif 3200 <= ms < 4400:
            measured.append(uwb(ms * MS, elsewhere_m))
        located.add([*hovering(0.05, start_ms=ms), *measured])
        if located.has_input_conflict:
            conflicts_ms.append(ms)
    assert 6000 < conflicts_ms[0] < 6500 and 6800 < conflicts_ms[-1] < 7300
    assert conflicts_ms == list(range(conflicts_ms[0], conflicts_ms[-1] + 50, 50))
