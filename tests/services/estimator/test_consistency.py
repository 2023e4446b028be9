"""What contradicts the rest is found, named and left out."""

from collections.abc import Iterator

import numpy as np
import pytest

from jezero.base.arrays import Array
from jezero.base.vehicle_config import PlatformConfig
from jezero.services.estimator.config import Tuning, ValidityConfig
from jezero.services.estimator.consistency import HEADINGS_MIN, ConsistencyMonitor, DeadReckoning
from jezero.services.estimator.measurements import (
    AltimeterMeasurement,
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
    UwbMeasurement,
)
from jezero.services.estimator.motion_check import PathDifference
from jezero.services.estimator.relative_filter import RelativeFilter
from tests.services.estimator.test_filter import (
    ANCHORS_M,
    LEVER_M,
    MS,
    POS_ROVER_M,
    POS_UAV_M,
    YAW_RAD,
    hovering,
    kalman_at,
    ranges_m,
)

REL_M = POS_UAV_M - POS_ROVER_M
S = 1000 * MS


def pairs(errors_m: tuple[float, float, float, float]) -> list[tuple[TagMeasurement, UwbMeasurement]]:
    measured_m = ranges_m(REL_M) + np.array(errors_m)
    uwb = UwbMeasurement(0, LEVER_M, ANCHORS_M, measured_m, np.zeros(4), 0.02)
    return [(TagMeasurement(0, REL_M, REL_M, 1e-4 * np.eye(3), 0.0, None, 1.0), uwb)]


def test_one_anchor_that_measures_30_cm_too_much_is_left_out_and_named() -> None:
    monitor = ConsistencyMonitor(0.5)
    monitor.judge_uwb(pairs((0.3, 0.0, 0.0, 0.0)), YAW_RAD)
    assert monitor.anchor_left_out == (0.45, 0.45, 0.0)
    assert monitor.uwb_left_out == ""
    assert "the anchor at (0.45, 0.45, 0) is left out, its ranges are +0.30 m off the others" in monitor.left_out
    uwb = pairs((0.3, 0.0, 0.0, 0.0))[0][1].without((0.45, 0.45, 0.0))
    assert len(uwb.ranges_m) == 3
    assert uwb.anchors_m.tolist() == ANCHORS_M[1:].tolist()


@pytest.mark.parametrize("errors_m", [(0.5, -0.5, 0.4, -0.4), (1.0, 1.0, 1.0, 1.0)])
def test_ranges_of_which_no_single_anchor_stands_out_are_all_left_out(
    errors_m: tuple[float, float, float, float],
) -> None:
    monitor = ConsistencyMonitor(0.5)
    monitor.judge_uwb(pairs(errors_m), YAW_RAD)
    assert monitor.uwb_left_out.startswith("UWB is left out, as it contradicts the tag: check")
    monitor.readmit()
    assert monitor.left_out == ""


