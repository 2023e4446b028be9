"""Model of the ground from the altimeter's spots: a plane, and deviations from it near the spots."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jezero.base.arrays import Array

Singles = NDArray[np.float32]
REACH_M = 2.5
"""Correlation length of the deviations."""
STD_GROUND_M = 0.15
STD_SPOT_M = 0.05
"""Standard deviation of a spot: of the range, and of the drift of the vehicle's height."""
OUTLIER_M = 0.3
BLOCK = 1024
SLOPE_SPREAD_M = 0.5
"""With a smaller spread of the spots in any direction no slope is estimated."""


@dataclass(frozen=True)
class MapGround:
    """Height of the ground as a function of the place.

    Attributes:
        plane: (3,) down coordinate at the middle, and the slopes to the north and to the east.
        middle_m: (2,) north and east of the spots' mean.
        spots_m: (m, 2) north and east of the spots.
        weights_m: (m,) weights of the deviations around each spot.
    """

    plane: Array
    middle_m: Array
    spots_m: Array
    weights_m: Array

    def down_m(self, points_m: Array) -> Array:
        """(k,) down coordinates of the ground at (k, 2) places, north and east."""
        away = points_m - self.middle_m
        level = self.plane[0] + away @ self.plane[1:]
        if len(self.spots_m) == 0:
            return np.asarray(level)
        # Floats of 32 bits are exact to the micrometre here. Large blocks would leave the processor's cache.
        near, weights_m = away.astype(np.float32), self.weights_m.astype(np.float32)
        spots_m = (self.spots_m - self.middle_m).astype(np.float32)
        for start in range(0, len(near), BLOCK):
            level[start : start + BLOCK] += _kernel(near[start : start + BLOCK], spots_m) @ weights_m
        return np.asarray(level)

    def met(self, from_m: Array, along: Array) -> Array:
        """(k, 3) points at which rays meet the ground; NaN for rays that do not point down.

        Args:
            from_m: (k, 3) or (3,) origins.
            along: (k, 3) directions.
        """
        origins = np.broadcast_to(from_m, along.shape)
        steep = np.where(along[:, 2] > 0.05, along[:, 2], np.nan)
        down_m = np.full(len(along), self.plane[0])
        for _ in range(4):
            points_m = origins + along * ((down_m - origins[:, 2]) / steep)[:, None]
            down_m = self.down_m(np.nan_to_num(points_m[:, :2]))
        return np.asarray(points_m)


def fit_ground(spots_m: Array) -> MapGround:
    """Fit the ground to (m, 3) spots at which the altimeter's beam met it.

    Outliers, such as spots on the rover's platform, are left out.
    """
    level_m = np.quantile(spots_m[:, 2], 0.5, method="lower")  # an element of the spots, so that at least one is kept
    kept = spots_m[np.abs(spots_m[:, 2] - level_m) < 1.0]
    for _ in range(3):
        middle_m, plane = _plane(kept)
        rest_m = kept[:, 2] - plane[0] - (kept[:, :2] - middle_m) @ plane[1:]
        good = np.abs(rest_m - np.median(rest_m)) < max(OUTLIER_M, 3.0 * float(np.median(np.abs(rest_m))))
        if good.all():
            break
        kept, rest_m = kept[good], rest_m[good]
    covariance = _kernel(kept[:, :2], kept[:, :2]) + STD_SPOT_M**2 * np.eye(len(kept))
    return MapGround(plane, middle_m, kept[:, :2], np.linalg.solve(covariance, rest_m))


def _plane(spots_m: Array) -> tuple[Array, Array]:
    """Mean of the spots, and the plane through them; a level plane if their spread is small."""
    middle_m = spots_m[:, :2].mean(axis=0)
    away = spots_m[:, :2] - middle_m
    spread_m = np.linalg.svd(away, compute_uv=False)[-1] / np.sqrt(len(spots_m)) if len(spots_m) > 2 else 0.0
    if spread_m < SLOPE_SPREAD_M:
        return middle_m, np.array((float(np.median(spots_m[:, 2])), 0.0, 0.0))
    basis = np.column_stack((np.ones(len(away)), away))
    return middle_m, np.linalg.lstsq(basis, spots_m[:, 2], rcond=None)[0]


def _kernel(a_m: Array | Singles, b_m: Array | Singles) -> Array:
    away_m2 = np.subtract.outer(a_m[:, 0], b_m[:, 0]) ** 2 + np.subtract.outer(a_m[:, 1], b_m[:, 1]) ** 2
    return np.asarray(STD_GROUND_M**2 * np.exp(away_m2 * (-0.5 / REACH_M**2)))
