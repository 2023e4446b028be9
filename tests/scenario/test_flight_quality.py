"""The embedded autopilot in 3 m/s wind with gusts of 0.6 m/s, against the figures it must reach."""

import pytest

from benchmarks.quality.autopilot import hold, jump, track


@pytest.mark.long
@pytest.mark.parametrize("seed", [11, pytest.param(12, marks=pytest.mark.slow)])
def test_it_holds_its_position(seed: int) -> None:
    figures = hold(seed)
    assert figures.p95_m <= 0.15
    assert figures.wander_max_m < 1.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [11, pytest.param(12, marks=pytest.mark.slow)])
def test_it_tracks_velocity_setpoints(seed: int) -> None:
    figures = track(seed)
    assert figures.rms_mps <= 0.2
    assert figures.rise_s <= 1.5


def test_it_flies_to_a_far_setpoint_without_much_overshoot() -> None:
    assert jump(11) < 0.3