@pytest.mark.parametrize(
    ("difference", "heading_turned", "left_out"),
    [
        (PathDifference("faster", speed_error_mps=0.8), "", "the rover's speed is left out"),
        (
            PathDifference("turned", turn_rad=0.8),
            "",
            "the tags are left out, as their path is turned: check the turn of the",
        ),
        (
            PathDifference(),
            "the heading was corrected",
            "the tags are left out, as the rover's heading by them contradicts",
        ),
        (PathDifference(), "", "UWB is left out"),
    ],
)
def test_what_contradicts_the_motion_is_left_out_where_uwb_and_the_tag_agree(
    difference: PathDifference, heading_turned: str, left_out: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monitor = ConsistencyMonitor(0.5)
    monitor.heading_turned = heading_turned
    monkeypatch.setattr(monitor._tag_motion, "difference", difference)
    monitor.judge_uwb(pairs((0.3, 0.3, 0.3, 0.3)), YAW_RAD)  # a bias that all share
    assert monitor.left_out.startswith(left_out)


@pytest.mark.parametrize(
    ("range_m", "contradicted"),
    [(0.3, True), (5.4, False), (5.9, False), (9.9, True)],
    ids=["on the ground", "platform", "ground beside it", "far below"],
)
def test_an_altimeter_that_measures_neither_platform_nor_ground_contradicts_the_height(
    range_m: float, contradicted: bool
) -> None:
    monitor, kalman = ConsistencyMonitor(0.5), kalman_at(POS_UAV_M, 0.05)
    for ms in range(0, 1500, 100):
        beam = AltimeterMeasurement(ms * MS, range_m, LEVER_M, np.array((0.0, 0.0, 1.0)), 0.5, 0.03)
        monitor.check_height(beam, kalman)
    assert bool(monitor.height) == contradicted
    if range_m == 0.3:
        assert "the estimate says 5.6 m above the platform, the altimeter 0.3 m" in monitor.height


@pytest.mark.parametrize(("range_m", "contradicted"), [(7.5, False), (9.5, True)])
def test_beside_a_high_platform_the_altimeter_may_measure_to_the_ground(range_m: float, contradicted: bool) -> None:
    """The vehicle is 5.6 m above a platform that is 2 m high."""
    monitor, kalman = ConsistencyMonitor(2.0), kalman_at(POS_UAV_M, 0.05)
    for ms in (0, 1000):
        beam = AltimeterMeasurement(ms * MS, range_m, LEVER_M, np.array((0.0, 0.0, 1.0)), 0.5, 0.03)
        monitor.check_height(beam, kalman)
    assert bool(monitor.height) is contradicted


def test_a_height_is_contradicted_after_a_second_and_until_the_altimeter_agrees_again() -> None:
    monitor, kalman = ConsistencyMonitor(0.5), kalman_at(POS_UAV_M, 0.05)

    def contradicted(ms: int, range_m: float) -> bool:
        beam = AltimeterMeasurement(ms * MS, range_m, LEVER_M, np.array((0.0, 0.0, 1.0)), 0.5, 0.03)
        monitor.check_height(beam, kalman)
        return bool(monitor.height)

    assert [contradicted(ms, 0.3) for ms in (5000, 5500, 5950, 6000, 6500)] == [False, False, False, True, True]
    assert not contradicted(6600, 5.4)
    assert not contradicted(6700, 0.3) and not contradicted(7600, 0.3) and contradicted(7700, 0.3)


def test_headings_of_the_tag_that_differ_again_and_again_show_the_error_of_the_rovers_compass() -> None:
    monitor, kalman = ConsistencyMonitor(0.5), kalman_at(POS_UAV_M, 0.05)
    wrong = TagMeasurement(0, REL_M, REL_M, 1e-4 * np.eye(3), 0.0, -0.8, 0.01)  # the filter's heading is 0
    right = TagMeasurement(0, REL_M, REL_M, 1e-4 * np.eye(3), 0.0, 0.1, 0.01)
    for tag in [wrong] * (HEADINGS_MIN - 1) + [right] + [wrong] * (HEADINGS_MIN - 1):
        assert monitor.heading_error_rad(tag, kalman) is None
    assert monitor.heading_error_rad(wrong, kalman) == pytest.approx(0.8)
    assert "the rover's heading was corrected by -46 degrees" in monitor.left_out


def test_the_rovers_heading_is_corrected_to_that_of_the_tags() -> None:
    """The rover's compass is wrong by 0.8 rad, and the tags see the heading six times in a row."""
    relative, ms = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig()), 0
    while not relative.consistency.heading_turned:
        yaw_rad = YAW_RAD - 0.8 if ms >= 1000 else None
        tag = TagMeasurement(ms * MS, REL_M, REL_M, 1e-4 * np.eye(3), 0.0, yaw_rad, 0.01)
        relative.add([*hovering(0.1, start_ms=ms), tag])
        ms += 100
        assert ms < 3000
    assert relative.estimate is not None
    assert relative.estimate.yaw_rover_rad == pytest.approx(YAW_RAD - 0.8, abs=0.1)
    assert "the rover's heading was corrected by -46 degrees" in relative.consistency.left_out


