"""The calibration of synthetic cameras, from pictures to the lines of the settings."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from jezero.calibration.board import Board, View
from jezero.calibration.fit import FitError, fit_camera
from jezero.calibration.intrinsics import CameraIntrinsics, read_intrinsics
from jezero.cli.camera import camera
from tests.calibration.views import SIZE_PX, photographed, poses

PLUMB_BOB = CameraIntrinsics(SIZE_PX, (420.0, 424.0), (325.0, 236.0), "plumb_bob", (-0.2, 0.06, 0.001, -0.0005, 0.0))
FISHEYE = CameraIntrinsics(SIZE_PX, (330.0, 330.0), (318.0, 243.0), "equidistant", (-0.02, 0.01, -0.004, 0.001))


def pictures(truth: CameraIntrinsics, count: int = 25) -> list[np.ndarray]:
    board = Board()
    return [photographed(board, *pose, truth, seed) for seed, pose in enumerate(poses(count, board, truth))]


def views_in(shown: Sequence[np.ndarray]) -> list[View]:
    board = Board()
    return [view for view in map(board.find, shown) if view is not None]


@pytest.mark.parametrize("truth", [PLUMB_BOB, FISHEYE], ids=lambda truth: truth.model)
def test_25_synthetic_views_give_the_camera_back(truth: CameraIntrinsics) -> None:
    fit = fit_camera(views_in(pictures(truth)), SIZE_PX, truth.model)
    found = fit.intrinsics
    assert fit.views >= 20
    assert fit.reprojection_px < 0.3
    assert found.focal_px[0] == pytest.approx(truth.focal_px[0], rel=0.005)
    assert found.focal_px[1] == pytest.approx(truth.focal_px[1], rel=0.005)
    assert found.center_px == pytest.approx(truth.center_px, abs=3.0)


def test_too_few_views_are_refused() -> None:
    with pytest.raises(FitError, match="views of the board are too few"):
        fit_camera(views_in(pictures(PLUMB_BOB, 3)), SIZE_PX)


def test_the_command_calibrates_with_pictures_of_a_folder(tmp_path: Path) -> None:
    for number, picture in enumerate(pictures(PLUMB_BOB, 14)):
        cv2.imwrite(str(tmp_path / f"{number:02}.png"), picture)
    cv2.imwrite(str(tmp_path / "99.png"), np.zeros((480, 640), np.uint8))
    out = tmp_path / "camera.yaml"
    words = ["calibrate", "--pictures", str(tmp_path), "--from-pictures", "--out", str(out)]
    done = CliRunner().invoke(camera, words)
    assert done.exit_code == 0, done.output
    assert "99.png does not show enough of the board" in done.output
    assert "fx_px = " in done.output and "px; wrote" in done.output
    assert read_intrinsics(out).focal_px[0] == pytest.approx(420.0, rel=0.01)


def test_the_command_says_what_is_wrong_with_a_folder(tmp_path: Path) -> None:
    words = ["calibrate", "--pictures", str(tmp_path), "--from-pictures"]
    assert "there is no picture" in CliRunner().invoke(camera, words).output
    for name, height_px in (("a", 480), ("b", 240)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((height_px, 640), np.uint8))
    assert "have not one size (640 x 240, 640 x 480)" in CliRunner().invoke(camera, words).output


def test_the_board_is_a_page_of_a4_in_true_size(tmp_path: Path) -> None:
    done = CliRunner().invoke(camera, ["board", "--out", str(tmp_path / "board.pdf")])
    assert done.exit_code == 0, done.output
    text = (tmp_path / "board.pdf").read_bytes()
    box = text[text.index(b"/MediaBox [") + 11 :].split(b"]")[0].split()
    points_per_mm = 72.0 / 25.4
    assert [float(value) for value in box] == pytest.approx([0, 0, 210 * points_per_mm, 297 * points_per_mm], abs=0.1)
