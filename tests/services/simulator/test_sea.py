"""Waves under the rover: their height, period and tilt are those of the settings."""

from math import degrees, pi

import numpy as np
import pytest

from jezero.services.simulator.config import SeaConfig
from jezero.services.simulator.sea import make_sea

CONFIG = SeaConfig(wave_height_m=0.5, period_s=5.0, tilt_deg=5.0, from_deg=0.0)
TIMES_S = np.arange(0.0, 3000.0, 0.1)


def motions(config: SeaConfig, seed: int, yaw_rad: float = 0.0) -> np.ndarray:
    """(n, 3) heave, roll and pitch of a deck that stays at its place."""
    sea = make_sea(config, seed, 9.81)
    assert sea is not None
    return np.array([sea.motion(float(t_s), 0.0, 0.0, yaw_rad) for t_s in TIMES_S])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_significant_height_and_tilt_are_four_and_two_standard_deviations(seed: int) -> None:
    heave_m, roll_rad, pitch_rad = motions(CONFIG, seed).T
    assert 4.0 * heave_m.std() == pytest.approx(0.5, rel=0.05)
    assert heave_m.mean() == pytest.approx(0.0, abs=0.01)
    assert 2.0 * degrees(float(np.sqrt((roll_rad**2 + pitch_rad**2).mean()))) == pytest.approx(5.0, rel=0.05)


def test_the_highest_waves_have_the_period_of_the_settings() -> None:
    heave_m = motions(CONFIG, 4)[:, 0]
    power = np.abs(np.fft.rfft(heave_m)) ** 2
    frequencies_hz = np.fft.rfftfreq(len(heave_m), 0.1)
    assert 1.0 / float(frequencies_hz[power.argmax()]) == pytest.approx(5.0, rel=0.2)


def test_waves_from_ahead_pitch_the_rover_and_waves_from_the_side_roll_it() -> None:
    _, roll_rad, pitch_rad = motions(CONFIG, 5).T
    assert pitch_rad.std() > 1.5 * roll_rad.std()
    _, roll_rad, pitch_rad = motions(CONFIG, 5, yaw_rad=0.5 * pi).T
    assert roll_rad.std() > 1.5 * pitch_rad.std()


def test_a_bow_on_the_front_of_a_wave_points_up() -> None:
    """The water ahead is higher where the heave falls from ahead to behind, and pitch is positive nose up."""
    sea = make_sea(CONFIG, 6, 9.81)
    assert sea is not None
    rises, pitches = [], []
    for t_s in TIMES_S[:2000]:
        ahead, behind = (sea.motion(float(t_s), north_m, 0.0, 0.0) for north_m in (0.5, -0.5))
        rises.append(ahead.heave_m - behind.heave_m)
        pitches.append(sea.motion(float(t_s), 0.0, 0.0, 0.0).pitch_rad)
    assert np.corrcoef(rises, pitches)[0, 1] > 0.9


def test_a_seed_gives_one_sea_and_no_height_none() -> None:
    assert np.array_equal(motions(CONFIG, 7)[:100], motions(CONFIG, 7)[:100])
    assert not np.array_equal(motions(CONFIG, 7)[:100], motions(CONFIG, 8)[:100])
    assert make_sea(SeaConfig(), 7, 9.81) is None
