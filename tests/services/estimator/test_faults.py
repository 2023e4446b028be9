"""No message makes the estimator's state anything but finite numbers, and ranges that lie don't move it."""

from collections.abc import Iterable, Iterator
from statistics import NormalDist

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as changed

from benchmarks.quality.estimator_flight import Arrival, Conditions
from jezero.base.frames import norm
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Publish
from jezero.schemas import topics
from jezero.schemas.estimate import Relative, TagEstimate
from jezero.schemas.sensors import Altimeter, RoverOdometry, Uwb, UwbRange
from jezero.schemas.state import Clock, Odometry
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.kalman import UpdateResult
from jezero.services.estimator.measurements import AltimeterMeasurement
from jezero.services.estimator.range_outliers import RangeOutlierFilter
from jezero.services.estimator.service import Estimator
from tests.services.estimator.rig import Rig
from tests.services.estimator.test_filter import GATE, MS, POS_ROVER_M, POS_UAV_M, kalman_at

ANCHORS_M = ((0.45, 0.45, 0.0), (0.45, -0.45, 0.0), (-0.45, -0.45, 0.0), (-0.45, 0.45, 0.0))
extreme = st.sampled_from([0.0, 1e-9, 0.5, 3.0, 1e3, 1e6, 1e12])
signed = st.sampled_from([0.0, -1e-9, 2.0, -5.0, 1e3, -1e6])


@st.composite
def rounds(draw: st.DrawFn, t_ns: int) -> Uwb:
    ranges = tuple(
        UwbRange(t_ns=t_ns - i * MS, anchor=i, pos_anchor_rover_body_m=a, range_m=draw(extreme))
        for i, a in enumerate(ANCHORS_M)
    )
    return Uwb(t_ns=t_ns, ranges=ranges)


@st.composite
def pictures(draw: st.DrawFn, t_ns: int) -> TagEstimate:
    cov = [draw(signed) for _ in range(6)]
    return TagEstimate(
        t_ns=t_ns,
        tag_ids=(0,),
        pos_uav_rel_rover_ned_m=(draw(signed), draw(signed), draw(signed)),
        cov_pos_ned_m2=(cov[0], cov[1], cov[2], cov[3], cov[4], cov[5]),
        range_m=1.0,
        yaw_rover_rad=draw(st.sampled_from([None, 0.0, 3.1, -6.0])),
        std_yaw_rover_rad=draw(st.sampled_from([None, 0.0, 1e-9, 1e3])),
        reprojection_px=0.1,
    )