def beside_a_rover(speed_mps: float, heading_error_rad: float) -> Iterator[tuple[list[Measurement], Array]]:
    """Measurements of 20 s in which the vehicle flies to and fro beside a rover, and the relative position.

    Args:
        speed_mps: of the rover, whose odometry says that it stands.
        heading_error_rad: of the rover's compass.
    """
    ahead = np.array((np.cos(YAW_RAD), np.sin(YAW_RAD), 0.0))
    for ms in range(0, 20_000, 50):
        angle_rad = ms / 2000.0
        rel_m = np.array((3.0, 4.0 * np.sin(angle_rad), -4.0))
        pos_m = POS_ROVER_M + speed_mps * ms / 1000.0 * ahead + rel_m
        vel_mps = speed_mps * ahead + np.array((0.0, 2.0 * np.cos(angle_rad), 0.0))
        yield (
            [
                OdometryMeasurement(ms * MS, np.concatenate((pos_m, vel_mps))),
                RoverOdometryMeasurement(ms * MS, 0.0, YAW_RAD + heading_error_rad, 0.0, 0.03, 0.03, 0.01),
                UwbMeasurement(ms * MS, LEVER_M, ANCHORS_M, ranges_m(rel_m), np.zeros(4), 0.02),
            ],
            rel_m,
        )


@pytest.mark.parametrize("error_rad", [0.8, -0.8])
def test_the_rovers_heading_is_corrected_by_the_path_that_uwb_measures(error_rad: float) -> None:
    relative = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    for measurements, rel_m in beside_a_rover(0.0, error_rad):
        relative.add(measurements)
        if relative.consistency.heading_turned:
            assert relative.consistency.left_out.startswith("the rover's heading was corrected by ")
            assert relative.estimate is not None
            assert relative.estimate.yaw_rover_rad == pytest.approx(YAW_RAD, abs=0.15)
            assert relative.estimate.pos_rel_m == pytest.approx(rel_m, abs=0.5)
            return
    raise AssertionError("the heading was not corrected")


def test_a_rover_that_drives_while_its_odometry_says_that_it_stands_is_found_by_the_path_of_uwb() -> None:
    relative = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    for measurements, _ in beside_a_rover(0.8, 0.0):
        relative.add(measurements)
    assert relative.consistency.left_out.startswith(
        "the rover's speed is left out, as the path by UWB is that of a rover which drives 0.8 m/s faster than"
    )
    assert relative.estimate is not None
    assert relative.estimate.vel_rover_mps == pytest.approx(
        (0.8 * np.cos(YAW_RAD), 0.8 * np.sin(YAW_RAD), 0.0), abs=0.3
    )


class TurnedWindow:
    """The place by UWB of a vehicle on a circle of 2 m around the rover, turned about the rover."""

    def __init__(self, turn_rad: float) -> None:
        self._turn_rad = turn_rad

    def position(self, t_ns: int, vel_rel_mps: Array, yaw_rad: float) -> tuple[Array, Array]:
        angle_rad = t_ns / S + self._turn_rad
        return 2.0 * np.array((np.cos(angle_rad), np.sin(angle_rad), -3.0)), 1e-6 * np.eye(3)


@pytest.mark.parametrize("turn_rad", [1.0, -1.0])
def test_the_first_turn_of_the_path_by_uwb_corrects_the_rovers_heading_and_only_the_next_leaves_uwb_out(
    turn_rad: float,
) -> None:
    monitor, kalman, window = ConsistencyMonitor(0.5), kalman_at(POS_UAV_M, 0.05), TurnedWindow(turn_rad)
    corrections_rad: list[float] = []
    for ms in range(0, 30_000, 50):
        kalman.predict_to(ms * MS)
        angle_rad = ms / 1000.0
        pos_vel = 2.0 * np.array((np.cos(angle_rad), np.sin(angle_rad), -3.0, -np.sin(angle_rad), np.cos(angle_rad), 0))
        measured: list[Measurement] = [
            OdometryMeasurement(ms * MS, pos_vel),
            RoverOdometryMeasurement(ms * MS, 0.0, 0.0, 0.0, 0.03, 0.03, 0.01),
        ]
        monitor.follow_motion(measured, kalman)
        found_rad = monitor.check_motion(measured, kalman, window)  # type: ignore[arg-type]
        if found_rad is not None:
            corrections_rad.append(found_rad)
            assert monitor.uwb_left_out == ""
            assert "the rover's heading was corrected by" in monitor.heading_turned
    assert corrections_rad == [pytest.approx(turn_rad, abs=0.01)]
    assert "its path is turned by" in monitor.uwb_left_out


