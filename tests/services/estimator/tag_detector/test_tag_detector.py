"""The tag detector: geometry against projections by hand, the library's corners against painted boards."""

from collections.abc import Sequence
from math import pi, radians, tan
from types import SimpleNamespace
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.base.codec import decode
from jezero.base.frames import (
    Quat,
    Vec3,
    q_frd_from_camera,
    quat_conjugate,
    quat_from_euler,
    quat_rotate,
    rotate_yaw,
    subtract,
)
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import NO_DELAY, MemoryBus
from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.estimate import TagEstimate
from jezero.schemas.landing_board import BIG_ID, make_board
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame, CameraInfo, CornersOfTag, TagCorners
from jezero.schemas.state import Odometry
from jezero.schemas.struct import Message
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.attitude_history import AttitudeHistory
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.finder import Finder
from jezero.services.estimator.tag_detector.pose import TagView, make_view, solve
from jezero.services.estimator.tag_detector.service import TagDetector, corners_by_id, locate

Grey = NDArray[np.uint8]
WIDTH_PX, HEIGHT_PX = 640, 480
FOCAL_PX = 0.5 * WIDTH_PX / tan(radians(40.0))
CENTER_PX = (0.5 * (WIDTH_PX - 1), 0.5 * (HEIGHT_PX - 1))
MOUNT_FRD_M: Vec3 = (0.05, 0.0, 0.05)
INFO = CameraInfo(
    t_ns=0,
    width_px=WIDTH_PX,
    height_px=HEIGHT_PX,
    focal_px=FOCAL_PX,
    center_px=CENTER_PX,
    pos_camera_frd_m=MOUNT_FRD_M,
    rate_hz=15.0,
)
DOWN_RAD = -0.5 * pi
LANDING_BOARD = make_board()
CONFIG = TagDetectorConfig()
CORNERS_M = corners_by_id(LANDING_BOARD)


def project(point_rover_body_m: Vec3, pos_uav_ned_m: Vec3, q: Quat, yaw_rover_rad: float, pitch_rad: float) -> Vec3:
    """(x, y) in the picture and the distance along the optical axis, step by step."""
    from_uav_ned_m = subtract(rotate_yaw(point_rover_body_m, yaw_rover_rad), pos_uav_ned_m)
    from_camera_frd_m = subtract(quat_rotate(quat_conjugate(q), from_uav_ned_m), MOUNT_FRD_M)
    right, down, forward = quat_rotate(quat_conjugate(q_frd_from_camera(pitch_rad)), from_camera_frd_m)
    return (CENTER_PX[0] + FOCAL_PX * right / forward, CENTER_PX[1] + FOCAL_PX * down / forward, forward)


def seen(
    tag_ids: Sequence[int], pos_uav_ned_m: Vec3, q: Quat, yaw_rover_rad: float, pitch_rad: float = DOWN_RAD
) -> list[CornersOfTag]:
    tags = []
    for tag in LANDING_BOARD:
        if tag.tag_id in tag_ids:
            corners = [project(c, pos_uav_ned_m, q, yaw_rover_rad, pitch_rad)[:2] for c in tag.corners_rover_body_m]
            tags.append(CornersOfTag(tag_id=tag.tag_id, corners_px=(corners[0], corners[1], corners[2], corners[3])))
    return tags


def view_of(q: Quat, pitch_rad: float = DOWN_RAD) -> TagView:
    return make_view(INFO, pitch_rad, q)


@pytest.mark.parametrize("yaw_rover_rad", [0.0, 0.5, -2.5, 3.1])
@pytest.mark.parametrize("height_m", [0.3, 2.0, 10.0])
@pytest.mark.parametrize("pitch_rad", [DOWN_RAD, -1.2])
def test_the_pose_behind_exact_corners_is_found_exactly(
    yaw_rover_rad: float, height_m: float, pitch_rad: float
) -> None:
    q = quat_from_euler(0.1, -0.12, 1.3)
    pos_ned_m = (0.03 * height_m, -0.1 * height_m, -height_m)
    found = locate(seen([BIG_ID, 1], pos_ned_m, q, yaw_rover_rad, pitch_rad), CORNERS_M, view_of(q, pitch_rad), CONFIG)
    assert found is not None
    assert found[0] == (BIG_ID, 1)
    assert found[1].pos_uav_rel_rover_ned_m == pytest.approx(pos_ned_m, abs=1e-6)
    assert found[1].yaw_rover_rad == pytest.approx(yaw_rover_rad, abs=1e-6)


