"""Pose of the camera, and projection of points into its picture."""

from dataclasses import dataclass, replace

import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    frd_from_camera,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    scale,
    subtract,
)
from jezero.base.lens import distort
from jezero.schemas.sensors import CameraInfo
from jezero.schemas.state import Scene

NEAREST_M = 1e-3
"""Points nearer to the camera's plane than this, or behind it, are not in the picture."""


@dataclass(frozen=True)
class CameraView:
    """The camera and the rover's platform at one instant, in the map.

    Attributes:
        axes_camera_ned: the camera's right, down and forward axes: the columns of R_ned_from_camera.
        q_ned_from_rover_body: attitude of the platform.
    """

    pos_camera_ned_m: Vec3
    axes_camera_ned: tuple[Vec3, Vec3, Vec3]
    pos_rover_ned_m: Vec3
    q_ned_from_rover_body: Quat

    @property
    def rotation_ned_from_camera(self) -> Array:
        """(3, 3)"""
        return np.array(self.axes_camera_ned).T

    def ned_from_rover_body(self, point_rover_body_m: Vec3) -> Vec3:
        """A point of the rover in the map."""
        return add(self.pos_rover_ned_m, quat_rotate(self.q_ned_from_rover_body, point_rover_body_m))

    def rover_body_from_ned(self, point_ned_m: Vec3) -> Vec3:
        """A point of the map relative to the rover."""
        return quat_rotate(quat_conjugate(self.q_ned_from_rover_body), subtract(point_ned_m, self.pos_rover_ned_m))


def view_of(
    scene: Scene,
    pos_camera_frd_m: Vec3,
    axes_rad: tuple[float, float],
    rates_rps: tuple[float, float] = (0.0, 0.0),
    ahead_s: float = 0.0,
    turn_camera_rad: float = 0.0,
) -> CameraView:
    """The view at an exposure's middle, or a moment `ahead_s` after it, by the velocities and rates of the scene.

    Args:
        axes_rad, rates_rps: pitch and roll of the camera, and how fast they turn.
        turn_camera_rad: how far the camera is turned about its optical axis.
    """
    turned = quat_from_rotation_vector(scale(scene.rates_uav_frd_rps, ahead_s))
    q_ned_from_frd = quat_normalize(quat_multiply(scene.q_ned_from_frd, turned))
    pitch_rad, roll_rad = (
        angle_rad + rate_rps * ahead_s for angle_rad, rate_rps in zip(axes_rad, rates_rps, strict=True)
    )
    right, down, forward = (
        quat_rotate(q_ned_from_frd, frd_from_camera(axis, pitch_rad, roll_rad, turn_camera_rad))
        for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    )
    pos_uav_ned_m = add(scene.pos_uav_ned_m, scale(scene.vel_uav_ned_mps, ahead_s))
    return CameraView(
        pos_camera_ned_m=add(pos_uav_ned_m, quat_rotate(q_ned_from_frd, pos_camera_frd_m)),
        axes_camera_ned=(right, down, forward),
        pos_rover_ned_m=add(scene.pos_rover_ned_m, scale(scene.vel_rover_ned_mps, ahead_s)),
        q_ned_from_rover_body=quat_from_euler(scene.roll_rover_rad, scene.pitch_rover_rad, scene.yaw_rover_rad),
    )


def on_rover(view: CameraView) -> CameraView:
    """The same view with everything relative to the rover: its frame is then `rover_body`."""
    turn = quat_conjugate(view.q_ned_from_rover_body)
    right, down, forward = (quat_rotate(turn, axis) for axis in view.axes_camera_ned)
    return replace(
        view,
        pos_camera_ned_m=view.rover_body_from_ned(view.pos_camera_ned_m),
        axes_camera_ned=(right, down, forward),
        pos_rover_ned_m=(0.0, 0.0, 0.0),
        q_ned_from_rover_body=(1.0, 0.0, 0.0, 0.0),
    )


def half_tangents(info: CameraInfo) -> tuple[float, float]:
    """Half of the picture's width and height at a distance of one."""
    return 0.5 * info.width_px / info.focal_px, 0.5 * info.height_px / info.focal_px


def project(points_m: Array, view: CameraView, info: CameraInfo) -> Array:
    """Places in the picture of points in the view's frame.

    Args:
        points_m: (..., 3).
    Returns:
        (..., 2) x to the right and y down in pixels, NaN for points that are not in front of the camera, or too far
        aside for its lens.
    """
    in_camera = (points_m - np.array(view.pos_camera_ned_m)) @ view.rotation_ned_from_camera
    depth_m = in_camera[..., 2:]
    depth_m = np.where(depth_m > NEAREST_M, depth_m, np.nan)
    seen = distort(in_camera[..., :2] / depth_m, info.distortion, info.aspect)
    pixels: Array = info.focal_px * seen + np.array(info.center_px)
    return pixels
