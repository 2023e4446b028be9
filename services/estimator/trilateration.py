"""Position of the UWB tag from ranges to anchors in a plane. Source: thesis §4.2.2, the position `norot_pos`."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jezero.base.frames import Vec3

ITERATIONS = 5
CONVERGED_M = 1e-6
"""Gauss–Newton stops at a step of this size: convergence is quadratic, so the remaining error is far smaller."""
ANCHORS_MIN = 3
INFORMATION_MIN = 1e-4
"""Information added on each axis, which keeps the variance finite when the geometry leaves an axis unobservable."""


def trilaterate(anchors_m: Sequence[Vec3], ranges_m: Sequence[float]) -> tuple[Vec3, NDArray[np.float64]] | None:
    """Position in the anchors' frame, above them, and its covariance for ranges of unit variance.

    Differences of squared ranges are linear in the horizontal position. The height follows from the residual, and
    Gauss–Newton steps refine the position by all ranges.

    Args:
        anchors_m: three or more, in a horizontal plane or nearly, z down.
    Returns:
        None when there are too few anchors, they are collinear, or the result is not finite.
    """
    anchors = _centered(tuple(anchors_m))
    if anchors is None:
        return None
    center, B, lengths_squared = anchors
    rho = np.array(ranges_m, dtype=float)
    squares = rho * rho - lengths_squared
    horizontal = np.linalg.lstsq(-2.0 * B[:, :2], squares - squares.mean(), rcond=None)[0]
    above = float(np.mean(squares + 2.0 * B[:, :2] @ horizontal) - horizontal @ horizontal)
    p = np.array([horizontal[0], horizontal[1], -np.sqrt(max(above, 1e-4))])
    J = B
    for _ in range(ITERATIONS):
        J = p - B
        lengths = np.maximum(np.sqrt((J * J).sum(axis=1)), 1e-6)
        J = J / lengths[:, None]
        step = np.linalg.lstsq(J, rho - lengths, rcond=None)[0]
        p = p + np.clip(step, -1.0, 1.0)
        p[2] = min(p[2], -1e-2)
        if np.abs(step).max() < CONVERGED_M:
            break
    covariance = np.linalg.inv(J.T @ J + INFORMATION_MIN * np.eye(3))
    if not (np.all(np.isfinite(p)) and np.all(np.isfinite(covariance))):
        return None
    x, y, z = (p + center).tolist()
    return (x, y, z), covariance


@lru_cache(maxsize=16)
def _centered(anchors_m: tuple[Vec3, ...]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]] | None:
    """Centroid of the anchors (3,), their positions relative to it (m, 3), and squared distances to it (m,)."""
    if len(anchors_m) < ANCHORS_MIN:
        return None
    A = np.array(anchors_m, dtype=float)
    center = A.mean(axis=0)
    B = A - center
    if np.linalg.matrix_rank(B[:, :2], tol=1e-3) < 2:
        return None
    return center, B, np.sum(B * B, axis=1)
