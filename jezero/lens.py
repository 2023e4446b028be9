"""Distortion by a lens: Brown–Conrady, with the coefficients (k1, k2, p1, p2, k3) that OpenCV's calibration gives."""

from math import inf

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Distortion = tuple[float, float, float, float, float]
NO_DISTORTION: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
ITERATIONS = 12
RADIUS_STEP = 0.01
RADIUS_END = 20.0


def distort(points: Array, distortion: Distortion) -> Array:
    """Where a lens puts points of the ideal image.

    Args:
        points: (..., 2) right and down at unit distance.
    Returns:
        (..., 2); NaN beyond the radius from which the image would fold back.
    Source: Brown 1966, as in OpenCV's `projectPoints`.
    """
    if not any(distortion):
        return points
    k1, k2, p1, p2, k3 = distortion
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
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
    """Points of the ideal image that a lens puts to (..., 2) these, by fixed-point iteration; NaN where none is."""
    if not any(distortion):
        return points
    ideal = points
    for _ in range(ITERATIONS):
        ideal = ideal + points - distort(ideal, distortion)
    return ideal


def fold_radius(distortion: Distortion) -> float:
    """Radius in the ideal image, at unit distance, up to which a greater radius stays greater behind the lens."""
    k1, k2, _, _, k3 = distortion
    radius = RADIUS_STEP
    while radius < RADIUS_END:
        r2 = radius * radius
        if 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3)) <= 0.0:
            return radius - RADIUS_STEP
        radius += RADIUS_STEP
    return inf
