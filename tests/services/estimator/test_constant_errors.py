"""Constant errors of the inputs are estimated, so that the inputs agree."""

import numpy as np
import pytest

from jezero.base.arrays import Array
from jezero.base.vehicle_config import PlatformConfig
from jezero.services.estimator.config import Tuning, ValidityConfig
from jezero.services.estimator.measurements import (
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
    UwbMeasurement,
)
from jezero.services.estimator.motion import COMPASS_BIAS, SIZE, TAG_SCALE, UWB_BIAS
from jezero.services.estimator.relative_filter import RelativeFilter
from tests.services.estimator.test_filter import (
    ANCHORS_M,
    GATE,
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


def wrong_uwb(t_ns: int, bias_m: float, rng: np.random.Generator) -> UwbMeasurement:
    measured_m = ranges_m(REL_M) + bias_m + rng.normal(0.0, 0.01, 4)
    return UwbMeasurement(t_ns, LEVER_M, ANCHORS_M, measured_m, np.zeros(4), 0.02)


def wrong_tag(t_ns: int, scale: float, rng: np.random.Generator) -> TagMeasurement:
    lever_arm_m = scale * REL_M + rng.normal(0.0, 0.01, 3)
    return TagMeasurement(t_ns, lever_arm_m, lever_arm_m, 1e-4 * np.eye(3), 0.0, None, 1.0)


def fused(uwb_bias_m: float, tag_scale: float) -> RelativeFilter:
    """The filter after 4 s of hover with both inputs."""
    rng = np.random.default_rng(1)
    relative = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    for ms in range(0, 4000, 100):
        measurements: list[Measurement] = list(hovering(0.1, start_ms=ms))
        measurements += [wrong_uwb((ms + i) * MS, uwb_bias_m, rng) for i in (0, 50)]
        measurements.append(wrong_tag((ms + 33) * MS, tag_scale, rng))
        relative.add(measurements)
        assert relative.rejected_inputs == ()
    return relative


def test_ranges_that_are_all_30_cm_too_long_do_not_contradict_the_tag() -> None:
    relative = fused(0.3, 1.0)
    assert relative.estimate is not None
    # 30 cm of 5.6 m may as well be tags that are 5 % too small: one standard deviation of the scale, three of the bias.
    assert relative.estimate.pos_rel_m == pytest.approx(REL_M * (1.0 + 0.3 / 5.6), abs=0.15)
    assert relative.std_pos_m > 0.05


@pytest.mark.parametrize("bias_m", [0.7, -0.7])
def test_ranges_that_are_right_again_are_used_though_the_filter_knew_their_common_error_well(bias_m: float) -> None:
    rng = np.random.default_rng(2)
    relative = RelativeFilter(Tuning(), ValidityConfig(), PlatformConfig())
    errors_m: dict[int, float] = {}
    for ms in range(0, 10000, 20):
        t_s = ms / 1000
        swaying_m = np.array((1.5 * np.sin(t_s), 0.0, -2.0 - np.sin(0.7 * t_s)))  # it shows the error that ranges share
        swaying_mps = np.array((1.5 * np.cos(t_s), 0.0, -0.7 * np.cos(0.7 * t_s)))
        measurements: list[Measurement] = [
            OdometryMeasurement(ms * MS, np.concatenate((POS_ROVER_M + swaying_m, swaying_mps))),
            RoverOdometryMeasurement(ms * MS, 0.0, YAW_RAD, 0.0, 0.03, 0.03, 0.01),
        ]
        if ms % 60 == 0:
            measured_m = ranges_m(swaying_m) + rng.normal(0.0, 0.01, 4) + (bias_m if t_s < 5.0 else 0.0)
            measurements.append(UwbMeasurement(ms * MS, LEVER_M, ANCHORS_M, measured_m, np.zeros(4), 0.02))
        relative.add(measurements)
        assert relative.estimate is not None
        errors_m[ms] = float(np.linalg.norm(relative.estimate.pos_rel_m - swaying_m))
    assert max(error_m for ms, error_m in errors_m.items() if 4700 < ms < 5000) < 0.2
    assert max(error_m for ms, error_m in errors_m.items() if ms > 6500) < 0.1


def test_a_measured_position_takes_its_constant_error_from_the_state() -> None:
    kalman = kalman_at(POS_UAV_M, 1.0)
    jacobian = np.zeros((3, SIZE))
    jacobian[:, UWB_BIAS] = (0.0, 0.0, -1.0)
    kalman.reset_rover_position(REL_M, 0.01 * np.eye(3), jacobian)
    std_bias_m = Tuning().std_uwb_bias_m
    assert kalman.pos_rel_m == pytest.approx(REL_M)
    assert kalman.var_pos_rel_m2 == pytest.approx((0.01, 0.01, 0.01 + std_bias_m**2))
    H: Array = np.zeros((1, SIZE))
    H[0, UWB_BIAS] = 1.0
    kalman.update(np.array([0.2]), H, np.array([[1e-9]]))  # now the bias is known: ranges are 20 cm too long
    assert kalman.pos_rel_m == pytest.approx(REL_M + np.array((0.0, 0.0, 0.2)), abs=1e-3)
    assert kalman.var_pos_rel_m2[2] == pytest.approx(0.01, abs=1e-4)


def test_tags_printed_a_fifth_too_small_are_found_out_where_the_height_is_known() -> None:
    kalman = kalman_at(POS_UAV_M, 0.01)
    tag = TagMeasurement(0, 1.2 * REL_M, 1.2 * REL_M, 1e-6 * np.eye(3), 0.0, None, 1.0)
    assert tag.fuse(kalman, (1e3, 1e3)).used == 3
    assert kalman.x[TAG_SCALE] == pytest.approx(0.2, abs=0.01)
    assert kalman.pos_rel_m == pytest.approx(REL_M, abs=0.05)


def test_a_compass_of_the_rover_with_an_error_is_corrected_by_the_heading_of_the_tag() -> None:
    kalman = kalman_at(POS_UAV_M, 0.1)
    for measurement in hovering(2.0):
        kalman.predict_to(measurement.t_ns)
        measurement.fuse(kalman, GATE)
        tag = TagMeasurement(measurement.t_ns, REL_M, REL_M, 1e-2 * np.eye(3), 0.0, YAW_RAD - 0.03, 0.01)
        tag.fuse(kalman, GATE)
    assert kalman.x[COMPASS_BIAS] > 0.005
