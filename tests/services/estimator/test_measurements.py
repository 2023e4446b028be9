"""How far each state that a measurement depends on spreads its expected value."""

import numpy as np
import pytest

from jezero.base.arrays import Array
from jezero.services.estimator.innovations import Innovation
from jezero.services.estimator.kalman import FilterState
from jezero.services.estimator.measurements import UwbMeasurement
from jezero.services.estimator.motion import SIZE, YAW
from tests.services.estimator.test_filter import ANCHORS_M, POS_ROVER_M, kalman_at

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
