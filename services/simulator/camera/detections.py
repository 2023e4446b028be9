"""Corners of tags that a tag detector would find in a picture that nobody has rendered."""

from collections.abc import Sequence
from math import exp

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.schemas.landing_board import CELLS, BoardTag
from jezero.schemas.sensors import CameraInfo, CornersOfTag
from jezero.services.simulator.camera.config import ProjectionConfig
from jezero.services.simulator.camera.sun import shadow_of
from jezero.services.simulator.camera.view import CameraView, on_rover, project
from jezero.services.simulator.obstacles import hidden

Indices = npt.NDArray[np.int64]
NO_OBSTACLES: Array = np.zeros((0, 3, 3))


class BoardGeometry:
    """The tags of a board as arrays, in `rover_body`.

    Attributes:
        tag_ids: (N,) numbers of the tags.
        middles_m: (N, 1, 3) middles of the tags.
        half_sides_m: (N,) halves of their sides.
        outlines_m: (2, N, 4, 3) corners of the black squares, and of the white margins, without which a tag is not
            found.
    """

    def __init__(self, board: Sequence[BoardTag]) -> None:
        corners_m: Array = np.array([tag.corners_rover_body_m for tag in board])
        self.tag_ids = tuple(tag.tag_id for tag in board)
        self.middles_m: Array = corners_m.mean(axis=1, keepdims=True)
        self.half_sides_m: Array = np.array([0.5 * tag.side_m for tag in board])
        margins_m = self.middles_m + (CELLS + 2) / CELLS * (corners_m - self.middles_m)
        self.outlines_m: Array = np.stack((corners_m, margins_m))


def tags_in_picture(board: BoardGeometry, view: CameraView, info: CameraInfo) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Corners of all tags of the board, and which tags are in the picture with their whole margin.

    Returns:
        (N, 4, 2) pixels and (N,) truth values; from below the platform no tag is in the picture.
    """
    relative = on_rover(view)
    corners_px, margins_px = project(board.outlines_m, relative, info)
    limit_px = np.array((info.width_px - 0.5, info.height_px - 0.5))
    if relative.pos_camera_ned_m[2] >= 0.0:
        return corners_px, np.zeros(len(corners_px), dtype=np.bool_)
    within = (margins_px > -0.5) & (margins_px < limit_px)
    return corners_px, np.logical_and.reduce(within, axis=(1, 2))


def detect(
    board: BoardGeometry,
    views: tuple[CameraView, CameraView, CameraView],
    info: CameraInfo,
    config: ProjectionConfig,
    rng: np.random.Generator,
    obstacles_ned_m: Array = NO_OBSTACLES,
) -> tuple[CornersOfTag, ...]:
    """Tags as found, with the detector's errors.

    Args:
        views: views at the exposure's start, middle and end.
        obstacles_ned_m: (n, 3, 3) corners of the triangles that may hide a tag, in the map.
    """
    corners_px, inside = tags_in_picture(board, views[1], info)
    if len(obstacles_ned_m) and inside.any():
        inside &= ~behind(obstacles_ned_m, board, views[1])
    if not inside.any():
        return ()
    kept = np.flatnonzero(inside)
    corners_px = corners_px[kept]
    blurs_px, sizes_px = blurs(board, kept, views, info), sizes(corners_px)
    dark = in_shadow(board, kept, views[1], config.radius_shadow_m)
    found = []
    for i, index in enumerate(kept.tolist()):
        blur_px, size_px = float(blurs_px[i]), float(sizes_px[i])
        if rng.random() < probability_found(size_px, blur_px, bool(dark[i]), config):
            noisy_px = _with_errors(corners_px[i], size_px, blur_px, config, rng)
            (ax, ay), (bx, by), (cx, cy), (dx, dy) = noisy_px.tolist()
            quad = ((ax, ay), (bx, by), (cx, cy), (dx, dy))
            found.append(CornersOfTag(tag_id=board.tag_ids[index], corners_px=quad))
    return tuple(found)


def behind(obstacles_ned_m: Array, board: BoardGeometry, view: CameraView) -> npt.NDArray[np.bool_]:
    """Which tags have a corner of their margin behind an obstacle."""
    margins_ned_m = np.array(
        [view.ned_from_rover_body((x, y, z)) for x, y, z in board.outlines_m[1].reshape(-1, 3).tolist()]
    )
    corners_hidden = hidden(obstacles_ned_m, np.array(view.pos_camera_ned_m), margins_ned_m)
    tags_hidden: npt.NDArray[np.bool_] = np.logical_or.reduce(corners_hidden.reshape(-1, 4), axis=1)
    return tags_hidden


def blurs(
    board: BoardGeometry, tags: Indices, views: tuple[CameraView, CameraView, CameraView], info: CameraInfo
) -> Array:
    """Pixels by which the middles of some tags move from the first view to the last."""
    middles_m = board.middles_m[tags, 0]
    path_px = project(middles_m, on_rover(views[2]), info) - project(middles_m, on_rover(views[0]), info)
    result: Array = np.hypot(path_px[:, 0], path_px[:, 1])
    return result


def in_shadow(board: BoardGeometry, tags: Indices, view: CameraView, radius_m: float) -> npt.NDArray[np.bool_]:
    """Which tags the vehicle's shadow touches; the vehicle is where its camera is."""
    shadow_ned_m = shadow_of(view.pos_camera_ned_m, view.pos_rover_ned_m[2])
    forward_m, right_m, _ = view.rover_body_from_ned(shadow_ned_m)
    away_m = board.middles_m[tags, 0, :2] - np.array((forward_m, right_m))
    reach_m = radius_m + board.half_sides_m[tags]
    touched: npt.NDArray[np.bool_] = np.hypot(away_m[:, 0], away_m[:, 1]) < reach_m
    return touched


def sizes(corners_px: Array) -> Array:
    """Roots of the areas of (N, 4, 2) quadrilaterals."""
    a, b = corners_px[:, 2] - corners_px[:, 0], corners_px[:, 3] - corners_px[:, 1]
    result: Array = np.sqrt(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    return result


def probability_found(size_px: float, blur_px: float, dark: bool, config: ProjectionConfig) -> float:
    """A logistic function of the tag's size, lower where shadows cross the tag."""
    half_px = config.size_half_px + config.size_per_blur * blur_px
    share = config.share_in_shadow if dark else 1.0
    return share / (1.0 + exp(min(50.0, (half_px - size_px) / config.size_width_px)))


def _with_errors(
    corners_px: Array, size_px: float, blur_px: float, config: ProjectionConfig, rng: np.random.Generator
) -> Array:
    """Errors of each corner, of all corners together, and of the size."""
    blur2 = blur_px * blur_px
    std_corner_px = config.std_corner_px + config.std_corner_per_blur2 * blur2
    std_shift_px = config.std_shift_px + config.std_shift_per_blur2 * blur2
    std_size_px = config.std_size_px + config.std_size_per_blur2 * blur2
    middle_px = corners_px.mean(axis=0)
    errors = rng.standard_normal(11)
    scale = 1.0 + (std_size_px * errors[10] - config.shrinks_per_blur2 * blur2) / size_px
    result: Array = middle_px + scale * (corners_px - middle_px)
    result += std_shift_px * errors[8:10] + std_corner_px * errors[:8].reshape(4, 2)
    return result