def test_ranges_that_come_back_one_anchor_after_the_other_contradict_nothing() -> None:
    rng = np.random.default_rng(5)
    located = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    for ms in range(0, 20_000, 50):
        speed_mps = 1.2 if ms < 10_000 else -1.2  # out of the ranges of one anchor after the other, and back
        east_m = 6.0 + 1.2 * min(ms, 20_000 - ms) / 1000.0
        rel_m = np.array((6.5, east_m, -7.0))
        distances_m = ranges_m(rel_m) + rng.normal(0.0, 0.01, 4)
        heard = distances_m < 15.0
        odometry = np.concatenate((rel_m, (0.0, speed_mps, 0.0)))
        measurements: list[Measurement] = [
            OdometryMeasurement(ms * MS, odometry),
            RoverOdometryMeasurement(ms * MS, 0.0, YAW_RAD, 0.0, 0.03, 0.03, 0.01),
        ]
        if heard.any():
            delays_s = np.zeros(int(heard.sum()))
            measurements.append(UwbMeasurement(ms * MS, LEVER_M, ANCHORS_M[heard], distances_m[heard], delays_s, 0.02))
        located.add(measurements)
        assert located.consistency.left_out == "", f"{ms} ms"
    assert located.estimate is not None
    assert np.abs(located.estimate.pos_rel_m - np.array((6.5, 6.0, -7.0))).max() < 0.3


def circling(ms: int, turn_rad: float, height_m: float) -> list[Measurement]:
    """Measurements on a circle of 2 m around the rover, with the place by the tags turned about the rover."""
    angle_rad = ms / 1000.0
    place_m = np.array((2.0 * np.cos(angle_rad), 2.0 * np.sin(angle_rad), -height_m))
    velocity_mps = 2.0 * np.array((-np.sin(angle_rad), np.cos(angle_rad), 0.0))
    turned_m = np.array((2.0 * np.cos(angle_rad + turn_rad), 2.0 * np.sin(angle_rad + turn_rad), -height_m))
    return [
        OdometryMeasurement(ms * MS, np.concatenate((place_m, velocity_mps))),
        RoverOdometryMeasurement(ms * MS, 0.0, 0.0, 0.0, 0.03, 0.03, 0.01),
        TagMeasurement(ms * MS, turned_m, turned_m, 1e-4 * np.eye(3), 0.0, None, 1.0),
    ]


def test_a_path_by_the_tags_that_is_turned_leaves_the_tags_out() -> None:
    monitor, kalman, window = ConsistencyMonitor(0.5), kalman_at(POS_UAV_M, 0.05), TurnedWindow(0.0)
    for ms in range(0, 15_000, 50):
        kalman.predict_to(ms * MS)
        measured = circling(ms, 1.0, 6.0)
        monitor.follow_motion(measured, kalman)
        assert monitor.check_motion(measured, kalman, window) is None  # type: ignore[arg-type]
    assert monitor.tag_left_out.startswith("the tags are left out, as their path is turned by 57 degrees")
    assert monitor.uwb_left_out == monitor.speed_left_out == monitor.heading_turned == ""


def test_while_the_rovers_speed_is_left_out_no_motion_judges_the_tags() -> None:
    """The motion of vehicle and rover is not known without the rover's speed."""
    monitor, kalman, window = ConsistencyMonitor(0.5), kalman_at(POS_UAV_M, 0.05), TurnedWindow(1.0)
    monitor.speed_left_out = "the rover's speed is left out"
    for ms in range(0, 5000, 50):
        kalman.predict_to(ms * MS)
        measured = circling(ms, 1.0, 2.0)
        monitor.follow_motion(measured, kalman)
        assert monitor.check_motion(measured, kalman, window) is None  # type: ignore[arg-type]
        assert monitor.left_out == "the rover's speed is left out"


