"""Distortion by a lens: the models of Brown and Conrady (plumb_bob, rational_polynomial) and of fisheye lenses
(equidistant), with the coefficients of OpenCV's calibration.

An aspect is the focal length down the image by that across it, of a camera whose pixels are no squares: points of the
image are at unit distance across, so that `focal_px * distort(points, distortion, aspect) + center_px` are pixels.
"""

from functools import cache
from math import inf, pi, sqrt, tan
from typing import Any

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.schemas.sensors import COEFFICIENTS, Distortion, shows_straight

ITERATIONS = 20
ITERATIONS_WIDE = 100
"""Number of iterations for models of wide lenses, whose image is much denser at its edge."""
NOT_FOUND_MIN = 1e-3
"""An iteration that is still this far from its point, at unit distance, has not found it."""
EDGE_MAX_RAD = 1.55
"""Angle from the optical axis beyond which a ray has no point at unit distance."""
Polynomial = np.polynomial.Polynomial


def distort(points: Array, distortion: Distortion, aspect: float = 1.0) -> Array:
    """Points of the image of an ideal lens, where a lens with distortion shows them.

    Args:
        points: (..., 2) right and down at unit distance.
        aspect: of the camera with the lens; the ideal one has square pixels.
    Returns:
        (..., 2); NaN beyond the radius at which the image folds back.
    Source: Brown 1966, and Kannala and Brandt 2006, as in OpenCV's `projectPoints` and `fisheye.projectPoints`.
    """
    if shows_straight(distortion):
        return points if aspect == 1.0 else points * (1.0, aspect)
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    if len(distortion) == COEFFICIENTS["equidistant"]:
        result: Array = points * _fisheye_scale(np.sqrt(r2), distortion)[..., None]
    else:
        _, _, p1, p2, *_ = distortion
        radial = _radial(r2, distortion)
        result = np.stack(
            (
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ),
            axis=-1,
        )
    result[r2 > fold_radius(distortion) ** 2] = np.nan
    return result if aspect == 1.0 else result * (1.0, aspect)


def undistort(points: Array, distortion: Distortion, aspect: float = 1.0) -> Array:
    """Points of the image of a lens with distortion, where an ideal lens shows them: the inverse of `distort`.

    Returns:
        (..., 2); NaN for points that the lens does not show.
    Source: fixed-point iteration, as in OpenCV's `undistortPoints`; Newton's for the angle of a fisheye lens.
    """
    if aspect != 1.0:
        points = points / (1.0, aspect)
    if shows_straight(distortion):
        return points
    if len(distortion) == COEFFICIENTS["equidistant"]:
        return _fisheye_undistort(points, distortion)
    ideal = points
    with np.errstate(over="ignore", invalid="ignore"):  # of points that the lens does not show
        for _ in range(ITERATIONS if len(distortion) == COEFFICIENTS["plumb_bob"] else ITERATIONS_WIDE):
            ideal = ideal + points - distort(ideal, distortion)
        missed = np.abs(points - distort(ideal, distortion)).max(axis=-1)
    result: Array = np.where(missed[..., None] < NOT_FOUND_MIN, ideal, np.nan)
    return result


def undistorted_picture(
    picture: npt.NDArray[np.uint8],
    focal_px: float,
    center_px: tuple[float, float],
    distortion: Distortion,
    aspect: float = 1.0,
) -> npt.NDArray[np.uint8]:
    """A picture as a pinhole with square pixels shows it: of the same size, focal length and principal point."""
    import cv2

    if shows_straight(distortion) and aspect == 1.0:
        return picture
    if len(distortion) == COEFFICIENTS["plumb_bob"] and aspect == 1.0:
        pinhole = np.array(((focal_px, 0.0, center_px[0]), (0.0, focal_px, center_px[1]), (0.0, 0.0, 1.0)))
        return np.asarray(cv2.undistort(picture, pinhole, np.array(distortion)), np.uint8)
    columns_px, rows_px = np.meshgrid(np.arange(picture.shape[1]), np.arange(picture.shape[0]))
    ideal = (np.stack((columns_px, rows_px), axis=-1) - np.array(center_px)) / focal_px
    from_px = (focal_px * distort(ideal, distortion, aspect) + np.array(center_px)).astype(np.float32)
    from_px = np.nan_to_num(from_px, nan=-1e4)
    return np.asarray(cv2.remap(picture, from_px[..., 0], from_px[..., 1], cv2.INTER_LINEAR), np.uint8)


