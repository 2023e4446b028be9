"""The fit of a camera's intrinsics to views of the board."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from jezero.base.arrays import Array
from jezero.calibration.board import View
from jezero.calibration.intrinsics import CameraIntrinsics
from jezero.schemas.sensors import COEFFICIENTS, DistortionModel

VIEWS_MIN = 8


class FitError(ValueError):
    """The views do not determine a camera; the message says what to do."""


@dataclass(frozen=True)
class Fit:
    """A calibration.

    Attributes:
        intrinsics: of the camera.
        reprojection_px: RMS distance of the corners from where the model puts them.
        worst_px: the same of the worst view.
        std_focal_px: standard deviation of fx by the fit; NaN where the model gives none.
        views: number of views.
    """

    intrinsics: CameraIntrinsics
    reprojection_px: float
    worst_px: float
    std_focal_px: float
    views: int


def fit_camera(views: Sequence[View], size_px: tuple[int, int], model: DistortionModel = "plumb_bob") -> Fit:
    """Fit intrinsics by least squares of the corners' distances.

    Raises:
        FitError: there are too few views, or they contradict each other.
    """
    if len(views) < VIEWS_MIN:
        raise FitError(f"{len(views)} views of the board are too few, {VIEWS_MIN} are the least: take more pictures")
    try:
        found = _fit_fisheye(views, size_px) if model == "equidistant" else _fit_brown(views, size_px, model)
    except cv2.error as error:
        raise FitError(
            f"OpenCV finds no camera for these views: take pictures from more directions ({error.err})"
        ) from None
    matrix, coefficients, rms_px, per_view_px, std_px = found
    if not (np.isfinite(matrix).all() and np.isfinite(coefficients).all() and matrix[0, 0] > 0.0):
        raise FitError("these views determine no camera: take pictures with the board tilted to all sides")
    return Fit(
        CameraIntrinsics(
            size_px=size_px,
            focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
            center_px=(float(matrix[0, 2]), float(matrix[1, 2])),
            model=model,
            distortion=tuple(float(value) for value in coefficients[: COEFFICIENTS[model]]),
        ),
        reprojection_px=rms_px,
        worst_px=float(np.max(per_view_px)),
        std_focal_px=std_px,
        views=len(views),
    )


def _fit_brown(
    views: Sequence[View], size_px: tuple[int, int], model: DistortionModel
) -> tuple[Array, Array, float, Array, float]:
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational_polynomial" else 0
    objects = [view.object_m.astype(np.float32) for view in views]
    corners = [view.corners_px.astype(np.float32) for view in views]
    start, none = np.eye(3), np.zeros(8 if flags else 5)
    rms_px, matrix, coefficients, _, _, std, _, per_view_px = cv2.calibrateCameraExtended(
        objects, corners, size_px, start, none, flags=flags
    )
    return np.asarray(matrix), np.ravel(coefficients), float(rms_px), np.ravel(per_view_px), float(np.ravel(std)[0])


def _fit_fisheye(views: Sequence[View], size_px: tuple[int, int]) -> tuple[Array, Array, float, Array, float]:
    objects = [view.object_m.reshape(1, -1, 3) for view in views]
    corners = [view.corners_px.reshape(1, -1, 2) for view in views]
    home: Any = cv2 if hasattr(cv2, "CALIB_FIX_SKEW") else cv2.fisheye  # of OpenCV 5, and of 4
    flags = home.CALIB_RECOMPUTE_EXTRINSIC | home.CALIB_FIX_SKEW
    rms_px, matrix, coefficients, rotations, places = cv2.fisheye.calibrate(
        objects, corners, size_px, np.eye(3), np.zeros(4), flags=flags
    )
    per_view_px = []
    for points, seen, rotation, place in zip(objects, corners, rotations, places, strict=True):
        expected, _ = cv2.fisheye.projectPoints(points, rotation, place, matrix, coefficients)
        per_view_px.append(np.sqrt(np.mean(np.sum((expected - seen) ** 2, axis=-1))))
    return np.asarray(matrix), np.ravel(coefficients), float(rms_px), np.array(per_view_px), float("nan")
