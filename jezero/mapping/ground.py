"""The shape of the ground from the altimeter's spots: a level, a slope, and what departs from them nearby."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
REACH_M = 2.5
"""Over which distance the ground resembles itself."""
STD_GROUND_M = 0.15
STD_SPOT_M = 0.05
"""Of the range, and of what the vehicle's height wanders between two spots."""
OUTLIER_M = 0.3
SLOPE_SPREAD_M = 0.5
"""Spots that spread less across some direction tell no slope along it."""


@dataclass(frozen=True)
class Ground:
    """Its height as a function of the place.

    Attributes:
        plane: (3,) down at the middle, and its slopes to the north and to the east.
        middle_m, spots_m: (2,) and (m, 2).
        weights_m: (m,) of the departures around each spot.
    """

    plane: Array
    middle_m: Array
    spots_m: Array
    weights_m: Array

    def down_m(self, points_m: Array) -> Array:
        """(k,) at places (k, 2)."""
        away = points_m - self.middle_m
        level = self.plane[0] + away @ self.plane[1:]
        if len(self.spots_m) == 0:
            return np.asarray(level)
        return np.asarray(level + _kernel(points_m, self.spots_m) @ self.weights_m)

    def met(self, from_m: Array, along: Array) -> Array:
        """(k, 3) where rays meet the ground; rays that don't look down give NaN.

        Args:
            from_m, along: (k, 3) or (3,) origins, and (k, 3) directions.
        """
        origins = np.broadcast_to(from_m, along.shape)
        steep = np.where(along[:, 2] > 0.05, along[:, 2], np.nan)
        down_m = np.full(len(along), self.plane[0])
        for _ in range(4):
            points_m = origins + along * ((down_m - origins[:, 2]) / steep)[:, None]
            down_m = self.down_m(np.nan_to_num(points_m[:, :2]))
        return np.asarray(points_m)


def fit_ground(spots_m: Array) -> Ground:
    """From where the beam met it, (m, 3).

    Spots that stand out, such as those on the rover's platform, are left out.
    """
    level_m = np.quantile(spots_m[:, 2], 0.5, method="lower")  # one of them: some spot is always near it
    kept = spots_m[np.abs(spots_m[:, 2] - level_m) < 1.0]
    for _ in range(3):
        middle_m, plane = _plane(kept)
        rest_m = kept[:, 2] - plane[0] - (kept[:, :2] - middle_m) @ plane[1:]
        good = np.abs(rest_m - np.median(rest_m)) < max(OUTLIER_M, 3.0 * float(np.median(np.abs(rest_m))))
        if good.all():
            break
        kept, rest_m = kept[good], rest_m[good]
    covariance = _kernel(kept[:, :2], kept[:, :2]) + STD_SPOT_M**2 * np.eye(len(kept))
    return Ground(plane, middle_m, kept[:, :2], np.linalg.solve(covariance, rest_m))


def _plane(spots_m: Array) -> tuple[Array, Array]:
    """Middle, and level and slopes of the plane through the spots; level where they tell no slope."""
    middle_m = spots_m[:, :2].mean(axis=0)
    away = spots_m[:, :2] - middle_m
    spread_m = np.linalg.svd(away, compute_uv=False)[-1] / np.sqrt(len(spots_m)) if len(spots_m) > 2 else 0.0
    if spread_m < SLOPE_SPREAD_M:
        return middle_m, np.array((float(np.median(spots_m[:, 2])), 0.0, 0.0))
    basis = np.column_stack((np.ones(len(away)), away))
    return middle_m, np.linalg.lstsq(basis, spots_m[:, 2], rcond=None)[0]


def _kernel(a_m: Array, b_m: Array) -> Array:
    away_m2 = ((a_m[:, None, :] - b_m[None, :, :]) ** 2).sum(axis=2)
    return np.asarray(STD_GROUND_M**2 * np.exp(-0.5 * away_m2 / REACH_M**2))
