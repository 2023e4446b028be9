"""Distortion by a lens, against OpenCV's."""

import cv2
import numpy as np
import pytest

from jezero.base.lens import distort, fold_radius, undistort
from jezero.base.vehicle_config import CameraMountConfig
from jezero.schemas.sensors import NO_DISTORTION, Distortion

BARREL: Distortion = (-0.28, 0.08, 0.001, -0.002, -0.01)
PINCUSHION: Distortion = (0.12, 0.02, 0.0, 0.003, 0.0)
POINTS = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.6, 0.6, 7)), axis=-1)


@pytest.mark.parametrize("distortion", [NO_DISTORTION, BARREL, PINCUSHION])
def test_a_point_goes_where_opencv_puts_it(distortion: Distortion) -> None:
    rays = np.concatenate((POINTS, np.ones((*POINTS.shape[:2], 1))), axis=-1).reshape(-1, 3)
    zero = np.zeros(3)
    expected, _ = cv2.projectPoints(rays, zero, zero, np.eye(3), np.array(distortion))
    assert distort(POINTS, distortion).reshape(-1, 2) == pytest.approx(expected.reshape(-1, 2), abs=1e-12)


@pytest.mark.parametrize("distortion", [NO_DISTORTION, BARREL, PINCUSHION])
def test_undistort_is_the_inverse(distortion: Distortion) -> None:
    assert undistort(distort(POINTS, distortion), distortion) == pytest.approx(POINTS, abs=1e-5)


def test_a_point_beyond_the_fold_is_nowhere() -> None:
    radius = fold_radius((-0.3, 0.0, 0.0, 0.0, 0.0))
    assert radius == pytest.approx((1.0 / 0.9) ** 0.5)  # 1 + 3 k1 r^2 = 0
    assert np.isnan(distort(np.array(((radius + 0.05, 0.0),)), (-0.3, 0.0, 0.0, 0.0, 0.0))).all()


def test_a_point_that_the_lens_does_not_show_has_no_ideal_place() -> None:
    assert np.isnan(undistort(np.array(((5.0, 0.0),)), BARREL)).all()


def test_a_lens_that_folds_its_own_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="check the order k1, k2, p1, p2, k3"):
        CameraMountConfig(field_of_view_deg=120.0, distortion=(-0.5, 0.0, 0.0, 0.0, 0.0))