@settings(max_examples=25, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_no_message_makes_the_result_anything_but_numbers(data: st.DataObject) -> None:
    estimator, inbox = Estimator(EstimatorConfig(), VehicleConfig()), Mailbox(())
    inbox.add_message(topics.CLOCK.name, Clock(t_ns=0, epoch_id=1, wall_ns=0))
    for i in range(12):
        t_ns = (100 + 50 * i) * MS
        position = (data.draw(signed), data.draw(signed), data.draw(signed))
        velocity = (data.draw(st.sampled_from([0.0, 1e3])), 0.0, data.draw(st.sampled_from([0.0, -1e3])))
        odometry = Odometry(
            t_ns=t_ns,
            epoch_id=1,
            pos_uav_ned_m=position,
            vel_uav_ned_mps=velocity,
            q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
            rates_uav_frd_rps=(data.draw(signed), 0.0, 0.0),
        )
        rover = RoverOdometry(
            t_ns=t_ns - data.draw(st.sampled_from([0, 20, 300])) * MS,
            pos_odom_m=(0.0, 0.0),
            yaw_rover_rad=data.draw(st.sampled_from([0.0, 3.1, -6.2])),
            speed_rover_body_mps=data.draw(st.sampled_from([0.0, 1.0, -1e3])),
            yaw_rate_rover_rps=data.draw(signed),
        )
        inbox.add_message(topics.ODOMETRY.name, odometry)
        inbox.add_message(topics.ROVER_ODOMETRY.name, rover)
        inbox.add_message(topics.UWB.name, data.draw(rounds(t_ns)))
        inbox.add_message(topics.ESTIMATE_TAG.name, data.draw(pictures(t_ns - 10 * MS)))
        inbox.add_message(topics.ALTIMETER.name, Altimeter(t_ns=t_ns, range_m=data.draw(extreme)))
        for output in estimator.step(t_ns, inbox):
            if isinstance(output, Publish) and isinstance(output.message, Relative):
                numbers = msgspec.structs.astuple(output.message)
                flat = np.concatenate([np.atleast_1d(n) for n in numbers if isinstance(n, int | float | tuple) and n])
                assert all(np.isfinite(float(n)) for n in flat if not isinstance(n, str))
        inbox.clear()


def test_a_fifth_of_the_ranges_without_line_of_sight_hardly_matters() -> None:
    clean, blocked = Rig(), Rig(Conditions(uwb_blocked=0.2))
    for rig in (clean, blocked):
        rig.until(9.0)
    assert max(blocked.error_m(r) for r in blocked.relatives if r.t_ns > 3000 * MS) < 0.3
    assert blocked.relative.valid


@pytest.mark.parametrize("seed", range(3))
def test_ranges_that_no_uwb_measures_never_put_the_rover_far_away(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def garbled(arrival: Arrival) -> Iterable[Arrival]:
        t_ns, topic, message = arrival
        if topic is topics.ESTIMATE_TAG:
            return ()
        if isinstance(message, Uwb) and 3.0 * NS_PER_S < t_ns < 8.0 * NS_PER_S:
            ranges = tuple(changed(r, range_m=rng.uniform(0.0, 1e3)) for r in message.ranges)
            message = changed(message, ranges=ranges)
        return ((t_ns, topic, message),)

    rig = Rig(tamper=garbled)
    rig.until(9.5)
    assert max(norm(rover.pos_rover_ned_m) for rover in rig.rovers) < 10.0
    assert rig.relative.valid and rig.error_m() < 0.2


def test_the_noise_of_the_ranges_is_measured_whatever_moves() -> None:
    rng = np.random.default_rng(3)
    outlier_filter = RangeOutlierFilter()
    for i in range(60):
        t_ns, away_m = i * 50 * MS, 8.0 - 2.0 * 0.05 * i
        ranges = tuple(
            UwbRange(t_ns=t_ns, anchor=a, pos_anchor_rover_body_m=ANCHORS_M[a], range_m=away_m + 0.1 * rng.normal())
            for a in range(4)
        )
        assert len(outlier_filter.filter(ranges, 0.1)) >= 3
    assert 0.07 < outlier_filter.std_m < 0.14
    late = UwbRange(t_ns=3000 * MS, anchor=0, pos_anchor_rover_body_m=ANCHORS_M[0], range_m=2.0 + 1.0)
    assert outlier_filter.filter((late,), 0.1) == ()


@pytest.mark.parametrize("anchors", [20, 21, 22])
def test_the_noise_of_the_ranges_is_found_by_any_number_of_them(anchors: int) -> None:
    """The third range of each anchor differs from the line through the two before by as much as normally distributed
    ranges with 0.1 m do: such a difference has the variance of 1 + 4 + 1 ranges."""
    outlier_filter, differences = RangeOutlierFilter(), NormalDist(0.0, 0.1 * 6.0**0.5)
    for i in range(3):
        ranges = []
        for a in range(anchors):
            fraction = min(a / (anchors - 1), 0.999)
            off_m = differences.inv_cdf(0.5 + 0.5 * fraction) if i == 2 else 0.0
            t_ns, range_m = i * 50 * MS, 5.0 + 0.1 * i + off_m
            ranges.append(UwbRange(t_ns=t_ns, anchor=a, pos_anchor_rover_body_m=ANCHORS_M[0], range_m=range_m))
        outlier_filter.filter(ranges, 0.1)
    assert outlier_filter.std_m == pytest.approx(0.1, rel=0.02)


def noisy_ranges(first_ms: int, seconds: float, std_m: float, period_ms: int = 50) -> Iterator[tuple[UwbRange, ...]]:
    """Ranges of a vehicle that stands still, in rounds of four anchors."""
    rng = np.random.default_rng(4)
    for ms in range(first_ms, first_ms + int(1000 * seconds), period_ms):
        yield tuple(
            UwbRange(t_ns=ms * MS, anchor=a, pos_anchor_rover_body_m=place_m, range_m=5.0 + std_m * rng.normal())
            for a, place_m in enumerate(ANCHORS_M)
        )


def test_the_noise_of_the_ranges_is_that_of_the_last_two_seconds() -> None:
    outlier_filter = RangeOutlierFilter()
    for ranges in noisy_ranges(0, 5.0, 0.2):
        outlier_filter.filter(ranges, 0.02)
    assert outlier_filter.std_m == pytest.approx(0.2, rel=0.3)
    for ranges in noisy_ranges(5000, 2.2, 0.02):
        outlier_filter.filter(ranges, 0.02)
    assert outlier_filter.std_m == pytest.approx(0.02, rel=0.3)
    for ranges in noisy_ranges(7200, 2.2, 0.2):
        outlier_filter.filter(ranges, 0.02)
    assert outlier_filter.std_m == pytest.approx(0.2, rel=0.3)


@pytest.mark.parametrize(("excess_m", "rounds", "used"), [(0.15, 9, 4), (0.25, 9, 3), (-2.0, 9, 4), (2.0, 3, 4)])
def test_a_range_that_is_suddenly_longer_by_more_than_the_noise_explains_is_dropped(
    excess_m: float, rounds: int, used: int
) -> None:
    """Three standard deviations of 0.02 m, and 12 cm. A shorter range has a line of sight, and three rounds show no
    trend."""
    outlier_filter, ranges = RangeOutlierFilter(), tuple[UwbRange, ...]()
    for ranges in noisy_ranges(0, 0.05 * rounds, 0.001):
        assert outlier_filter.filter(ranges, 0.02) == ranges
    late = tuple(changed(r, t_ns=r.t_ns + 50 * MS, range_m=r.range_m + excess_m * (r.anchor == 2)) for r in ranges)
    assert len(outlier_filter.filter(late, 0.02)) == used


def test_a_range_without_line_of_sight_is_dropped_at_10_hz_too() -> None:
    outlier_filter, ranges = RangeOutlierFilter(), tuple[UwbRange, ...]()
    for ranges in noisy_ranges(0, 1.0, 0.001, period_ms=100):
        assert outlier_filter.filter(ranges, 0.02) == ranges
    late = tuple(changed(r, t_ns=r.t_ns + 100 * MS, range_m=r.range_m + 1.0 * (r.anchor == 2)) for r in ranges)
    assert [r.anchor for r in outlier_filter.filter(late, 0.02)] == [0, 1, 3]


def test_an_anchor_that_repeats_its_range_to_the_last_digit_is_dropped_until_it_measures_again() -> None:
    outlier_filter = RangeOutlierFilter()
    used = list[set[int]]()
    for i, ranges in enumerate(noisy_ranges(0, 0.5, 0.01)):
        stuck = tuple(changed(r, range_m=5.0) if r.anchor == 1 and i < 8 else r for r in ranges)
        used.append({r.anchor for r in outlier_filter.filter(stuck, 0.02)})
    assert used == [{0, 1, 2, 3}] * 3 + [{0, 2, 3}] * 5 + [{0, 1, 2, 3}] * 2


def test_the_altimeter_counts_only_where_its_beam_surely_meets_the_platform() -> None:
    beam = AltimeterMeasurement(0, 5.4, np.array((0.0, 0.0, -0.1)), np.array((0.0, 0.0, 1.0)), 0.5, 0.03)
    above = (POS_ROVER_M[0], POS_ROVER_M[1], POS_ROVER_M[2] - 5.3)
    assert beam.fuse(kalman_at(np.array(above), 0.03), GATE).used == 1
    aside = np.array(above) + np.array((0.45, 0.0, 0.0))
    assert beam.fuse(kalman_at(aside, 0.03), GATE) == UpdateResult(0, 0)
    assert beam.fuse(kalman_at(np.array(above), 0.2), GATE) == UpdateResult(0, 0)
    tilted = changed(beam, beam_ned=np.array((np.sin(0.1), 0.0, np.cos(0.1))))
    assert tilted.fuse(kalman_at(np.array(above), 0.03), GATE) == UpdateResult(0, 0)


def test_the_altimeter_is_corrected_for_tilt() -> None:
    low = (POS_ROVER_M[0], POS_ROVER_M[1], POS_ROVER_M[2] - 1.0)
    tilt_rad = 0.2
    beam_ned = np.array((np.sin(tilt_rad), 0.0, np.cos(tilt_rad)))
    measured = AltimeterMeasurement(0, 1.1 / np.cos(tilt_rad), np.array((0.0, 0.0, -0.1)), beam_ned, 0.5, 0.03)
    kalman = kalman_at(np.array(low), 0.02)
    assert measured.fuse(kalman, GATE).used == 1
    assert abs(float(kalman.pos_rel_m[2]) + 1.0) < 1e-6
    assert POS_UAV_M.shape == (3,)
