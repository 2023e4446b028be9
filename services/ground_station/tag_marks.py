"""Where the detected tags are in an image: their corners, projected by the pose that the detector found."""

from collections.abc import Iterable

import numpy as np

from jezero.frames import (
    Quat,
    Vec3,
    add,
    q_frd_from_camera,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    rotate_yaw,
    subtract,
)
from jezero.lens import distort
from jezero.schemas.estimate import TagEstimate
from jezero.schemas.landing_board import BoardTag
from jezero.vehicle_config import CameraMountConfig

RANGE_MIN_M = 0.02
Pixel = tuple[float, float]


def tag_outlines(
    estimate: TagEstimate,
    yaw_rover_rad: float,
    q_ned_from_frd: Quat,
    angles_rad: tuple[float, float],
    camera: CameraMountConfig,
    board: Iterable[BoardTag],
) -> list[list[Pixel]]:
    """Corners of each detected tag in the image, (x, y) in pixels.

    Args:
        estimate: the detector's pose, of the time of the image.
        yaw_rover_rad: heading of the platform, which is taken as level.
        q_ned_from_frd: attitude of the vehicle at the time of the image.
        angles_rad: pitch and roll of the camera in the image.
        camera: optics and mounting of the camera.
        board: all tags of the platform.

    Returns:
        A list of four corners for each tag that is in front of the camera as a whole.
    """
    q_ned_from_camera = quat_multiply(q_ned_from_frd, q_frd_from_camera(*angles_rad, camera.turn_rad))
    pos_camera_m = add(estimate.pos_uav_rel_rover_ned_m, quat_rotate(q_ned_from_frd, camera.pos_camera_frd_m))
    outlines = []
    for tag in board:
        if tag.tag_id not in estimate.tag_ids:
            continue
        corners = [
            _pixel(subtract(rotate_yaw(corner_m, yaw_rover_rad), pos_camera_m), q_ned_from_camera, camera)
            for corner_m in tag.corners_rover_body_m
        ]
        seen = [corner for corner in corners if corner is not None]
        if len(seen) == len(corners):
            outlines.append(seen)
    return outlines


def _pixel(ray_ned_m: Vec3, q_ned_from_camera: Quat, camera: CameraMountConfig) -> Pixel | None:
    """Pixel of a point relative to the camera; None for one behind it or outside what the lens shows."""
    right_m, down_m, forward_m = quat_rotate(quat_conjugate(q_ned_from_camera), ray_ned_m)
    if forward_m < RANGE_MIN_M:
        return None
    x, y = distort(np.array([right_m / forward_m, down_m / forward_m]), camera.distortion)
    if not (np.isfinite(x) and np.isfinite(y)):
        return None
    center_x, center_y = camera.center_px
    return float(center_x + camera.focal_px * x), float(center_y + camera.focal_px * y)
