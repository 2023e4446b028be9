"""The picture on top of the rover's platform: panel, edge marks and the landing board's tags."""

import cv2
import numpy as np
import numpy.typing as npt

from jezero.base.vehicle_config import PlatformConfig
from jezero.schemas.landing_board import CELLS
from jezero.services.simulator.noise import generator

Image = npt.NDArray[np.uint8]
TEXELS_PER_M = 2000
WHITE, BLACK = 225, 22
PANEL = (168, 170, 172)


def board_picture(platform: PlatformConfig) -> Image:
    """(n, n, 3) red, green, blue, half a millimetre to the texel; rows from the rover's nose, columns from its left."""
    side_m = platform.side_m
    n = round(side_m * TEXELS_PER_M)
    picture = np.empty((n, n, 3), dtype=np.uint8)
    picture[:] = PANEL
    _mark_edge(picture)
    for tag in platform.board:
        forward_m, right_m, _ = tag.pos_rover_body_m
        _paint_tag(picture, tag.tag_id, tag.side_m, 0.5 * side_m - forward_m, 0.5 * side_m + right_m)
    return _weathered(picture)


def _mark_edge(picture: Image) -> None:
    """Stripes along the edge, bolts, and a line around the tags."""
    n = len(picture)
    edge = round(0.022 * TEXELS_PER_M)
    rows, columns = np.indices((n, n), dtype=np.int32)
    stripes = ((rows + columns) // round(0.04 * TEXELS_PER_M)) % 2 == 0
    outer = (np.minimum(rows, n - 1 - rows) < edge) | (np.minimum(columns, n - 1 - columns) < edge)
    picture[outer & stripes] = (214, 120, 32)
    picture[outer & ~stripes] = (40, 40, 42)
    frame = round(0.09 * TEXELS_PER_M)
    cv2.rectangle(picture, (frame, frame), (n - 1 - frame, n - 1 - frame), (120, 122, 125), 6, cv2.LINE_AA)
    for at in np.linspace(2 * edge, n - 2 * edge, 9).astype(int).tolist():
        for row, column in ((2 * edge, at), (n - 2 * edge, at), (at, 2 * edge), (at, n - 2 * edge)):
            cv2.circle(picture, (column, row), 11, (96, 98, 100), -1, cv2.LINE_AA)
            cv2.circle(picture, (column, row), 7, (140, 142, 144), -1, cv2.LINE_AA)


def _paint_tag(picture: Image, tag_id: int, side_m: float, from_nose_m: float, from_left_m: float) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(cv2.aruco.generateImageMarker(dictionary, tag_id, CELLS), 1, constant_values=255)
    outer_px = round(side_m * len(cells) / CELLS * TEXELS_PER_M)
    paint = np.where(cv2.resize(cells, (outer_px, outer_px), interpolation=cv2.INTER_NEAREST) > 0, WHITE, BLACK)
    half = len(paint) // 2
    row, column = round(from_nose_m * TEXELS_PER_M) - half, round(from_left_m * TEXELS_PER_M) - half
    picture[row : row + len(paint), column : column + len(paint)] = paint[..., None]


def _weathered(picture: Image) -> Image:
    """Some dust of the ground's colour, and light wear."""
    n = len(picture)
    rng = generator(1, "board")
    dust = cv2.resize(rng.random((24, 24), dtype=np.float32), (n, n), interpolation=cv2.INTER_CUBIC)
    grain = cv2.resize(rng.random((n // 4, n // 4), dtype=np.float32), (n, n), interpolation=cv2.INTER_LINEAR)
    share = np.clip(0.10 * (dust - 0.35) + 0.05 * (grain - 0.5), 0.0, 0.25)[..., None]
    result: Image = (picture + share * (np.array((176, 124, 84), dtype=np.float32) - picture)).astype(np.uint8)
    return result
