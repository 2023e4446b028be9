"""Distortion by a lens: the model of Brown and Conrady, with the coefficients of OpenCV's calibration."""

from functools import cache
from math import inf, sqrt
from typing import Any

import numpy as np

from jezero.base.arrays import Array
from jezero.schemas.sensors import Distortion

ITERATIONS = 20
NOT_FOUND_MIN = 1e-3
"""An iteration that is still this far from its point, at unit distance, has not found it."""


def distort(points: Array, distortion: Distortion) -> Array:
    """Points of the image of an ideal lens, where a lens with distortion shows them.

    Args:
        points: (..., 2) right and down at unit distance.
    Returns:
        (..., 2); NaN beyond the radius at which the image folds back.
    Source: Brown 1966, as in OpenCV's `projectPoints`.
    """
    if not any(distortion):
        return points
    _, _, p1, p2, _ = distortion
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = _radial(r2, distortion)
    result: Array = np.stack(
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ),
        axis=-1,
    )
    result[r2 > fold_radius(distortion) ** 2] = np.nan
    return result


def undistort(points: Array, distortion: Distortion) -> Array:
    """Points of the image of a lens with distortion, where an ideal lens shows them: the inverse of `distort`.

    Returns:
        (..., 2); NaN for points that the lens does not show.
    Source: fixed-point iteration, as in OpenCV's `undistortPoints`.
    """
    if not any(distortion):
        return points
    ideal = points
    with np.errstate(over="ignore", invalid="ignore"):  # of points that the lens does not show
        for _ in range(ITERATIONS):
            ideal = ideal + points - distort(ideal, distortion)
        missed = np.abs(points - distort(ideal, distortion)).max(axis=-1)
    result: Array = np.where(missed[..., None] < NOT_FOUND_MIN, ideal, np.nan)
    return result


@cache
def fold_radius(distortion: Distortion) -> float:
    """Radius in the image of an ideal lens beyond which the image of the lens folds back; infinite for most lenses."""
    k1, k2, _, _, k3 = distortion
    slope_by_r2 = np.polynomial.Polynomial((1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3)).trim()
    roots = [complex(root) for root in slope_by_r2.roots()]
    return min((sqrt(root.real) for root in roots if abs(root.imag) < 1e-9 and root.real > 0.0), default=inf)


def image_radius(distortion: Distortion) -> float:
    """Greatest radius in the image of the lens, at unit distance, that shows something."""
    limit = fold_radius(distortion)
    return inf if limit == inf else float(limit * _radial(limit * limit, distortion))


def _radial(r2: Any, distortion: Distortion) -> Any:
    """Factor on the radius, from the square of the radius in the image of an ideal lens."""
    k1, k2, _, _, k3 = distortion
    return 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
