"""What falls where in the ventral camera's picture, and what a detector would find there."""

from math import pi

import cv2
import msgspec
import numpy as np
import pytest

from jezero.base.frames import Vec3, quat_from_euler
from jezero.base.vehicle_config import CameraMountConfig
from jezero.schemas.landing_board import BIG_ID, make_board
from jezero.schemas.state import Scene
from jezero.services.simulator.camera.config import ProjectionConfig
from jezero.services.simulator.camera.detections import (
    BoardGeometry,
    detect,
    in_shadow,
    probability_found,
    sizes,
    tags_in_picture,
)
from jezero.services.simulator.camera.sun import shadow_of
from jezero.services.simulator.camera.view import CameraView, project, view_of
from jezero.services.simulator.config import BoxConfig, TerrainConfig
from jezero.services.simulator.obstacles import obstacle_triangles

LANDING_BOARD = make_board()
CAMERA = CameraMountConfig(pos_camera_frd_m=(0.0, 0.0, 0.0))
INFO = CAMERA.info(0)
BOARD = BoardGeometry(LANDING_BOARD)
DOWN_RAD = -0.5 * pi

EXACT = ProjectionConfig(
    size_half_px=1.0,
    size_per_blur=0.0,
    share_in_shadow=1.0,
    std_corner_px=0.0,
    std_corner_per_blur2=0.0,
    std_shift_px=0.0,
    std_shift_per_blur2=0.0,
    std_size_px=0.0,
    std_size_per_blur2=0.0,
    shrinks_per_blur2=0.0,
)


def scene(
    above_m: float = 2.0,
    beside_m: tuple[float, float] = (0.0, 0.0),
    attitude_rad: Vec3 = (0.0, 0.0, 0.0),
    vel_uav_ned_mps: Vec3 = (0.0, 0.0, 0.0),
    rates_uav_frd_rps: Vec3 = (0.0, 0.0, 0.0),
    yaw_rover_rad: float = 0.0,
) -> Scene:
    return Scene(
        t_ns=0,
        epoch_id=1,
        pos_uav_ned_m=(5.0 + beside_m[0], -3.0 + beside_m[1], -0.5 - above_m),
        vel_uav_ned_mps=vel_uav_ned_mps,
        q_ned_from_frd=quat_from_euler(*attitude_rad),
        rates_uav_frd_rps=rates_uav_frd_rps,
        pos_rover_ned_m=(5.0, -3.0, -0.5),
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=yaw_rover_rad,
    )


def down(at: Scene) -> CameraView:
    return view_of(at, CAMERA.pos_camera_frd_m, (DOWN_RAD, 0.0))


def still(at: Scene) -> tuple[CameraView, CameraView, CameraView]:
    return (down(at), down(at), down(at))


def test_straight_down_the_nose_is_at_the_top_and_the_middle_of_the_board_in_the_middle() -> None:
    corners_px, _ = tags_in_picture(BOARD, down(scene(2.0)), INFO)
    half_px = INFO.focal_px * 0.3 / 2.0
    expected = [(-half_px, -half_px), (half_px, -half_px), (half_px, half_px), (-half_px, half_px)]
    assert corners_px[0] - np.array(INFO.center_px) == pytest.approx(np.array(expected), abs=1e-9)


def test_80_degrees_are_as_wide_as_the_picture() -> None:
    assert INFO.focal_px == pytest.approx(381.36, abs=0.01)
    assert INFO.center_px == (319.5, 239.5)


def test_a_board_turned_clockwise_turns_clockwise_in_the_picture() -> None:
    corners_px, _ = tags_in_picture(BOARD, down(scene(2.0, yaw_rover_rad=0.1)), INFO)
    top = 0.5 * (corners_px[0][0] + corners_px[0][1]) - np.array(INFO.center_px)
    assert top[0] > 0.0 > top[1]