@cache
def fold_radius(distortion: Distortion) -> float:
    """Radius in the image of an ideal lens beyond which the image of the lens folds back; infinite for most lenses."""
    if len(distortion) == COEFFICIENTS["equidistant"]:
        k1, k2, k3, k4 = distortion
        angle_rad = sqrt(_first_root(Polynomial((1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4))))
        return tan(angle_rad) if angle_rad < EDGE_MAX_RAD else inf
    k1, k2, _, _, k3, *over = distortion
    slope_by_r2 = Polynomial((1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3))
    if not over:
        return sqrt(_first_root(slope_by_r2))
    above, below = Polynomial((1.0, k1, k2, k3)), Polynomial((1.0, *over))
    slope = above * below + Polynomial((0.0, 2.0)) * (above.deriv() * below - above * below.deriv())
    return sqrt(min(_first_root(slope), _first_root(below)))


def image_radius(distortion: Distortion) -> float:
    """Greatest radius in the image of the lens, at unit distance, that shows something."""
    limit = fold_radius(distortion)
    if len(distortion) == COEFFICIENTS["equidistant"]:
        radius = tan(EDGE_MAX_RAD) if limit == inf else limit
        return float(radius * _fisheye_scale(np.array(radius), distortion))
    if limit == inf:
        return inf
    return float(limit * _radial(limit * limit, distortion))


def _first_root(polynomial: Any) -> float:
    """The smallest positive root, or infinity."""
    roots = [complex(root) for root in polynomial.trim().roots()]
    return min((root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0.0), default=inf)


def _radial(r2: Any, distortion: Distortion) -> Any:
    """Factor on the radius, from the square of the radius in the image of an ideal lens."""
    k1, k2, _, _, k3, *over = distortion
    factor = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if over:
        k4, k5, k6 = over
        factor = factor / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return factor


def _fisheye_scale(radius: Array, distortion: Distortion) -> Array:
    """Factor on the radius, from the radius in the image of an ideal lens."""
    angle_rad = np.arctan(radius)
    safe = np.where(radius > 1e-9, radius, 1.0)
    scale: Array = np.where(radius > 1e-9, _fisheye_radius(angle_rad, distortion) / safe, 1.0)
    return scale


def _fisheye_radius(angle_rad: Array, distortion: Distortion) -> Array:
    k1, k2, k3, k4 = distortion
    a2 = angle_rad * angle_rad
    radius: Array = angle_rad * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    return radius


def _fisheye_undistort(points: Array, distortion: Distortion) -> Array:
    k1, k2, k3, k4 = distortion
    radius = np.hypot(points[..., 0], points[..., 1])
    angle_rad = np.minimum(radius, 0.5 * pi)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of points that the lens does not show
        for _ in range(ITERATIONS):
            a2 = angle_rad * angle_rad
            slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
            angle_rad = np.clip(angle_rad - (_fisheye_radius(angle_rad, distortion) - radius) / slope, 0.0, 0.5 * pi)
        shown = np.abs(_fisheye_radius(angle_rad, distortion) - radius) < NOT_FOUND_MIN
        shown &= (angle_rad < EDGE_MAX_RAD) & (np.tan(angle_rad) <= fold_radius(distortion))
        scale = np.where(radius > 1e-9, np.tan(angle_rad) / np.where(radius > 1e-9, radius, 1.0), 1.0)
    result: Array = np.where(shown[..., None], points * scale[..., None], np.nan)
    return result
