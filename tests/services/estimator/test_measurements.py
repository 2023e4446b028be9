"""How far each state that a measurement depends on spreads its expected value."""

import numpy as np
import pytest

from jezero.base.arrays import Array
from jezero.services.estimator.innovations import Innovation
from jezero.services.estimator.kalman import FilterState, Kalman, UpdateResult
from jezero.services.estimator.measurements import (
    AltimeterMeasurement,
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
    UwbMeasurement,
)
from jezero.services.estimator.motion import (
    ATTITUDE_ERROR,
    SIZE,
    TAG_SCALE,
    UWB_BIAS,
    VEL_ROVER,
    VEL_UAV,
    YAW,
    YAW_RATE,
)
from tests.services.estimator.test_filter import ANCHORS_M, GATE, POS_ROVER_M, POS_UAV_M, kalman_at

NO_GATE = (1e12, 1e12)


def spread_by_yaw_m2(pos_rel_m: tuple[float, float, float], yaw_rad: float, std_yaw_rad: float) -> Array:
    """(4, 4) covariance that the uncertain heading of the rover alone gives the expected ranges."""
    kalman = kalman_at(POS_ROVER_M + np.array(pos_rel_m), 0.1)
    x, P = kalman.x.copy(), np.zeros((SIZE, SIZE))
    x[YAW], P[YAW, YAW] = yaw_rad, std_yaw_rad**2
    kalman.restore(FilterState(0, x, P))
    seen: list[Innovation] = []
    kalman.observer = seen.append
    UwbMeasurement(0, np.zeros(3), ANCHORS_M, np.full(4, 5.0), np.zeros(4), 0.02).fuse(kalman, NO_GATE)
    (innovation,) = seen
    spread_m2: Array = innovation.cov - innovation.cov_noise
    return spread_m2


