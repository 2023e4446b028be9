"""Recordings without a valid estimate of the relative position, as those in which nothing took off."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from jezero.base.codec import encode
from jezero.cli.tune import _accuracy_text
from jezero.replay.through import Replay
from jezero.schemas.estimate import Relative
from jezero.schemas.topics import RELATIVE
from jezero.services.estimator.innovations import Innovation
from jezero.tuning import tuner
from jezero.tuning.observation import ObservedFlight
from jezero.tuning.sensors import SENSORS
from tests.tuning.rig import an_innovation

ESTIMATE = Relative(
    t_ns=0,
    epoch_id=1,
    valid=True,
    pos_uav_rel_rover_ned_m=(1.0, 2.0, -3.0),
    vel_uav_rel_rover_ned_mps=(0.0, 0.0, 0.0),
    vel_rover_ned_mps=(0.0, 0.0, 0.0),
    yaw_rover_rad=0.0,
    yaw_rate_rover_rps=0.0,
    use_uwb=True,
    use_tag=True,
    cov=(0.0,) * 21,
)
PATH = Path("flight.mcap")


def flight(*, valid: bool) -> ObservedFlight:
    """A flight whose altimeter is better than its setting says."""
    random = np.random.default_rng(1)
    readings: list[Innovation] = [an_innovation(i, [random.normal(0.0, 0.02)]) for i in range(400)]
    published = [(RELATIVE.name, encode(replace(ESTIMATE, valid=valid)))]
    return ObservedFlight(
        Replay("estimator", [], published=published), {**{each: [] for each in SENSORS}, "altimeter": readings}
    )


def tuned(monkeypatch: pytest.MonkeyPatch, *, valid_in_use: bool, valid_suggested: bool) -> Any:
    in_use = {PATH: flight(valid=valid_in_use)}
    monkeypatch.setattr(tuner, "_observe_all", lambda *given: (in_use, {}))
    monkeypatch.setattr(tuner, "observe", lambda *given: flight(valid=valid_suggested))
    return tuner.tune([PATH], {})


@pytest.mark.parametrize(("valid_in_use", "valid_suggested"), [(False, False), (True, False), (False, True)])
def test_nothing_is_recommended_without_a_valid_estimate(
    monkeypatch: pytest.MonkeyPatch, valid_in_use: bool, valid_suggested: bool
) -> None:
    result = tuned(monkeypatch, valid_in_use=valid_in_use, valid_suggested=valid_suggested)
    assert result.settings and result.recommended == {}
    assert _accuracy_text(result).startswith("no errors: no estimate of the relative position is valid")
    assert _accuracy_text(result).endswith("give a recording in which the vehicle flies near the rover")


def test_nothing_is_recommended_from_a_truth_without_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    times = (np.array([1.0]), np.zeros((1, 3)))
    monkeypatch.setattr(tuner, "true_relative", lambda files: times)
    result = tuned(monkeypatch, valid_in_use=True, valid_suggested=True)
    assert result.settings and result.recommended == {} and not result.judged


def test_what_is_consistent_is_recommended_where_valid_estimates_have_no_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    result = tuned(monkeypatch, valid_in_use=True, valid_suggested=True)
    assert result.settings and result.recommended == result.settings
    assert _accuracy_text(result).startswith("no errors: the recordings have no truth")
