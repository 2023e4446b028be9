"""The landing board: one table for renderer, projected camera and detector."""

from math import cos, pi, radians, sin, tan

import cv2
import numpy as np

from jezero.schemas.landing_board import BIG_ID, CELLS, BoardTag, make_board

LANDING_BOARD = make_board()
STANDING_CAMERA_M = 0.12


def test_ids_are_unique() -> None:
    assert sorted(tag.tag_id for tag in LANDING_BOARD) == [*range(1, 26), BIG_ID]


def test_the_cells_of_the_big_tag_that_the_nested_one_hides_are_white() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = cv2.aruco.generateImageMarker(dictionary, BIG_ID, CELLS)
    assert (cells[3:5, 3:5] == 255).all()


def test_corners_go_clockwise_as_seen_from_above_from_the_front_left() -> None:
    assert LANDING_BOARD[0].corners_rover_body_m == ((0.3, -0.3, 0), (0.3, 0.3, 0), (-0.3, 0.3, 0), (-0.3, -0.3, 0))


def test_small_tags_with_their_margins_leave_the_middles_of_the_big_tags_cells_free() -> None:
    cell_m = LANDING_BOARD[0].side_m / CELLS
    for tag in LANDING_BOARD[2:]:
        reach_m = 0.5 * tag.side_m * (CELLS + 2) / CELLS
        assert reach_m < 0.25 * cell_m
        for along_m in tag.pos_rover_body_m[:2]:
            assert abs(along_m / cell_m - round(along_m / cell_m)) < 1e-9


def test_tags_with_their_margins_do_not_cover_each_other() -> None:
    for i, a in enumerate(LANDING_BOARD[1:]):
        for b in LANDING_BOARD[i + 2 :]:
            apart_m = max(abs(p - q) for p, q in zip(a.pos_rover_body_m, b.pos_rover_body_m, strict=True))
            assert apart_m >= 0.5 * (a.side_m + b.side_m) * (CELLS + 2) / CELLS


def test_a_vehicle_standing_within_10_cm_of_the_middle_sees_a_whole_tag_at_any_heading() -> None:
    rng = np.random.default_rng(0)
    half_width_m = STANDING_CAMERA_M * tan(radians(40.0))
    half_height_m = 0.75 * half_width_m
    seen = 0
    for _ in range(300):
        radius_m, bearing_rad, yaw_rad = 0.1 * rng.random() ** 0.5, rng.uniform(0, 2 * pi), rng.uniform(0, 2 * pi)
        at = (radius_m * cos(bearing_rad), radius_m * sin(bearing_rad))
        seen += any(_is_in_view(tag, at, yaw_rad, half_width_m, half_height_m) for tag in LANDING_BOARD)
    assert seen == 300


def _is_in_view(
    tag: BoardTag, at: tuple[float, float], yaw_rad: float, half_width_m: float, half_height_m: float
) -> bool:
    margin = (CELLS + 2) / CELLS
    middle = tag.pos_rover_body_m
    for forward_m, right_m, _ in tag.corners_rover_body_m:
        north_m = middle[0] + margin * (forward_m - middle[0]) - at[0]
        east_m = middle[1] + margin * (right_m - middle[1]) - at[1]
        along_m = cos(yaw_rad) * north_m + sin(yaw_rad) * east_m
        across_m = -sin(yaw_rad) * north_m + cos(yaw_rad) * east_m
        if abs(across_m) > half_width_m or abs(along_m) > half_height_m:
            return False
    return True
