"""Distortion by a lens, against OpenCV's."""

from typing import Any

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from jezero.base.lens import distort, fold_radius, undistort, undistorted_picture
from jezero.base.vehicle_config import CameraMountConfig
from jezero.schemas.sensors import NO_DISTORTION, CameraInfo, Distortion

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


RATIONAL = (0.5, -0.1, 0.0005, -0.0004, 0.002, 0.9, 0.05, -0.01)
FISHEYE = (-0.03, 0.01, -0.005, 0.001)
WIDE = np.array([(x, y) for x in (-2.0, -0.7, 0.0, 0.4, 1.5) for y in (-1.2, 0.0, 0.3, 1.0)])


def test_a_rational_lens_is_opencvs_and_is_undone() -> None:
    rays = np.column_stack((POINTS.reshape(-1, 2), np.ones(POINTS.size // 2)))
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(RATIONAL))
    assert distort(POINTS, RATIONAL).reshape(-1, 2) == pytest.approx(expected.reshape(-1, 2), abs=1e-12)
    assert undistort(distort(POINTS, RATIONAL), RATIONAL) == pytest.approx(POINTS, abs=1e-4)


def test_an_equidistant_lens_is_opencvs_fisheye_and_is_undone() -> None:
    rays = np.column_stack((WIDE, np.ones(len(WIDE)))).reshape(-1, 1, 3)
    expected, _ = cv2.fisheye.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(FISHEYE))
    assert distort(WIDE, FISHEYE) == pytest.approx(expected.reshape(-1, 2), abs=1e-9)
    assert undistort(distort(WIDE, FISHEYE), FISHEYE) == pytest.approx(WIDE, abs=1e-6)


def test_an_equidistant_lens_without_coefficients_is_no_pinhole() -> None:
    point = np.array(((1.0, 0.0),))  # 45 degrees from the axis
    assert distort(point, (0.0, 0.0, 0.0, 0.0)) == pytest.approx(np.array(((np.pi / 4, 0.0),)))


@pytest.mark.parametrize("distortion", [NO_DISTORTION, BARREL, RATIONAL, FISHEYE])
def test_an_aspect_scales_the_image_down_and_is_undone(distortion: Distortion) -> None:
    seen = distort(WIDE * 0.3, distortion, 1.1)
    assert seen == pytest.approx(distort(WIDE * 0.3, distortion) * (1.0, 1.1))
    assert undistort(seen, distortion, 1.1) == pytest.approx(WIDE * 0.3, abs=1e-5)


@pytest.mark.parametrize("distortion", [BARREL, RATIONAL, FISHEYE])
def test_a_picture_without_distortion_is_that_of_an_ideal_lens(distortion: Distortion) -> None:
    focal_px, center_px, aspect = 200.0, (150.0, 125.0), 1.05
    columns, rows = np.meshgrid(np.arange(320), np.arange(240))
    seen: Any = (np.stack((columns, rows), axis=-1) - center_px) / focal_px
    ideal = undistort(seen, distortion, aspect)

    def pattern(x: Any, y: Any) -> npt.NDArray[np.uint8]:
        shade = 128.0 + 60.0 * np.sin(5.0 * np.nan_to_num(x)) + 60.0 * np.cos(5.0 * np.nan_to_num(y))
        return np.repeat(np.clip(shade, 0, 255).astype(np.uint8)[..., None], 3, axis=2)

    lens = pattern(ideal[..., 0], ideal[..., 1])
    expected = pattern((columns - center_px[0]) / focal_px, (rows - center_px[1]) / focal_px)
    found = undistorted_picture(lens, focal_px, center_px, distortion, aspect)
    middle = (slice(60, 180), slice(80, 240))
    assert np.abs(found[middle].astype(int) - expected[middle]).max() <= 3


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"fx_px": 400.0}, "give all four, or none"),
        ({"distortion": (0.1, 0.0, 0.0, 0.0)}, "plumb_bob has 5 coefficients, not 4"),
        ({"distortion_model": "equidistant"}, "equidistant has 4 coefficients, not 5"),
        ({"distortion": (5.0, 0.0, 0.0, 0.0, 0.0)}, "coefficient beyond 2"),
        ({"distortion_model": "equidistant", "distortion": (-1.9, 0.0, 0.0, 0.0)}, "check the order k1, k2, k3, k4"),
    ],
)
def test_a_calibration_that_is_none_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        CameraMountConfig(**fields)


def test_a_calibration_takes_the_place_of_the_field_of_view() -> None:
    camera = CameraMountConfig(fx_px=400.0, fy_px=420.0, cx_px=310.0, cy_px=250.0)
    info = camera.info(0)
    assert (info.focal_px, info.center_px) == (400.0, (310.0, 250.0))
    assert info.focal_y_px == pytest.approx(420.0)
    assert info.aspect == pytest.approx(1.05)
    assert b"focal_y_px" not in msgspec.json.encode(CameraMountConfig().info(0))
    assert msgspec.json.decode(msgspec.json.encode(info), type=CameraInfo) == info