def test_the_pose_over_a_tilted_platform_is_found_exactly() -> None:
    q, pos_ned_m, yaw_rover_rad = quat_from_euler(0.1, -0.12, 1.3), (0.1, -0.3, -3.0), 0.5
    q_level_from_rover_body = quat_from_euler(0.2, -0.15, 0.0)
    level_m = {
        tag_id: np.array([quat_rotate(q_level_from_rover_body, tuple(c)) for c in corners_m])
        for tag_id, corners_m in CORNERS_M.items()
    }
    tags = []
    for tag_id in (BIG_ID, 1):
        corners = [project(tuple(c), pos_ned_m, q, yaw_rover_rad, DOWN_RAD)[:2] for c in level_m[tag_id]]
        tags.append(CornersOfTag(tag_id=tag_id, corners_px=(corners[0], corners[1], corners[2], corners[3])))
    found = locate(tags, level_m, view_of(q), CONFIG)
    assert found is not None
    assert found[1].pos_uav_rel_rover_ned_m == pytest.approx(pos_ned_m, abs=1e-6)
    assert found[1].yaw_rover_rad == pytest.approx(yaw_rover_rad, abs=1e-6)


def test_errors_of_the_pose_are_as_large_as_its_covariance_says() -> None:
    rng = np.random.default_rng(3)
    q, pos_ned_m, yaw_rad, std_px = quat_from_euler(0.05, 0.1, 0.4), (0.5, -0.3, -4.0), 0.7, 0.3
    view = view_of(q)
    points_m = np.array([c for tag in LANDING_BOARD if tag.tag_id in (BIG_ID, 1) for c in tag.corners_rover_body_m])
    exact_px: Array = np.array([c for tag in seen([BIG_ID, 1], pos_ned_m, q, yaw_rad) for c in tag.corners_px])
    squares = []
    for _ in range(400):
        pose = solve(points_m, exact_px + rng.normal(0.0, std_px, exact_px.shape), view)
        assert pose is not None
        error = np.append(pose.pos_uav_rel_rover_ned_m - pos_ned_m, pose.yaw_rover_rad - yaw_rad)
        squares.append(error @ np.linalg.inv(std_px**2 * pose.inverse_normal) @ error)
    assert np.mean(squares) == pytest.approx(4.0, abs=0.45)


def test_a_tag_right_below_never_flips_to_the_second_pose_of_a_square() -> None:
    """OpenCV's solver for squares, which takes roll and pitch from the corners, flips here: its pose is metres off."""
    rng = np.random.default_rng(5)
    q, pos_ned_m, yaw_rad = quat_from_euler(0.0, 0.0, 0.0), (0.4, 0.3, -8.0), 0.2
    tag = next(tag for tag in LANDING_BOARD if tag.tag_id == BIG_ID)
    points_m = np.array(tag.corners_rover_body_m)
    exact_px: Array = np.array(seen([BIG_ID], pos_ned_m, q, yaw_rad)[0].corners_px)
    view, camera = view_of(q), np.array(((FOCAL_PX, 0, CENTER_PX[0]), (0, FOCAL_PX, CENTER_PX[1]), (0, 0, 1)))
    errors_m, errors_of_square_m = [], []
    for _ in range(300):
        corners_px = exact_px + rng.normal(0.0, 0.3, exact_px.shape)
        pose = solve(points_m, corners_px, view)
        assert pose is not None
        errors_m.append(np.linalg.norm(pose.pos_uav_rel_rover_ned_m - pos_ned_m))
        _, rotation, translation = cv2.solvePnP(points_m, corners_px, camera, None, flags=cv2.SOLVEPNP_IPPE)
        from_rover_m = -cv2.Rodrigues(rotation)[0].T @ translation.ravel()
        errors_of_square_m.append(abs(np.linalg.norm(from_rover_m[:2]) - 0.5))
    assert max(errors_of_square_m) > 1.0
    assert max(errors_m) < 0.2


