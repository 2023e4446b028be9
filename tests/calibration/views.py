"""Synthetic views of the calibration board."""

from math import radians
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.base.lens import undistort
from jezero.calibration.board import Board
from jezero.calibration.intrinsics import CameraIntrinsics

PIXELS_PER_SQUARE = 152
SIZE_PX = (640, 480)


def photographed(board: Board, turn: Array, place_m: Array, camera: CameraIntrinsics, seed: int) -> Any:
    """A grey picture of the board, by the rays of the camera's pixels, with blur and noise."""
    (width_px, height_px), (fx, fy) = camera.size_px, camera.focal_px
    columns, rows = np.meshgrid(np.arange(width_px), np.arange(height_px))
    seen = (np.stack((columns, rows), axis=-1) - np.array(camera.center_px)) / fx
    ideal = undistort(seen, camera.distortion, fy / fx)
    rotation = cv2.Rodrigues(turn)[0]
    homography = np.linalg.inv(np.column_stack((rotation[:, 0], rotation[:, 1], place_m)))
    on_board = np.concatenate((ideal, np.ones((height_px, width_px, 1))), axis=-1) @ homography.T
    at_m = on_board[..., :2] / on_board[..., 2:]
    print_ = np.pad(board.picture(PIXELS_PER_SQUARE), PIXELS_PER_SQUARE // 2, constant_values=255)
    per_m = PIXELS_PER_SQUARE * 5 / board.size_m[0]
    at_px = np.nan_to_num(at_m * per_m - 0.5 + PIXELS_PER_SQUARE // 2, nan=-1e4).astype(np.float32)
    # The print is minified: it is blurred first, as a lens would.
    soft = cv2.GaussianBlur(print_, (0, 0), 0.35 * per_m * float(np.linalg.norm(place_m)) / fx)
    picture = cv2.remap(soft, at_px[..., 0], at_px[..., 1], cv2.INTER_LINEAR, borderValue=(110,))
    noise = np.random.default_rng(seed).normal(0.0, 2.0, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def poses(count: int, board: Board, camera: CameraIntrinsics) -> list[tuple[Array, npt.NDArray[np.float64]]]:
    """Poses of the board all over the picture, near and far, tilted to all sides."""
    rng = np.random.default_rng(3)
    found = []
    for number in range(count):
        tilt, about = radians(10.0 + 30.0 * rng.random()), 2.4 * number
        turn = tilt * np.array((np.cos(about), np.sin(about), 0.0)) + np.array((0.0, 0.0, rng.normal(0.0, 0.15)))
        away_m = (0.42, 0.6, 0.8)[number % 3] * camera.focal_px[0] / 420.0  # as large with every lens
        at_px = np.array(((number * 7 % 5 - 2) * 80.0, (number * 3 % 5 - 2) * 55.0))
        middle_m = np.array((*(at_px * away_m / camera.focal_px[0]), away_m))
        half = cv2.Rodrigues(turn)[0] @ np.array((0.5 * board.size_m[0], 0.5 * board.size_m[1], 0.0))
        found.append((turn, middle_m - half))
    return found