def test_projection_agrees_with_opencv_for_any_pose() -> None:
    rng = np.random.default_rng(0)
    matrix = np.array([[INFO.focal_px, 0, INFO.center_px[0]], [0, INFO.focal_px, INFO.center_px[1]], [0, 0, 1.0]])
    for _ in range(50):
        at = scene(attitude_rad=tuple(rng.uniform(-0.5, 0.5, 3)), beside_m=tuple(rng.uniform(-2, 2, 2)))
        view = view_of(at, (0.1, 0.02, 0.05), (rng.uniform(-pi / 2, 0.0), rng.uniform(-0.5, 0.5)))
        in_camera_m = rng.uniform((-1, -1, 0.5), (1, 1, 5), (20, 3))
        points_m = np.array(view.pos_camera_ned_m) + in_camera_m @ view.rotation_ned_from_camera.T
        rotation = view.rotation_ned_from_camera.T
        expected, _ = cv2.projectPoints(
            points_m, cv2.Rodrigues(rotation)[0], -rotation @ np.array(view.pos_camera_ned_m), matrix, np.zeros(4)
        )
        assert project(points_m, view, INFO) == pytest.approx(expected[:, 0], abs=1e-6)


def test_what_is_behind_the_camera_has_no_place_in_the_picture() -> None:
    view = down(scene())
    above_m = np.array(view.pos_camera_ned_m) + np.array((0.0, 0.0, -1.0))
    assert np.isnan(project(above_m, view, INFO)).all()
    assert detect(BOARD, still(scene(above_m=-0.3)), INFO, EXACT, np.random.default_rng(0)) == ()


def test_the_big_tag_is_found_from_high_up_and_small_ones_when_standing() -> None:
    rng = np.random.default_rng(0)
    config = msgspec.structs.replace(EXACT, size_half_px=22.0)
    high = detect(BOARD, still(scene(8.0)), INFO, config, rng)
    assert [tag.tag_id for tag in high] == [BIG_ID]
    standing = {tag.tag_id for tag in detect(BOARD, still(scene(0.12)), INFO, config, rng)}
    assert BIG_ID not in standing and 1 in standing and len(standing) > 2
    beside = {tag.tag_id for tag in detect(BOARD, still(scene(0.12, (0.1, 0.0))), INFO, config, rng)}
    assert beside and 1 not in beside


def test_a_tag_whose_margin_is_cut_off_is_not_found() -> None:
    _, inside = tags_in_picture(BOARD, down(scene(1.0, (0.31, 0.0))), INFO)
    assert not inside[0] and inside[1]


def test_a_tag_behind_an_obstacle_is_not_found() -> None:
    at = scene(4.0)
    north_m, east_m, down_m = at.pos_rover_ned_m
    height_m = -down_m + 2.0
    for beside_m, seen in ((0.0, False), (3.0, True)):
        roof = BoxConfig(north_m=north_m + beside_m, east_m=east_m, size_m=(2.0, 2.0, 0.1), height_m=height_m)
        flat = TerrainConfig(std_ground_m=0.0, craters=0, rocks=0, boxes=(roof,))
        found = detect(BOARD, still(at), INFO, EXACT, np.random.default_rng(0), obstacle_triangles(flat))
        assert (BIG_ID in {tag.tag_id for tag in found}) == seen


def test_without_errors_the_corners_are_where_they_are_projected() -> None:
    at = scene(3.0, (0.5, -0.4), (0.1, -0.05, 2.0))
    corners_px, _ = tags_in_picture(BOARD, down(at), INFO)
    for tag in detect(BOARD, still(at), INFO, EXACT, np.random.default_rng(0)):
        index = next(i for i, entry in enumerate(LANDING_BOARD) if entry.tag_id == tag.tag_id)
        assert np.array(tag.corners_px) == pytest.approx(corners_px[index], abs=1e-9)


