"""Waves under the rover: a deck of a boat that heaves, rolls and pitches.

The heave is a sum of long-crested waves whose energies follow the JONSWAP spectrum, each with a direction near the main
one. The deck leans with the slope of the waves, scaled to the tilt of the settings: how much of the slope a hull
follows depends on its size.

Source: Hasselmann et al. 1973, "Measurements of wind-wave growth and swell decay during the Joint North Sea Wave
Project"; waves on deep water, omega^2 = g k.
"""

from math import cos, exp, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np

from jezero.services.simulator.config import SeaConfig
from jezero.services.simulator.noise import generator

WAVES = 14
LOWEST, HIGHEST = 0.6, 2.2
"""Range of the waves' frequencies, relative to that of the peak."""
PEAK_ENHANCEMENT = 3.3
SPREAD_RAD = radians(25.0)
"""Standard deviation of the waves' directions around the main one."""


class WaveMotion(NamedTuple):
    """What the waves do to a rover that floats.

    Attributes:
        heave_m: height of the water at the rover over its level, positive up.
        roll_rad: angle about the rover's forward axis.
        pitch_rad: angle about the rover's right axis.
    """

    heave_m: float
    roll_rad: float
    pitch_rad: float


class _Wave(NamedTuple):
    amplitude_m: float
    tilt_rad: float
    omega_rps: float
    phase_rad: float
    north: float
    east: float
    number_1pm: float


class Sea:
    """The waves of one run.

    Args:
        rng: draws the waves' frequencies, phases and directions.
        gravity_mps2: gravitational acceleration, which gives the waves' lengths.
    """

    def __init__(self, config: SeaConfig, rng: np.random.Generator, gravity_mps2: float) -> None:
        self._waves = _draw_waves(config, rng, gravity_mps2)

    def motion(self, t_s: float, north_m: float, east_m: float, yaw_rad: float) -> WaveMotion:
        """Motion of a deck at a place of the map at a time.

        Args:
            yaw_rad: heading of the rover, clockwise from north.
        """
        heave_m = tilt_north_rad = tilt_east_rad = 0.0
        for wave in self._waves:
            along_m = wave.north * north_m + wave.east * east_m
            angle_rad = wave.omega_rps * t_s - wave.number_1pm * along_m + wave.phase_rad
            heave_m += wave.amplitude_m * cos(angle_rad)
            rise_rad = wave.tilt_rad * sin(angle_rad)
            tilt_north_rad += rise_rad * wave.north
            tilt_east_rad += rise_rad * wave.east
        c, s = cos(yaw_rad), sin(yaw_rad)
        pitch_rad = c * tilt_north_rad + s * tilt_east_rad
        return WaveMotion(heave_m, -(c * tilt_east_rad - s * tilt_north_rad), pitch_rad)


def make_sea(config: SeaConfig, seed: int, gravity_mps2: float) -> Sea | None:
    """The sea that belongs to the settings and a seed; None without waves."""
    if config.wave_height_m == 0.0:
        return None
    return Sea(config, generator(seed, "sea"), gravity_mps2)


def _draw_waves(config: SeaConfig, rng: np.random.Generator, gravity_mps2: float) -> list[_Wave]:
    peak_rps = 2.0 * pi / config.period_s
    edges = np.linspace(LOWEST, HIGHEST, WAVES + 1)
    ratios = rng.uniform(edges[:-1], edges[1:])
    energies = np.array([_jonswap(float(ratio)) for ratio in ratios])
    amplitudes_m = np.sqrt(2.0 * energies / energies.sum()) * config.wave_height_m / 4.0
    slopes = amplitudes_m * np.square(ratios)
    tilts_rad = slopes * radians(config.tilt_deg) / 2.0 / sqrt(0.5 * float(np.square(slopes).sum()))
    directions_rad = radians(config.from_deg) + pi + SPREAD_RAD * rng.standard_normal(WAVES)
    phases_rad = rng.uniform(0.0, 2.0 * pi, WAVES)
    return [
        _Wave(
            float(amplitude_m),
            float(tilt_rad),
            float(ratio) * peak_rps,
            float(phase_rad),
            cos(direction_rad),
            sin(direction_rad),
            (float(ratio) * peak_rps) ** 2 / gravity_mps2,
        )
        for amplitude_m, tilt_rad, ratio, phase_rad, direction_rad in zip(
            amplitudes_m, tilts_rad, ratios, phases_rad, directions_rad, strict=True
        )
    ]


def _jonswap(ratio: float) -> float:
    """Relative energy of a wave whose frequency is `ratio` times that of the peak."""
    width = 0.07 if ratio <= 1.0 else 0.09
    enhancement: float = PEAK_ENHANCEMENT ** exp(-((ratio - 1.0) ** 2) / (2.0 * width**2))
    energy: float = ratio**-5.0 * exp(-1.25 * ratio**-4.0) * enhancement
    return energy
