"""Where the UWB tag is, from ranges to anchors that lie in a plane. Source: thesis §4.2.2, the position `norot_pos`."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jezero.frames import Vec3

ITERATIONS = 5
CONVERGED_M = 1e-6
"""A Gauss–Newton step so small leaves an error far smaller still."""
ANCHORS_MIN = 3
WEAKEST = 1e-4
"""Information on each axis that keeps the variance finite where the geometry gives none."""


def trilaterate(anchors_m: Sequence[Vec3], ranges_m: Sequence[float]) -> tuple[Vec3, NDArray[np.float64]] | None:
    """Position in the anchors' frame, above them, and its covariance for ranges of unit variance.

    Differences of squared ranges are linear in the horizontal position; the height follows from what is left of the
    ranges, and Gauss–Newton steps weigh them all.

    Args:
        anchors_m: three or more, in a horizontal plane or nearly, z down.
    Returns:
        None when the anchors are too few or in a line, or the result isn't finite.
    """
    anchors = _about_their_center(tuple(anchors_m))
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
    covariance = np.linalg.inv(J.T @ J + WEAKEST * np.eye(3))
    if not (np.all(np.isfinite(p)) and np.all(np.isfinite(covariance))):
        return None
    x, y, z = (p + center).tolist()
    return (x, y, z), covariance


@lru_cache(maxsize=16)
def _about_their_center(anchors_m: tuple[Vec3, ...]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]] | None:
    """The anchors' centre (3,), the anchors seen from it (m, 3), and their squared distances to it (m,)."""
    if len(anchors_m) < ANCHORS_MIN:
        return None
    A = np.array(anchors_m, dtype=float)
    center = A.mean(axis=0)
    B = A - center
    if np.linalg.matrix_rank(B[:, :2], tol=1e-3) < 2:
        return None
    return center, B, np.sum(B * B, axis=1)
