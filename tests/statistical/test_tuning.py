"""`jezero tune` finds the noise of the sensors from three flights, also where the estimator's settings are far off.

What is right: for UWB and altimeter the standard deviation of the simulator's white noise, to which their slowly
varying errors add little. For the tag, whose noise in the simulator is too small to be seen, the flights add noise with
the covariance that the estimator assumes for the setting 1, so that 1 is right.
"""

from collections.abc import Iterator
from math import sqrt
from pathlib import Path

import msgspec
import numpy as np
import pytest

from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Inbox, Output, Publish
from jezero.schemas import topics
from jezero.schemas.estimate import TagEstimate
from jezero.services.estimator.measurements import TagMeasurement
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.service import TagDetector
from jezero.services.simulator.config import SimulatorConfig
from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions, RoverName
from jezero.tuning.tuner import TuningResult, tune

FLIGHTS: tuple[tuple[int, RoverName], ...] = ((1, "still"), (2, "drive"), (3, "zigzag"))
"""Seed, which gives the height and the place of the rover, and motion of the rover."""
RIGHT = {
    "std_uwb_m": SimulatorConfig().uwb.std_m,
    "scale_std_tag": 1.0,
    "std_altimeter_m": SimulatorConfig().altimeter.std_m,
}
TOLERANCE = 0.3
R_FACTOR = sqrt(10.0)
"""Of a standard deviation whose square, the variance R, is ten times wrong."""
pytestmark = [pytest.mark.timeout(600), pytest.mark.xdist_group("tuning")]


class NoisyTagDetector(TagDetector):
    """The tag detector with white noise of the covariance that the estimator assumes for `scale_std_tag = 1`."""

    def __init__(self, config: TagDetectorConfig, vehicle: VehicleConfig) -> None:
        super().__init__(config, vehicle)
        self._rng = np.random.default_rng(1)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for output in super().step(t_ns, inbox):
            if isinstance(output, Publish) and isinstance(output.message, TagEstimate):
                yield Publish(topics.ESTIMATE_TAG, self._noisy(output.message))
            else:
                yield output

    def _noisy(self, tag: TagEstimate) -> TagEstimate:
        arm_m = np.array(tag.pos_uav_rel_rover_ned_m)
        cov_m2 = np.zeros((3, 3))
        cov_m2[np.triu_indices(3)] = tag.cov_pos_ned_m2
        cov_m2 += np.triu(cov_m2, 1).T
        measurement = TagMeasurement(tag.t_ns, arm_m, arm_m, cov_m2, 0.0, None, 1.0)
        noisy_m = self._rng.multivariate_normal(arm_m, measurement.measurement_cov_m2())
        return msgspec.structs.replace(tag, pos_uav_rel_rover_ned_m=tuple(noisy_m.tolist()))


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("flights")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jezero.services.estimator.tag_detector.service.TagDetector", NoisyTagDetector)
        for seed, rover in FLIGHTS:
            assert not fly_landing(seed, Conditions(case="uwb+tag", rover=rover), folder).failure
    return sorted(folder.glob("*/*.mcap"))


def assert_right(result: TuningResult) -> None:
    assert result.converged
    for setting, value in RIGHT.items():
        assert result.settings[setting] == pytest.approx(value, rel=TOLERANCE), setting


@pytest.mark.parametrize("factor", [10.0, pytest.param(0.1, marks=pytest.mark.slow)])
def test_standard_deviations_that_are_all_ten_times_wrong_are_named(factor: float, flights: list[Path]) -> None:
    result = tune(flights, {setting: f"{factor * value:g}" for setting, value in RIGHT.items()})
    assert_right(result)
    assert result.accuracy is not None
    assert result.accuracy.rms_suggested_m < 1.05 * result.accuracy.rms_in_use_m


@pytest.mark.slow
@pytest.mark.parametrize("setting", RIGHT)
@pytest.mark.parametrize("factor", [R_FACTOR, 1.0 / R_FACTOR])
def test_one_variance_that_is_ten_times_wrong_is_named(setting: str, factor: float, flights: list[Path]) -> None:
    assert_right(tune(flights, {**{name: f"{value:g}" for name, value in RIGHT.items()},
                                setting: f"{factor * RIGHT[setting]:.4g}"}))  # fmt: skip


@pytest.mark.slow
def test_the_suggestion_does_not_depend_on_the_settings_in_use(flights: list[Path]) -> None:
    result = tune(flights, {})
    assert_right(result)
    wrong = tune(flights, {setting: f"{10.0 * value:g}" for setting, value in RIGHT.items()}).settings
    for setting in RIGHT:
        assert wrong[setting] == pytest.approx(result.settings[setting], rel=0.05), setting