def test_corner_errors_have_the_given_standard_deviation_and_grow_with_blur() -> None:
    config = msgspec.structs.replace(EXACT, std_corner_px=0.2, std_corner_per_blur2=0.1)
    rng = np.random.default_rng(0)
    at = scene(4.0)
    exact = tags_in_picture(BOARD, down(at), INFO)[0][0]
    still_px = [np.array(detect(BOARD, still(at), INFO, config, rng)[0].corners_px) - exact for _ in range(500)]
    assert np.std(still_px) == pytest.approx(0.2, rel=0.05)
    fast = scene(4.0, vel_uav_ned_mps=(5.0, 0.0, 0.0))
    views = tuple(view_of(fast, (0.0, 0.0, 0.0), (DOWN_RAD, 0.0), ahead_s=ahead_s) for ahead_s in (-0.01, 0.0, 0.01))
    blur_px = 0.02 * 5.0 * INFO.focal_px / 4.0
    fast_px = [
        np.array(detect(BOARD, (views[0], views[1], views[2]), INFO, config, rng)[0].corners_px) - exact
        for _ in range(500)
    ]
    assert np.std(fast_px) == pytest.approx(0.2 + 0.1 * blur_px**2, rel=0.05)


def test_turning_blurs_too() -> None:
    at = scene(4.0, rates_uav_frd_rps=(0.0, 1.0, 0.0))
    before, after = (view_of(at, (0.0, 0.0, 0.0), (DOWN_RAD, 0.0), ahead_s=s) for s in (-0.005, 0.005))
    point_m = np.array(at.pos_rover_ned_m)
    moved_px = project(point_m, after, INFO) - project(point_m, before, INFO)
    assert moved_px == pytest.approx((0.0, 0.01 * INFO.focal_px), abs=0.01)


def test_half_of_the_tags_of_the_critical_size_are_found() -> None:
    config = ProjectionConfig(size_half_px=20.0, size_width_px=1.0, size_per_blur=2.0)
    assert probability_found(20.0, 0.0, False, config) == 0.5
    assert probability_found(24.0, 2.0, False, config) == 0.5
    assert probability_found(40.0, 0.0, False, config) > 0.999
    assert probability_found(1.0, 0.0, False, config) < 1e-6
    assert probability_found(40.0, 0.0, True, config) == pytest.approx(config.share_in_shadow, abs=1e-3)


def test_shift_and_size_are_errors_of_the_whole_tag() -> None:
    config = msgspec.structs.replace(EXACT, std_shift_px=0.3, std_size_px=0.4)
    rng = np.random.default_rng(0)
    at = scene(4.0)
    exact_px = tags_in_picture(BOARD, down(at), INFO)[0][0]
    errors_px = (
        np.array([np.array(detect(BOARD, still(at), INFO, config, rng)[0].corners_px) for _ in range(800)]) - exact_px
    )
    shifts_px = errors_px.mean(axis=1)
    assert shifts_px.std() == pytest.approx(0.3, rel=0.06)
    sides_px = errors_px[:, 1, 0] - errors_px[:, 0, 0]
    assert sides_px.std() == pytest.approx(0.4, rel=0.06)


def test_the_vehicles_shadow_falls_away_from_the_sun_and_touches_the_tags_there() -> None:
    every = np.arange(len(LANDING_BOARD))
    assert not in_shadow(BOARD, every, down(scene(8.0)), 0.33).any()
    north_m, east_m, _ = shadow_of((0.0, 0.0, -1.0), 0.0)
    assert (north_m, east_m) == pytest.approx((-0.5788, 0.6897), abs=1e-3)
    turned = scene(1.0, (-north_m + 0.15, -east_m), yaw_rover_rad=0.5 * pi)
    dark = in_shadow(BOARD, every, down(turned), 0.05)
    assert 0 < dark.sum() < 10
    assert all(tag.pos_rover_body_m[1] <= 0.0 for tag, is_dark in zip(LANDING_BOARD, dark, strict=True) if is_dark)


def test_a_tags_size_is_the_root_of_its_area() -> None:
    square = np.array([[(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)]])
    assert sizes(square) == pytest.approx([3.0])