def test_foreign_tags_are_ignored_and_a_tag_that_contradicts_the_others_is_left_out() -> None:
    q, pos_ned_m = quat_from_euler(0.0, 0.05, 0.0), (0.2, 0.1, -3.0)
    tags = seen([BIG_ID, 1], pos_ned_m, q, 0.3)
    foreign = CornersOfTag(tag_id=300, corners_px=tags[0].corners_px)
    moved = tuple((x + 40.0, y) for x, y in tags[1].corners_px)
    liar = CornersOfTag(tag_id=1, corners_px=(moved[0], moved[1], moved[2], moved[3]))
    found = locate([foreign, tags[0], liar], CORNERS_M, view_of(q), CONFIG)
    assert found is not None
    assert found[0] == (BIG_ID,)
    assert found[1].pos_uav_rel_rover_ned_m == pytest.approx(pos_ned_m, abs=1e-5)
    assert locate([foreign], CORNERS_M, view_of(q), CONFIG) is None
    assert locate([], CORNERS_M, view_of(q), CONFIG) is None


@pytest.mark.parametrize("wrong", range(4))
def test_of_several_tags_the_one_that_contradicts_the_others_is_left_out_whichever_it_is(wrong: int) -> None:
    q, pos_ned_m = quat_from_euler(0.0, 0.05, 0.0), (0.2, 0.1, -3.0)
    rng, tags = np.random.default_rng(wrong), seen([BIG_ID, 1, 2, 3], pos_ned_m, q, 0.3)
    for i, tag in enumerate(tags):
        corners = [
            (x + 20.0 * (i == wrong) + rng.normal(0.0, 0.3), y + rng.normal(0.0, 0.3)) for x, y in tag.corners_px
        ]
        tags[i] = CornersOfTag(tag_id=tag.tag_id, corners_px=(corners[0], corners[1], corners[2], corners[3]))
    found = locate(tags, CORNERS_M, view_of(q), CONFIG)
    assert found is not None
    assert found[0] == tuple(tag.tag_id for i, tag in enumerate(tags) if i != wrong)


def test_corners_above_the_horizon_or_in_one_point_give_no_pose() -> None:
    q = quat_from_euler(0.0, 0.0, 0.0)
    points_m = np.array(LANDING_BOARD[0].corners_rover_body_m)
    assert solve(points_m, np.array(((1.0, 1.0), (9.0, 1.0), (9.0, 9.0), (1.0, 9.0))), view_of(q, 0.5)) is None
    tags = seen([BIG_ID, 1], (0.2, 0.1, -3.0), q, 0.3)
    assert locate(tags, CORNERS_M, view_of(q), CONFIG) is not None
    assert locate(tags, CORNERS_M, view_of(q, 0.5), CONFIG) is None
    assert solve(points_m, np.full((4, 2), 100.0), view_of(q)) is None
    nearly_one_px = 100.0 + 3e-4 * np.array(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))
    assert solve(points_m, nearly_one_px, view_of(q)) is None


# -- pixels --


