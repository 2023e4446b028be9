"""The picture of the rover's platform with its tags, as AprilTags are printed, for the pages to draw."""

import base64
from typing import Any

import numpy as np
import numpy.typing as npt

from jezero.schemas.landing_board import CELLS
from jezero.vehicle_config import PlatformConfig

Image = npt.NDArray[np.uint8]
PIXELS_PER_M = 1000
SIDE_MAX_PX = 2048
PANEL, EDGE, WHITE, BLACK = 205, 90, 245, 18
EDGE_M = 0.012


def board_picture(platform: PlatformConfig) -> Image:
    """(n, n) grey; rows from the rover's nose, columns from its left."""
    px_per_m = min(PIXELS_PER_M, SIDE_MAX_PX / platform.side_m)
    n = round(platform.side_m * px_per_m)
    picture = np.full((n, n), EDGE, dtype=np.uint8)
    edge = round(EDGE_M * px_per_m)
    picture[edge : n - edge, edge : n - edge] = PANEL
    for tag in platform.board:
        forward_m, right_m, _ = tag.pos_rover_body_m
        middle_m = (0.5 * platform.side_m - forward_m, 0.5 * platform.side_m + right_m)
        _print_tag(picture, tag.tag_id, tag.side_m * px_per_m, (middle_m[0] * px_per_m, middle_m[1] * px_per_m))
    return picture


def board_address(platform: PlatformConfig) -> str:
    """The picture as a PNG in a `data:` address."""
    import cv2

    _, compressed = cv2.imencode(".png", board_picture(platform))
    return "data:image/png;base64," + base64.b64encode(compressed.tobytes()).decode()


def _print_tag(picture: Image, tag_id: int, side_px: float, middle_px: tuple[float, float]) -> None:
    """Print a tag with its white margin of one cell; pixels outside the picture are left out."""
    import cv2

    dictionary: Any = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(cv2.aruco.generateImageMarker(dictionary, tag_id, CELLS), 1, constant_values=255)
    outer_px = side_px * len(cells) / CELLS
    rows, columns = (_cells_at(len(picture), middle - 0.5 * outer_px, outer_px, len(cells)) for middle in middle_px)
    printed = np.where(cells > 0, WHITE, BLACK).astype(np.uint8)
    inside = np.ix_(np.flatnonzero(rows >= 0), np.flatnonzero(columns >= 0))
    picture[inside] = printed[np.ix_(rows[rows >= 0], columns[columns >= 0])]


def _cells_at(pixels: int, start_px: float, outer_px: float, cells: int) -> npt.NDArray[np.int64]:
    """(pixels,) number of the cell in which the middle of each pixel is; -1 outside the tag."""
    at = np.floor((np.arange(pixels) + 0.5 - start_px) / outer_px * cells).astype(np.int64)
    return np.where((at >= 0) & (at < cells), at, -1)