@pytest.mark.parametrize(
    ("pos_rel_m", "yaw_rad", "per_rad_m"),
    [
        ((3.0, 0.0, -4.0), 0.0, (0.28332, -0.28332, -0.25465, 0.25465)),
        ((0.0, 3.0, -4.0), np.pi / 2.0, (0.28332, -0.28332, -0.25465, 0.25465)),
        ((0.0, 3.0, -4.0), 0.0, (-0.28332, -0.25465, 0.25465, 0.28332)),
        ((3.0, 1.5, -4.0), 0.0, (0.13893, -0.39483, -0.11988, 0.37600)),
        ((0.0, 0.0, -5.0), 0.7, (0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_an_uncertain_heading_of_the_rover_spreads_the_ranges_of_its_anchors(
    pos_rel_m: tuple[float, float, float], yaw_rad: float, per_rad_m: tuple[float, ...]
) -> None:
    """Three metres ahead of the rover and four up, the anchor at (0.45, 0.45) is √(2.55² + 0.45² + 4²) = 4.7650 m
    away. When the rover turns, the anchor moves by (-0.45, 0.45) m per radian, and the range grows by
    (2.55 · 0.45 + 0.45 · 0.45) / 4.7650 = 0.2833 m; that of (-0.45, 0.45), √(3.45² + 0.45² + 4²) = 5.3014 m away, by
    (3.45 · 0.45 - 0.45 · 0.45) / 5.3014 = 0.2546 m."""
    spread_m2 = spread_by_yaw_m2(pos_rel_m, yaw_rad, 0.1)
    assert spread_m2 == pytest.approx(0.01 * np.outer(per_rad_m, per_rad_m), abs=1e-6)


REL_M, LEVER_M = np.array((0.06, -0.05, -4.0)), np.array((0.05, 0.02, -0.1))
BEAM_NED = np.array((0.02, -0.01, 0.9997))
MEASUREMENTS: list[Measurement] = [
    OdometryMeasurement(0, np.array((9.1, -3.5, -4.4, 0.1, 0.2, 0.3))),
    RoverOdometryMeasurement(0, 0.5, 0.6, 0.1, 0.03, 0.03, 0.01),
    UwbMeasurement(0, LEVER_M, 0.9 * ANCHORS_M, np.full(4, 4.1), -0.01 * np.arange(4.0), 0.02),
    AltimeterMeasurement(0, 4.1, LEVER_M, BEAM_NED, 0.5, 0.03),
    TagMeasurement(0, REL_M, 1.01 * REL_M, 1e-4 * np.eye(3), 0.4, 0.6, 0.02),
]


def certain_at(x: Array) -> Kalman:
    """A filter whose state is nearly certain, so that no update moves it."""
    kalman, root = kalman_at(POS_ROVER_M, 0.1), np.random.default_rng(1).normal(size=(SIZE, SIZE))
    kalman.restore(FilterState(0, x, 1e-9 * root @ root.T))
    return kalman


def innovations_at(x: Array, measurement: Measurement) -> list[Innovation]:
    kalman, seen = certain_at(x), list[Innovation]()
    kalman.observer = seen.append
    measurement.fuse(kalman, NO_GATE)
    return seen


@pytest.mark.parametrize("measurement", MEASUREMENTS, ids=lambda measurement: measurement.kind)
def test_the_spread_of_each_innovation_follows_from_its_derivative(measurement: Measurement) -> None:
    rng = np.random.default_rng(2)
    x = kalman_at(POS_ROVER_M + REL_M, 0.1).x + 0.01 * rng.normal(size=SIZE)
    x[3:6], x[9:12], x[YAW] = (0.3, -0.2, 0.1), (0.5, 0.2, 0.0), 0.55
    root = np.random.default_rng(1).normal(size=(SIZE, SIZE))
    step = 1e-5
    found = innovations_at(x, measurement)
    assert found
    for i, innovation in enumerate(found):
        moved = [
            (innovations_at(x + each, measurement)[i].residual - innovations_at(x - each, measurement)[i].residual)
            for each in step * np.eye(SIZE)
        ]
        H = -np.array(moved).T / (2.0 * step)
        spread = innovation.cov - innovation.cov_noise
        assert spread == pytest.approx(1e-9 * H @ root @ root.T @ H.T, rel=0.01, abs=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_measurements_of_the_true_state_have_no_innovation(seed: int) -> None:
    """Each is made from the state by its model: ranges with delays and a common error, the beam to a level platform,
    the rover's speed along its heading, and a position by the tags that is turned and scaled by their errors."""
    rng = np.random.default_rng(seed)
    x = np.zeros(SIZE)
    x[:3], x[6:9] = POS_ROVER_M + REL_M + rng.normal(0.0, 0.05, 3), POS_ROVER_M
    x[3:6], x[YAW], x[13], x[UWB_BIAS] = rng.normal(size=3), rng.uniform(-3.0, 3.0), rng.normal(), rng.normal(0.0, 0.1)
    c, s = np.cos(x[YAW]), np.sin(x[YAW])
    speed_mps, rel_m, delays_s = rng.normal(), x[:3] - x[6:9], -0.01 * np.arange(4.0)
    x[9:12] = speed_mps * c, speed_mps * s, 0.0
    to_ned = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    tags_ned_m = rel_m + LEVER_M + delays_s[:, None] * (x[3:6] - x[9:12])
    ranges_m = np.linalg.norm(tags_ned_m - ANCHORS_M @ to_ned.T, axis=1) + x[UWB_BIAS]
    beam_m = -(rel_m + LEVER_M)[2] / BEAM_NED[2]
    made: list[Measurement] = [
        OdometryMeasurement(0, x[:6]),
        RoverOdometryMeasurement(0, speed_mps, x[YAW], x[13], 0.03, 0.03, 0.01),
        UwbMeasurement(0, LEVER_M, ANCHORS_M, ranges_m, delays_s, 0.02),
        AltimeterMeasurement(0, beam_m, LEVER_M, BEAM_NED, 0.5, 0.03),
        TagMeasurement(0, rel_m, rel_m, 1e-4 * np.eye(3), 0.4, x[YAW], 0.02),
    ]
    for measurement in made:
        for innovation in innovations_at(x, measurement):
            assert innovation.residual == pytest.approx(0.0, abs=1e-6), innovation.sensor
    x[ATTITUDE_ERROR], x[TAG_SCALE] = 0.01 * rng.normal(size=3), 0.02
    heading = np.array(((np.cos(0.4), -np.sin(0.4), 0.0), (np.sin(0.4), np.cos(0.4), 0.0), (0.0, 0.0, 1.0)))
    seen_m = 1.02 * rel_m + np.cross(heading @ x[ATTITUDE_ERROR], rel_m)
    tag = TagMeasurement(0, seen_m, seen_m, 1e-4 * np.eye(3), 0.4, None, 0.02)
    assert innovations_at(x, tag)[0].residual == pytest.approx(0.0, abs=5e-3)
    assert np.linalg.norm(innovations_at(np.where(np.arange(SIZE) < 14, x, 0.0), tag)[0].residual) > 0.05


def test_a_time_that_is_not_known_exactly_makes_a_measurement_as_uncertain_as_the_motion_is_fast() -> None:
    """At 2 m/s an uncertainty of 0.05 s is one of 0.1 m along the motion; so is that of a turn that swings the arm."""
    x = np.zeros(SIZE)
    x[0:3], x[3:6], x[6:9] = POS_ROVER_M, (0.0, 0.0, 2.0), POS_ROVER_M
    x[2] -= 4.0
    overhead = UwbMeasurement(0, np.zeros(3), np.zeros((1, 3)), np.full(1, 4.0), np.zeros(1), 0.02, std_time_s=0.05)
    (found,) = innovations_at(x, overhead)
    assert found.cov_noise == pytest.approx(np.array([[0.02**2 + 0.1**2]]))
    arm_m, swing_mps = np.array((0.0, 0.0, -4.0)), np.array((1.0, 0.0, 0.0))
    tag = TagMeasurement(0, arm_m, arm_m, 1e-4 * np.eye(3), 0.4, None, 0.02)
    late = TagMeasurement(0, arm_m, arm_m, 1e-4 * np.eye(3), 0.4, None, 0.02, 1.0, 0.05, swing_mps)
    grown = innovations_at(x, late)[0].cov_noise - innovations_at(x, tag)[0].cov_noise
    assert grown == pytest.approx(np.diag((0.05**2, 0.0, 0.1**2)), abs=1e-9)


@pytest.mark.parametrize(("off_m", "used"), [(0.0, 1), (1.0, 0)])
def test_a_range_that_does_not_fit_is_one_that_was_offered_and_not_used(off_m: float, used: int) -> None:
    kalman = kalman_at(POS_ROVER_M + np.array((0.0, 0.0, -4.0)), 0.05)
    below_m = 4.0 - float(LEVER_M[2])
    found = AltimeterMeasurement(0, below_m + off_m, LEVER_M, BEAM_NED, 0.5, 0.03).fuse(kalman, GATE)
    assert found == UpdateResult(used, offered=1)


def test_a_wrong_attitude_turns_the_lever_arm_of_the_tags_on_each_axis() -> None:
    """About the axes forward, right and down of a vehicle with a heading of 0.4 rad."""
    lever_m = np.array((1.5, -2.0, -4.0))
    c, s = np.cos(0.4), np.sin(0.4)
    axes_ned = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    jacobian = TagMeasurement(0, lever_m, lever_m, 1e-4 * np.eye(3), 0.4, None, 0.02).error_jacobian()
    for axis_ned, column in zip(axes_ned, jacobian[:, ATTITUDE_ERROR].T, strict=True):
        assert column == pytest.approx(np.cross(axis_ned, lever_m))


@pytest.mark.parametrize(("vel_rover_mps", "rate_mps"), [(0.0, 3.0), (3.0, 0.0), (-3.0, 6.0)])
def test_an_uncertain_time_counts_by_the_speed_at_which_a_range_changes(vel_rover_mps: float, rate_mps: float) -> None:
    """The vehicle flies at 3 m/s straight away from an anchor of a rover that drives along the same line."""
    kalman = kalman_at(POS_ROVER_M + np.array((9.0, 0.0, 0.0)), 0.01)
    kalman.x[VEL_UAV], kalman.x[VEL_ROVER] = (3.0, 0.0, 0.0), (vel_rover_mps, 0.0, 0.0)
    seen: list[Innovation] = []
    kalman.observer = seen.append
    uwb = UwbMeasurement(0, np.zeros(3), np.zeros((1, 3)), np.array((9.0,)), np.zeros(1), 0.02, std_time_s=0.01)
    uwb.fuse(kalman, NO_GATE)
    assert seen[0].cov_noise == pytest.approx(np.array([[0.02**2 + (0.01 * rate_mps) ** 2]]))


@pytest.mark.parametrize(
    ("measurement", "vel_rover_mps"),
    [
        (RoverOdometryMeasurement(0, 0.0, 0.6, 0.0, 0.03, 0.03, 0.01), (0.0, 0.0, 0.0)),
        (RoverOdometryMeasurement(0, 1.0, 0.6, 0.0, 0.03, 0.03, 0.01), (np.cos(0.6), np.sin(0.6), 0.0)),
        (RoverOdometryMeasurement(0, -1.0, 0.6, 0.0, 0.03, 0.03, 0.01), (-np.cos(0.6), -np.sin(0.6), 0.0)),
        (
            RoverOdometryMeasurement(0, 9.0, 0.6, 0.0, 0.03, 0.03, 0.01, speed_known=False),
            (0.5 * np.cos(0.6), 0.5 * np.sin(0.6), 0.0),
        ),
        (
            RoverOdometryMeasurement(0, 1.0, 0.6, 0.0, 0.03, 0.03, 0.01, heaves=True),
            (np.cos(0.6), np.sin(0.6), 0.4),
        ),
    ],
    ids=["stands", "drives", "drives backwards", "speed is not used", "heaves"],
)
def test_a_rover_moves_along_its_heading_alone_and_only_a_deck_that_heaves_moves_down(
    measurement: RoverOdometryMeasurement, vel_rover_mps: tuple[float, float, float]
) -> None:
    """Before, the filter believes in 0.5 m/s ahead, 0.3 m/s to the right and 0.4 m/s down, to 1 m/s each. Its speed
    ahead stays where the odometry's isn't used, and its speed down where the deck may heave."""
    kalman, c, s = kalman_at(POS_UAV_M, 0.1), np.cos(0.6), np.sin(0.6)
    x, P = kalman.x.copy(), np.zeros((SIZE, SIZE))
    x[YAW], x[VEL_ROVER] = 0.6, (0.5 * c - 0.3 * s, 0.5 * s + 0.3 * c, 0.4)
    P[VEL_ROVER, VEL_ROVER] = np.eye(3)
    kalman.restore(FilterState(0, x, P))
    measurement.fuse(kalman, NO_GATE)
    assert kalman.x[VEL_ROVER] == pytest.approx(vel_rover_mps, abs=0.03 if measurement.speed_known else 0.1)


def test_a_heading_of_the_rover_beyond_the_gate_is_rejected_and_moves_the_filter_by_a_fraction_of_its_error() -> None:
    """A heading that is wrong by 1 rad. Rejecting it whole would keep a filter wrong that is wrong itself."""
    kalman = kalman_at(POS_UAV_M, 0.1)
    kalman.P[YAW, YAW] = 0.03**2
    assert RoverOdometryMeasurement(0, 0.0, 1.0, 0.2, 0.03, 0.03, 0.01).fuse(kalman, GATE) == UpdateResult(0, 1)
    assert 0.001 < kalman.x[YAW] < 0.1
    assert kalman.x[YAW_RATE] == pytest.approx(0.2, abs=0.01)


STRAIGHT_DOWN = np.array((0.0, 0.0, 1.0))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("part", "used"), [(0.95, True), (1.05, False)], ids=["within", "beyond"])
@pytest.mark.parametrize("sensor", ["rover_yaw", "rover_yaw_rate", "uwb", "altimeter", "tag", "tag_yaw"])
def test_a_measurement_counts_up_to_the_root_of_the_gate_times_its_standard_deviation(
    sensor: str, part: float, side: float, used: bool
) -> None:
    """The state is nearly certain, so an innovation has the standard deviation of the measurement: 0.02."""
    x = np.zeros(SIZE)
    x[0:3], x[6:9] = POS_ROVER_M + np.array((0.0, 0.0, -4.0)), POS_ROVER_M
    off = {sensor: side * part * 0.02 * np.sqrt(GATE[1] if sensor == "tag" else GATE[0])}
    ones = np.full(1, 1.0)
    rel_m = np.array((0.0, 0.0, -4.0 + off.get("tag", 0.0)))
    tag_std_m = np.sqrt(0.02**2 - 0.003**2)
    made: dict[str, Measurement] = {
        "rover": RoverOdometryMeasurement(
            0,
            0.0,
            off.get("rover_yaw", 0.0),
            off.get("rover_yaw_rate", 0.0),
            0.02,
            0.02,
            0.02,
        ),
        "uwb": UwbMeasurement(0, np.zeros(3), np.zeros((1, 3)), 4.0 * ones + off.get("uwb", 0.0), 0.0 * ones, 0.02),
        "altimeter": AltimeterMeasurement(0, 4.0 + off.get("altimeter", 0.0), np.zeros(3), STRAIGHT_DOWN, 0.5, 0.02),
        "tag": TagMeasurement(0, rel_m, rel_m, tag_std_m**2 * np.eye(3), 0.0, off.get("tag_yaw", 0.0), 0.02),
    }
    kalman, seen = certain_at(x), list[Innovation]()
    kalman.observer = seen.append
    result = next(measurement for kind, measurement in made.items() if sensor.startswith(kind)).fuse(kalman, GATE)
    assert [bool(each.accepted.all()) for each in seen if each.sensor == sensor] == [used]
    assert (result.used == result.offered > 0) is (used or sensor == "tag_yaw")  # the position by the tag counts


def test_positions_by_the_tags_are_as_uncertain_across_the_line_of_sight_as_the_attitude_of_one_picture() -> None:
    """0.003 rad, which are 3 cm from 10 m; along the line of sight an angle changes nothing."""
    high_m = np.array((0.0, 0.0, -10.0))
    cov_m2 = TagMeasurement(0, high_m, high_m, 1e-10 * np.eye(3), 0.4, None, 0.02).measurement_cov_m2()
    assert np.sqrt(np.diag(cov_m2)) == pytest.approx((0.03, 0.03, 0.003), abs=0.002)


def test_tags_near_the_camera_are_not_believed_to_be_better_than_their_print_and_mounting() -> None:
    """3 mm. From 0.3 m the detector alone is good to hundredths of a millimetre, and one wrong tag on the board would
    count for more than all else."""
    near_m = np.array((0.0, 0.0, -0.3))
    cov_m2 = TagMeasurement(0, near_m, near_m, 1e-10 * np.eye(3), 0.4, None, 0.02).measurement_cov_m2()
    assert np.sqrt(np.diag(cov_m2)) == pytest.approx((0.003, 0.003, 0.003), abs=0.0002)