@pytest.mark.parametrize(
    ("tags_turn_rad", "left_out"),
    [
        (1.0, "the tags are left out, as their path is turned by 57 degrees"),
        (0.0, "UWB is left out, its path is turned by 57 degrees"),
    ],
)
def test_a_path_by_uwb_that_stays_turned_leaves_out_the_tags_where_they_are_turned_too(
    tags_turn_rad: float, left_out: str
) -> None:
    """The rover's heading was corrected before. Where a turned camera led to that, UWB measures right."""
    monitor, kalman, window = ConsistencyMonitor(0.5), kalman_at(POS_UAV_M, 0.05), TurnedWindow(1.0)
    monitor.heading_turned = "the rover's heading was corrected"
    for ms in range(0, 5000, 50):
        kalman.predict_to(ms * MS)
        measured = circling(ms, tags_turn_rad, 2.0)
        monitor.follow_motion(measured, kalman)
        assert monitor.check_motion(measured, kalman, window) is None  # type: ignore[arg-type]
        if monitor.uwb_left_out or monitor.tag_left_out:
            break
    assert monitor.left_out.startswith(left_out)


def test_tags_that_are_left_out_move_the_estimate_no_more() -> None:
    """Their camera is turned by 1 rad, and UWB is right."""
    relative, c, s = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig()), np.cos(1.0), np.sin(1.0)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    for measurements, rel_m in beside_a_rover(0.0, 0.0):
        t_ns, turned_m = measurements[0].t_ns, turn @ rel_m
        relative.add([*measurements, TagMeasurement(t_ns, turned_m, turned_m, 1e-4 * np.eye(3), 0.0, None, 1.0)])
        if t_ns == 5 * S:
            break
    assert relative.consistency.left_out.startswith("the tags are left out, as their path is turned by 57 degrees")
    assert "uwb" in relative.inputs and "tag" not in relative.inputs
    assert relative.estimate is not None
    assert relative.estimate.pos_rel_m == pytest.approx(rel_m, abs=0.1)


def test_the_reckoned_way_is_the_integral_of_the_odometry_and_a_gap_counts_as_half_a_second() -> None:
    """The rover drives at 0.8 m/s along a heading of 0.6 rad, the vehicle at (0.5, -0.2) m/s."""
    reckoning, ahead = DeadReckoning(), np.array((np.cos(0.6), np.sin(0.6)))
    assert reckoning.sample(S, (1.0, 2.0), 0.1) is None
    for ms in (0, *range(50, 2050, 50), 1980, 7000):  # 50 ms apart, one that comes late, and a gap of five seconds
        pos_vel = np.array((0.5 * ms / 1000.0, -0.2 * ms / 1000.0, -3.0, 0.5, -0.2, 0.0))
        measured: list[Measurement] = [
            RoverOdometryMeasurement(ms * MS + S, 0.8, 0.6, 0.0, 0.03, 0.03, 0.01),
            OdometryMeasurement(ms * MS + S, pos_vel),
        ]
        reckoning.add(measured, 0.6)
    way_s = 0.5 + 2.0 + 0.5 + 0.1  # the first message, the steps, the gap, and what is later than the last message
    sample = reckoning.sample(7_100 * MS + S, (1.0, 2.0), 0.1)
    assert sample is not None
    assert sample.measured_m == (1.0, 2.0) and sample.std_m == 0.1 and sample.t_ns == 7_100 * MS + S
    assert sample.heading_way_m == pytest.approx(tuple(way_s * ahead))
    vehicle_m = 7.1 * np.array((0.5, -0.2))
    assert sample.reckoned_m == pytest.approx(tuple(vehicle_m - 0.8 * way_s * ahead))
