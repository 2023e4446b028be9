"""Outlines of detected tags in an image."""

from math import pi

import pytest

from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import CameraMountConfig
from jezero.schemas.estimate import TagEstimate
from jezero.schemas.landing_board import BoardTag
from jezero.services.ground_station.web.camera_feed import tag_outlines

CAMERA = CameraMountConfig(pos_camera_frd_m=(0.0, 0.0, 0.0))
TAG = BoardTag(tag_id=77, side_m=0.6, pos_rover_body_m=(0.0, 0.0, 0.0))
DOWN = (-0.5 * pi, 0.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def seen_from(north_m: float, east_m: float, down_m: float, tag_ids: tuple[int, ...] = (77,)) -> TagEstimate:
    """A detection from a position relative to the platform."""
    return TagEstimate(
        t_ns=0,
        tag_ids=tag_ids,
        pos_uav_rel_rover_ned_m=(north_m, east_m, down_m),
        cov_pos_ned_m2=(0.0,) * 6,
        range_m=3.0,
        reprojection_px=0.1,
    )


def test_a_tag_straight_below_is_a_square_in_the_middle() -> None:
    (corners,) = tag_outlines(seen_from(0.0, 0.0, -3.0), 0.0, LEVEL, DOWN, CAMERA, [TAG])
    half_px = CAMERA.focal_px * 0.3 / 3.0
    x, y = CAMERA.center_px
    expected = [
        (x - half_px, y - half_px),
        (x + half_px, y - half_px),
        (x + half_px, y + half_px),
        (x - half_px, y + half_px),
    ]
    assert corners == [pytest.approx(corner, abs=0.1) for corner in expected]


def test_a_tag_ahead_is_in_the_upper_part_and_turns_with_the_rover() -> None:
    (corners,) = tag_outlines(seen_from(-1.0, 0.0, -3.0), 0.5 * pi, LEVEL, DOWN, CAMERA, [TAG])
    middle_y = sum(corner[1] for corner in corners) / 4.0
    assert middle_y == pytest.approx(CAMERA.center_px[1] - CAMERA.focal_px / 3.0, abs=0.1)
    assert corners[0][0] > CAMERA.center_px[0]  # the top of the tag's image points east, to the right


def test_a_vehicle_that_pitches_up_sees_the_tag_towards_the_lower_edge() -> None:
    pitched = quat_from_euler(0.0, 0.1, 0.0)
    (corners,) = tag_outlines(seen_from(0.0, 0.0, -3.0), 0.0, pitched, DOWN, CAMERA, [TAG])
    assert sum(corner[1] for corner in corners) / 4.0 > CAMERA.center_px[1] + 30.0


def test_tags_that_were_not_detected_or_are_behind_the_camera_are_left_out() -> None:
    assert tag_outlines(seen_from(0.0, 0.0, -3.0, (5,)), 0.0, LEVEL, DOWN, CAMERA, [TAG]) == []
    assert tag_outlines(seen_from(0.0, 0.0, 3.0), 0.0, LEVEL, DOWN, CAMERA, [TAG]) == []
