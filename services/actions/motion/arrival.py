"""Decides when the vehicle has arrived at a point: every "reached" of an action."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from jezero.base.frames import Vec3, add, norm, scale
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.config import MoveConfig

HOVER_S = 4.0
"""A vehicle that has hovered about the point for this time has arrived, too: in wind it never comes to rest."""
SAMPLE_NS = 100_000_000
CALM_MPS = 6.0
"""In a stronger wind, gusts included, the limits of a hover that counts as an arrival grow in proportion to it."""
SHRINKS_M = 0.05
"""The vehicle still comes nearer, and has not arrived, when its mean distance shrinks by more than this from the first
half of the hover to the second."""


class _Sample(NamedTuple):
    t_ns: int
    error_ned_m: Vec3
    speed_mps: float


class ArrivalDetector:
    """Detects the arrival at a point, by one of two signs.

    - The vehicle has been near the point, and slow, for a moment.
    - It has hovered about the point for longer, as well as the wind allows: its mean position is near the point, it
      gets no nearer, and it was never far or fast.

    Args:
        settle_s: time for which the vehicle must be near and slow.
    """

    def __init__(self, config: MoveConfig, settle_s: float) -> None:
        self._config = config
        self._settle_s = settle_s
        self._settled_ns: int | None = None
        self._samples: deque[_Sample] = deque()

    def update(
        self, t_ns: int, error_ned_m: Vec3, vel_ned_mps: Vec3, *, turned: bool = True, wind_mps: float = 0.0
    ) -> bool:
        """Add the newest state; returns whether the vehicle has arrived.

        Args:
            error_ned_m: vector from the vehicle to the point.
            vel_ned_mps: velocity relative to the point.
            turned: whether the vehicle has the heading that it must arrive with.
            wind_mps: speed of the wind in its gusts, 0 while it is unknown.
        """
        config, speed_mps = self._config, norm(vel_ned_mps)
        near = norm(error_ned_m) < config.reached_m and speed_mps < config.reached_mps
        if not (near and turned):
            self._settled_ns = None
        elif self._settled_ns is None:
            self._settled_ns = t_ns
        settled = self._settled_ns is not None and t_ns - self._settled_ns >= self._settle_s * NS_PER_S
        factor = max(1.0, wind_mps / CALM_MPS)
        return settled or (self._hovers(_Sample(t_ns, error_ned_m, speed_mps), factor) and turned)

    def _hovers(self, newest: _Sample, factor: float) -> bool:
        """Whether the vehicle hovers about the point as well as the wind allows.

        Args:
            factor: by which the wind widens the limits.
        """
        config, samples = self._config, self._samples
        far = norm(newest.error_ned_m) > factor * config.reached_in_wind_m
        if far or newest.speed_mps > factor * config.reached_in_wind_mps:
            samples.clear()
            return False
        if not samples or newest.t_ns - samples[-1].t_ns >= SAMPLE_NS:
            samples.append(newest)
        oldest_ns = newest.t_ns - int(HOVER_S * NS_PER_S)
        if samples[0].t_ns > oldest_ns:
            return False
        while samples[0].t_ns < oldest_ns - SAMPLE_NS:
            samples.popleft()
        errors_m = [sample.error_ned_m for sample in samples]
        half = len(errors_m) // 2
        nearer_m = _mean_length(errors_m[:half]) - _mean_length(errors_m[half:])
        return nearer_m < SHRINKS_M and norm(_mean(errors_m)) < factor * 2.0 * config.reached_m


def _mean(vectors: Sequence[Vec3]) -> Vec3:
    total: Vec3 = (0.0, 0.0, 0.0)
    for vector in vectors:
        total = add(total, vector)
    return scale(total, 1.0 / max(len(vectors), 1))


def _mean_length(vectors: Sequence[Vec3]) -> float:
    return sum(norm(vector) for vector in vectors) / max(len(vectors), 1)
