"""The first position by UWB beside the simulated truth and a general least squares fit."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from jezero.base.arrays import Array
from jezero.base.vehicle_config import PlatformConfig
from jezero.services.estimator.measurements import UwbMeasurement
from jezero.services.estimator.trilateration import INFORMATION_MIN, trilaterate
from jezero.services.estimator.uwb_initialization import ROUNDS_MIN, STD_FLOOR_M, STD_HEIGHT_AMBIGUOUS_M, UwbWindow
from tests.services.estimator.test_filter import ANCHORS_M, LEVER_M, MS

PLATFORM = PlatformConfig()
PERIOD_NS = 50 * MS
ANCHORS = [(float(x), float(y), float(z)) for x, y, z in ANCHORS_M]


@pytest.mark.parametrize("seed", range(10))
def test_trilateration_is_the_least_squares_fit_above_the_anchors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle_m = rng.uniform(-5.0, 5.0, 3)
    anchors_m = middle_m + ANCHORS_M + rng.normal(0.0, 0.01, (4, 3))
    true_m = middle_m + rng.uniform((-3.0, -3.0, -8.0), (3.0, 3.0, -1.0))
    ranges_m = np.linalg.norm(true_m - anchors_m, axis=1) + rng.normal(0.0, 0.01, 4)
    found = trilaterate([(x, y, z) for x, y, z in anchors_m.tolist()], ranges_m.tolist())
    fit = least_squares(lambda p: np.linalg.norm(p - anchors_m, axis=1) - ranges_m, true_m, xtol=1e-12)
    assert found is not None
    assert found[0] == pytest.approx(tuple(fit.x), abs=1e-4)
    expected = np.linalg.inv(fit.jac.T @ fit.jac + INFORMATION_MIN * np.eye(3))
    assert found[1] == pytest.approx(expected, rel=1e-2, abs=1e-2)


def test_trilateration_finds_the_exact_place_whatever_the_anchors_are() -> None:
    """Three to five anchors at unequal distances from their middle, up to 2 m, and a vehicle that is near or far."""
    rng, tried = np.random.default_rng(0), 0
    for _ in range(100):
        anchors_m = rng.uniform(-2.0, 2.0, (int(rng.integers(3, 6)), 3)) * (1.0, 1.0, 0.0)
        true_m = rng.uniform((-5.0, -5.0, -10.0), (5.0, 5.0, -0.3))
        if np.linalg.cond((anchors_m - anchors_m.mean(axis=0))[:, :2]) > 8.0:  # nearly on one line
            continue
        ranges_m = np.linalg.norm(true_m - anchors_m, axis=1)
        found = trilaterate([(x, y, z) for x, y, z in anchors_m.tolist()], ranges_m.tolist())
        assert found is not None and found[0] == pytest.approx(tuple(true_m), abs=1e-3)
        tried += 1
    assert tried > 70


def round_at(t_ns: int, rel_m: Array, vel_mps: Array, yaw_rad: float) -> UwbMeasurement:
    """Exact ranges of a vehicle that is at `rel_m` at time 0, each a little earlier than the one before."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    anchors_ned_m = ANCHORS_M @ np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))).T
    delays_s = -0.002 * np.arange(4.0)
    tags_m = rel_m + LEVER_M + (t_ns * 1e-9 + delays_s)[:, None] * vel_mps
    return UwbMeasurement(t_ns, LEVER_M, ANCHORS_M, np.linalg.norm(tags_m - anchors_ned_m, axis=1), delays_s, 0.02)


def window_of(rel_m: Array, vel_mps: Array, yaw_rad: float, count: int, outlier_m: float = 0.0) -> UwbWindow:
    """A window whose newest round is at time 0; one range in it is wrong."""
    window = UwbWindow(PLATFORM)
    for number in range(count):
        uwb = round_at((number + 1 - count) * PERIOD_NS, rel_m, vel_mps, yaw_rad)
        if number == 2:
            uwb.ranges_m[1] += outlier_m
        window.add(uwb)
        window.add(uwb)  # comes twice
    return window


@pytest.mark.parametrize("outlier_m", [0.0, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_moving_vehicle_is_found_with_one_wrong_range_too(seed: int, outlier_m: float) -> None:
    rng = np.random.default_rng(seed)
    rel_m = rng.uniform((-2.0, -2.0, -7.0), (2.0, 2.0, -3.0))
    vel_mps, yaw_rad = rng.uniform(-1.0, 1.0, 3), rng.uniform(-3.0, 3.0)
    found = window_of(rel_m, vel_mps, yaw_rad, 11, outlier_m).position(0, vel_mps, yaw_rad)
    assert found is not None
    assert found[0] == pytest.approx(rel_m, abs=0.02 if outlier_m == 0.0 else 0.2)
    unit = trilaterate(ANCHORS, round_at(0, rel_m, np.zeros(3), yaw_rad).ranges_m.tolist())
    assert unit is not None
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    to_ned = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    expected = to_ned @ unit[1] @ to_ned.T * (2.0 * 0.02) ** 2 / 11 + STD_FLOOR_M**2 * np.eye(3)
    if outlier_m == 0.0:
        assert found[1] == pytest.approx(expected, rel=0.02, abs=1e-3)


def test_too_few_rounds_and_old_ones_give_no_position() -> None:
    rel_m, still = np.array((1.0, 0.5, -4.0)), np.zeros(3)
    assert window_of(rel_m, still, 0.0, ROUNDS_MIN - 1).position(0, still, 0.0) is None
    window = window_of(rel_m, still, 0.0, ROUNDS_MIN)
    assert window.position(0, still, 0.0) is not None
    assert window.position(12 * PERIOD_NS, still, 0.0) is None
    assert window.position(-PERIOD_NS, still, 0.0) is None
    window.clear()
    assert window.position(0, still, 0.0) is None


@pytest.mark.parametrize(
    ("ahead_m", "above_m", "ambiguous"),
    [(2.0, 0.9, True), (2.0, 1.1, False), (0.75, 0.9, True), (0.65, 0.9, False), (-2.0, 0.9, True)],
)
def test_beside_the_platform_the_height_is_ambiguous_up_to_half_a_metre_more_than_its_own(
    ahead_m: float, above_m: float, ambiguous: bool
) -> None:
    """The platform is 1 m wide and 0.5 m high; the UWB tag is `above_m` above it."""
    assert (PLATFORM.side_m, PLATFORM.height_m) == (1.0, 0.5)
    still = np.zeros(3)
    found = window_of(np.array((ahead_m, 0.0, -above_m)) - LEVER_M, still, 0.0, ROUNDS_MIN).position(0, still, 0.0)
    assert found is not None
    assert (found[1][2, 2] > STD_HEIGHT_AMBIGUOUS_M**2) == ambiguous