def painted_board(pixels_per_m: int) -> Grey:
    """The board from above, the platform's nose at the top, 1 m wide."""
    side = pixels_per_m
    picture = np.full((side, side), 160, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for tag in LANDING_BOARD:
        north_m, east_m, _ = tag.pos_rover_body_m
        cell = max(1, round(tag.side_m * pixels_per_m / 8))
        marker = np.pad(cv2.aruco.generateImageMarker(dictionary, tag.tag_id, 8 * cell), cell, constant_values=255)
        top = round((0.5 - north_m) * side - 5 * cell)
        left = round((0.5 + east_m) * side - 5 * cell)
        picture[top : top + 10 * cell, left : left + 10 * cell] = marker
    return picture


def photograph(board: Grey, pixels_per_m: int, pos_ned_m: Vec3, q: Quat, yaw_rad: float, t_ns: int = 0) -> CameraFrame:
    """Four times too large, then shrunk, with noise."""
    finer = 4
    size = board.shape[0] - 1
    half = 0.5 - 0.5 / pixels_per_m
    ends: list[Vec3] = [(half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0), (-half, -half, 0.0)]
    there = [project(end, pos_ned_m, q, yaw_rad, DOWN_RAD)[:2] for end in ends]
    source = np.array(((0, 0), (size, 0), (size, size), (0, size)), np.float32)
    target = np.array([((x + 0.5) * finer - 0.5, (y + 0.5) * finer - 0.5) for x, y in there], np.float32)
    turn = cv2.getPerspectiveTransform(source, target)
    big = cv2.warpPerspective(board, turn, (WIDTH_PX * finer, HEIGHT_PX * finer), borderValue=110)
    small = cv2.resize(big, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA).astype(float)
    noisy = np.clip(small + np.random.default_rng(1).normal(0.0, 4.0, small.shape), 0, 255).astype(np.uint8)
    return CameraFrame(
        t_ns=t_ns,
        sequence=0,
        width_px=WIDTH_PX,
        height_px=HEIGHT_PX,
        pitch_camera_rad=DOWN_RAD,
        exposure_s=0.004,
        pixels=np.repeat(noisy[:, :, None], 3, axis=2).tobytes(),
    )


PIXELS_PER_M = 2000


@pytest.fixture(scope="module")
def board() -> Grey:
    return painted_board(PIXELS_PER_M)


@pytest.mark.parametrize(
    ("height_m", "most_m"), [(0.2, 0.004), (0.5, 0.005), (1.0, 0.006), (2.0, 0.015), (5.0, 0.06), (8.0, 0.12)]
)
def test_the_vehicle_is_placed_over_a_painted_board(board: Grey, height_m: float, most_m: float) -> None:
    q, yaw_rad = quat_from_euler(0.04, -0.06, 0.9), 0.4
    pos_ned_m = (0.02 + 0.05 * height_m, -0.04 * height_m, -height_m)
    tags = Finder(CONFIG).find(photograph(board, PIXELS_PER_M, pos_ned_m, q, yaw_rad))
    found = locate(tags, CORNERS_M, view_of(q), CONFIG)
    assert found is not None
    error_m = np.abs(found[1].pos_uav_rel_rover_ned_m - pos_ned_m)
    assert error_m.max() < most_m
    assert found[1].yaw_rover_rad == pytest.approx(yaw_rad, abs=0.02)


def test_a_tag_that_is_hardly_told_from_the_noise_does_not_count(board: Grey) -> None:
    picture = photograph(board, PIXELS_PER_M, (0.1, 0.0, -2.0), quat_from_euler(0.0, 0.0, 0.0), 0.0)
    assert Finder(CONFIG).find(picture)
    assert not Finder(msgspec.structs.replace(CONFIG, margin_min=1000.0)).find(picture)


@pytest.mark.parametrize(("hamming", "counts"), [(0, True), (1, False)])
def test_a_tag_of_which_a_bit_was_corrected_does_not_count(hamming: int, counts: bool) -> None:
    corners = np.array(((100.0, 200.0), (200.0, 200.0), (200.0, 100.0), (100.0, 100.0)))
    found = SimpleNamespace(hamming=hamming, decision_margin=99.0, corners=corners, tag_id=BIG_ID)
    assert (Finder(CONFIG)._tag(found, black_picture()) is not None) is counts


def black_picture() -> CameraFrame:
    return photograph(np.zeros((8, 8), np.uint8), 8, (0.1, 0.0, -2.0), quat_from_euler(0.0, 0.0, 0.0), 0.0)


@pytest.mark.parametrize("margin_px", [2.0, 1.8])
@pytest.mark.parametrize("edge", ["left", "right", "top", "bottom"])
def test_a_tag_within_two_pixels_of_an_edge_of_the_picture_does_not_count(edge: str, margin_px: float) -> None:
    """The library's pixels begin half a pixel before ours."""
    square_px = np.array(((0.0, 50.0), (50.0, 50.0), (50.0, 0.0), (0.0, 0.0)))
    left_px = {"left": margin_px, "right": WIDTH_PX - 1 - 50.0 - margin_px}.get(edge, 100.0)
    top_px = {"top": margin_px, "bottom": HEIGHT_PX - 1 - 50.0 - margin_px}.get(edge, 100.0)
    corners_px = square_px + np.array((left_px + 0.5, top_px + 0.5))
    found = SimpleNamespace(hamming=0, decision_margin=99.0, corners=corners_px, tag_id=BIG_ID)
    assert (Finder(CONFIG)._tag(found, black_picture()) is not None) is (margin_px == 2.0)


def test_a_tag_that_touches_the_edge_of_the_picture_does_not_count(board: Grey) -> None:
    q = quat_from_euler(0.0, 0.0, 0.0)
    cut = photograph(board, PIXELS_PER_M, (0.7, 0.0, -1.5), q, 0.0)
    assert all(tag.tag_id != BIG_ID for tag in Finder(CONFIG).find(cut))


# -- time --


def odometry(t_s: float, q: Quat, epoch_id: int = 1, rates: Vec3 = (0.0, 0.0, 0.0)) -> Odometry:
    return Odometry(
        t_ns=round(t_s * NS_PER_S),
        epoch_id=epoch_id,
        pos_uav_ned_m=(0.0, 0.0, -3.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=q,
        rates_uav_frd_rps=rates,
    )


def test_an_attitude_is_turned_on_to_the_exposure_and_forgotten_with_its_epoch() -> None:
    attitudes = AttitudeHistory(0.06)
    assert attitudes.at(0) is None
    attitudes.add(odometry(1.0, quat_from_euler(0.0, 0.0, 0.0), rates=(0.5, 0.0, 0.0)))
    attitudes.add(odometry(1.1, quat_from_euler(0.05, 0.0, 0.0), rates=(0.5, 0.0, 0.0)))
    assert attitudes.at(round(1.08 * NS_PER_S)) == pytest.approx(quat_from_euler(0.04, 0.0, 0.0), abs=1e-9)
    assert attitudes.at(round(1.2 * NS_PER_S)) is None
    attitudes.add(odometry(1.12, quat_from_euler(0.0, 0.0, 0.0), epoch_id=2))
    assert attitudes.at(round(1.0 * NS_PER_S)) is None


@pytest.mark.parametrize(
    ("t_s", "roll_rad"), [(0.95, 0.1), (1.008, 0.1), (1.012, 0.2), (1.028, 0.2), (1.032, 0.3), (1.09, 0.3)]
)
def test_the_attitude_of_a_time_is_that_of_the_nearest_odometry(t_s: float, roll_rad: float) -> None:
    attitudes = AttitudeHistory(0.06)
    for i in range(3):
        attitudes.add(odometry(1.0 + 0.02 * i, quat_from_euler(0.1 * (i + 1), 0.0, 0.0)))
    assert attitudes.at(round(t_s * NS_PER_S)) == pytest.approx(quat_from_euler(roll_rad, 0.0, 0.0))


class Feeder:
    """Publishes what it is given at its times."""

    spec = Spec(
        name="feeder",
        outputs=(topics.ODOMETRY, topics.CAMERA_INFO, topics.TAG_CORNERS, topics.CAMERA),
        triggers=(),
        rate_hz=100.0,
    )

    def __init__(self, messages: Sequence[tuple[float, Topic[Any], Message]]) -> None:
        self._messages = list(messages)

    def step(self, t_ns: int, inbox: Inbox) -> list[Output]:
        due = [m for m in self._messages if m[0] * NS_PER_S <= t_ns]
        self._messages = [m for m in self._messages if m[0] * NS_PER_S > t_ns]
        return [Publish(topic, message) for _, topic, message in due]


def estimates_from(*messages: tuple[float, Topic[Any], Message]) -> list[TagEstimate]:
    """What a detector publishes for messages at their times in s."""
    bus, estimates = MemoryBus(delay=NO_DELAY), list[TagEstimate]()

    def observe(t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.ESTIMATE_TAG.name:
            estimates.append(decode(TagEstimate, data))

    bus.observe(observe)
    bus.add(TagDetector(CONFIG, VehicleConfig()))
    bus.add(Feeder(messages))
    bus.run_for(2.0)
    return estimates


def test_of_pictures_that_arrive_together_the_newest_is_used(board: Grey) -> None:
    level, places_ned_m = (1.0, 0.0, 0.0, 0.0), ((0.1, 0.0, -2.0), (-0.1, 0.0, -2.0), (0.0, 0.1, -2.0))
    pictures = [
        photograph(board, PIXELS_PER_M, pos_ned_m, level, 0.0, t_ns=NS_PER_S + 10_000_000 * i)
        for i, pos_ned_m in enumerate(places_ned_m)
    ]
    (found,) = estimates_from(
        (0.5, topics.CAMERA_INFO, INFO),
        (1.0, topics.ODOMETRY, odometry(1.0, level)),
        (1.03, topics.ODOMETRY, odometry(1.03, level)),
        *((1.05, topics.CAMERA, picture) for picture in pictures),
    )
    assert found.t_ns == pictures[-1].t_ns
    assert found.pos_uav_rel_rover_ned_m == pytest.approx(places_ned_m[-1], abs=0.02)
    assert 1 <= len(found.tag_ids) <= 8


def test_an_estimate_by_the_whole_board_names_eight_of_its_tags() -> None:
    level, pos_ned_m = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -2.0)
    tags = tuple(seen(sorted(CORNERS_M), pos_ned_m, level, 0.3))
    (found,) = estimates_from(
        (0.5, topics.CAMERA_INFO, INFO),
        (1.0, topics.ODOMETRY, odometry(1.0, level)),
        (1.0, topics.TAG_CORNERS, TagCorners(t_ns=NS_PER_S, pitch_camera_rad=DOWN_RAD, tags=tags)),
    )
    assert len(tags) == 26 and len(found.tag_ids) == 8


def test_the_estimate_is_that_of_the_exposure_with_the_attitude_of_that_time() -> None:
    then, later = quat_from_euler(0.1, 0.0, 0.2), quat_from_euler(-0.2, 0.0, 0.2)
    pos_ned_m = (0.2, -0.1, -3.0)
    corners = TagCorners(t_ns=NS_PER_S, pitch_camera_rad=DOWN_RAD, tags=tuple(seen([BIG_ID, 1], pos_ned_m, then, 0.3)))
    estimates = estimates_from(
        (0.5, topics.CAMERA_INFO, INFO),
        (1.0, topics.ODOMETRY, odometry(1.0, then)),
        (1.1, topics.ODOMETRY, odometry(1.1, later)),
        (1.1, topics.TAG_CORNERS, corners),
    )
    assert [message.t_ns for message in estimates] == [NS_PER_S]
    assert estimates[0].pos_uav_rel_rover_ned_m == pytest.approx(pos_ned_m, abs=1e-5)
    assert estimates[0].yaw_rover_rad == pytest.approx(0.3, abs=1e-5)
    assert estimates[0].tag_ids == (BIG_ID, 1)
    pos_camera_m = np.array(pos_ned_m) + np.array(quat_rotate(then, MOUNT_FRD_M))
    assert estimates[0].range_m == pytest.approx(float(np.linalg.norm(pos_camera_m)), abs=1e-5)


@pytest.mark.parametrize(
    ("what", "state", "words"),
    [
        ((), "degraded", "no pictures: is the camera running?"),
        (("corners",), "degraded", "no camera/info: the pictures can't be measured"),
        (("info", "corners"), "ok", "pictures, but no landing tag in view"),
        (("info", "tags"), "ok", "sees the landing board"),
    ],
)
def test_the_health_says_what_the_detector_lacks(what: tuple[str, ...], state: str, words: str) -> None:
    level, pos_ned_m = (1.0, 0.0, 0.0, 0.0), (0.2, -0.1, -3.0)
    tags = tuple(seen([BIG_ID, 1], pos_ned_m, level, 0.3)) if "tags" in what else ()
    messages: list[tuple[float, Topic[Any], Message]] = []
    for tenth in range(10, 40):
        t_s = 0.1 * tenth
        messages.append((t_s, topics.ODOMETRY, odometry(t_s, level)))
        if "info" in what:
            messages.append((t_s, topics.CAMERA_INFO, INFO))
        if len(what) > ("info" in what):
            corners = TagCorners(t_ns=round(t_s * NS_PER_S), pitch_camera_rad=DOWN_RAD, tags=tags)
            messages.append((t_s, topics.TAG_CORNERS, corners))
    bus = MemoryBus(delay=NO_DELAY)
    bus.add(TagDetector(CONFIG, VehicleConfig()))
    bus.add(Feeder(messages))
    bus.run_for(4.0)
    health = bus._ports["tag_detector"].node.health(0, 0.0, 0)
    assert (health.state, health.text) == (state, words)
