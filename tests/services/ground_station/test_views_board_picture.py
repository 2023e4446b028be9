"""The picture of the platform: a detector must find in it the tags of vehicle.toml where they are."""

import base64

import cv2
import numpy as np
import pytest

from jezero.base.vehicle_config import PlatformConfig
from jezero.schemas.landing_board import BoardTag
from jezero.services.ground_station.views import PIXELS_PER_M, board_address, board_picture

TWO_TAGS = PlatformConfig(
    tags=(
        BoardTag(tag_id=3, side_m=0.3, pos_rover_body_m=(0.25, -0.25, 0.0)),
        BoardTag(tag_id=8, side_m=0.2, pos_rover_body_m=(-0.2, 0.3, 0.0)),
    )
)


def test_each_tag_is_found_where_the_board_has_it() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(board_picture(TWO_TAGS))
    assert ids is not None
    found = dict(zip(ids.ravel().tolist(), corners, strict=True))
    assert set(found) == {3, 8}
    for tag in TWO_TAGS.board:
        column, row = found[tag.tag_id].reshape(4, 2).mean(axis=0)
        forward_m, right_m, _ = tag.pos_rover_body_m
        assert row / PIXELS_PER_M == pytest.approx(0.5 - forward_m, abs=0.003)
        assert column / PIXELS_PER_M == pytest.approx(0.5 + right_m, abs=0.003)


def test_the_landing_board_is_the_one_that_the_camera_sees() -> None:
    from jezero.services.simulator.camera.board import board_picture as painted

    mine = board_picture(PlatformConfig())
    theirs = cv2.resize(painted(PlatformConfig()), mine.shape, interpolation=cv2.INTER_AREA).mean(axis=2)
    dark, theirs_dark = mine < 128, theirs < 128
    board = slice(len(mine) // 5, -len(mine) // 5)  # without the marks of the edge
    assert np.mean(dark[board, board] == theirs_dark[board, board]) > 0.97


def test_the_address_holds_the_picture_itself() -> None:
    kind, _, data = board_address(TWO_TAGS).partition(",")
    assert kind == "data:image/png;base64"
    decoded = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert decoded is not None
    assert np.array_equal(decoded, board_picture(TWO_TAGS))
