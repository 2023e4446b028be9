"""Relative position of the vehicle and the platform from the corners of tags.

The rotation of a tag right below the camera is weakly observable and flips between two solutions. So roll and pitch are
the vehicle's and, for the platform, the rover's, and four unknowns are left: the relative position and the platform's
heading.
"""

from dataclasses import dataclass

import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import Quat, frd_from_camera, quat_rotate
from jezero.base.lens import undistort
from jezero.schemas.sensors import CameraInfo, Distortion

ITERATIONS = 4
CONVERGED = 1e-6
"""Gauss–Newton stops at a step of this size, in metres and radians: the remaining error is far smaller."""
RAY_DOWN_MIN = 0.05
"""A ray that descends less than this per unit of length points to the horizon, not to the platform."""


@dataclass(frozen=True)
class TagView:
    """Intrinsics and pose of the camera at an exposure.

    Attributes:
        focal_px: focal length.
        center_px: principal point.
        R_ned_from_camera: (3, 3) rotation.
        pos_camera_uav_ned_m: (3,) from the vehicle to the optical centre.
        distortion: the lens' coefficients.
        aspect: focal length down the image by that across it.
    """

    focal_px: float
    center_px: tuple[float, float]
    R_ned_from_camera: Array
    pos_camera_uav_ned_m: Array
    distortion: Distortion
    aspect: float = 1.0

    def ideal_px(self, corners_px: Array) -> Array:
        """Where (n, 2) corners would be in the image of a lens without distortion."""
        center_px = np.array(self.center_px)
        seen = (corners_px - center_px) / self.focal_px
        ideal: Array = self.focal_px * undistort(seen, self.distortion, self.aspect) + center_px
        return ideal


def make_view(info: CameraInfo, pitch_camera_rad: float, q_ned_from_frd: Quat, roll_camera_rad: float = 0.0) -> TagView:
    """The view of a camera on its axes under a vehicle of that attitude."""
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    columns = [
        quat_rotate(q_ned_from_frd, frd_from_camera(axis, pitch_camera_rad, roll_camera_rad, info.turn_camera_rad))
        for axis in axes
    ]
    mount_ned_m = np.array(quat_rotate(q_ned_from_frd, info.pos_camera_frd_m))
    return TagView(info.focal_px, info.center_px, np.array(columns).T, mount_ned_m, info.distortion, info.aspect)


@dataclass(frozen=True)
class TagPose:
    """Solution for the corners of one picture.

    Attributes:
        pos_uav_rel_rover_ned_m: (3,) vehicle minus platform.
        yaw_rover_rad: heading of the platform.
        inverse_normal: (4, 4) covariance of (position, heading) for corners with an error of one pixel.
        residuals_px: (n, 2) observed minus expected corners.
    """

    pos_uav_rel_rover_ned_m: Array
    yaw_rover_rad: float
    inverse_normal: Array
    residuals_px: Array


def solve(points_level_m: Array, corners_px: Array, view: TagView) -> TagPose | None:
    """Least squares over the reprojected corners; None when they can't be points of a platform below.

    Args:
        points_level_m: (n, 3) corners on the platform in level axes with its heading, n >= 4, not all on one line.
        corners_px: (n, 2) the same corners in the picture.
    """
    start = _closed_form(points_level_m, corners_px, view)
    if start is None:
        return None
    pos_camera_m, yaw_rad = start
    jacobian, residuals_px = np.zeros((0, 4)), corners_px
    for _ in range(ITERATIONS):
        linear = _linearize(points_level_m, corners_px, view, pos_camera_m, yaw_rad)
        if linear is None:
            return None
        jacobian, residuals_px = linear
        change = np.linalg.lstsq(jacobian, residuals_px.ravel(), rcond=None)[0]
        pos_camera_m = pos_camera_m + change[:3]
        yaw_rad += float(change[3])
        if np.abs(change).max() < CONVERGED:
            break
    linear = _linearize(points_level_m, corners_px, view, pos_camera_m, yaw_rad)
    if linear is None:
        return None
    jacobian, residuals_px = linear
    normal = jacobian.T @ jacobian
    if np.linalg.cond(normal) > 1e12:
        return None
    yaw_rad = float((yaw_rad + np.pi) % (2.0 * np.pi) - np.pi)
    inverse = np.linalg.inv(normal).astype(np.float64)
    return TagPose(pos_camera_m - view.pos_camera_uav_ned_m, yaw_rad, inverse, residuals_px)


def _closed_form(points_level_m: Array, corners_px: Array, view: TagView) -> tuple[Array, float] | None:
    """Camera over the platform and the platform's heading: a similarity in the plane, in complex numbers.

    With rays (u, 1) down to the level platform, h u + c = exp(i yaw) b for every corner b: linear in h exp(-i yaw).
    """
    offsets = (corners_px - np.array(view.center_px)) / view.focal_px
    rays_ned = np.column_stack((offsets, np.ones(len(offsets)))) @ view.R_ned_from_camera.T
    if (rays_ned[:, 2] < RAY_DOWN_MIN * np.linalg.norm(rays_ned, axis=1)).any():
        return None
    u = (rays_ned[:, 0] + 1j * rays_ned[:, 1]) / rays_ned[:, 2]
    b = points_level_m[:, 0] + 1j * points_level_m[:, 1]
    u_mean, b_mean = u.mean(), b.mean()
    spread = float(np.sum(np.abs(u - u_mean) ** 2))
    if spread < 1e-12:
        return None
    a = np.sum(np.conj(u - u_mean) * (b - b_mean)) / spread
    height_m, yaw_rad = abs(a), -float(np.angle(a))
    c = np.exp(1j * yaw_rad) * b_mean - height_m * u_mean
    return np.array((c.real, c.imag, points_level_m[:, 2].mean() - height_m)), yaw_rad


def _linearize(
    points_level_m: Array, corners_px: Array, view: TagView, pos_camera_m: Array, yaw_rad: float
) -> tuple[Array, Array] | None:
    """(2n, 4) derivative of the corners by (camera's position, heading), and (n, 2) observed minus expected."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    turn_rate = np.array(((-s, -c, 0.0), (c, -s, 0.0), (0.0, 0.0, 0.0)))
    R_camera_from_ned = view.R_ned_from_camera.T
    x, y, z = ((points_level_m @ turn.T - pos_camera_m) @ R_camera_from_ned.T).T
    if (z < 1e-3).any():
        return None
    f = view.focal_px
    residuals_px = corners_px - np.column_stack((f * x / z, f * y / z)) - np.array(view.center_px)
    by_camera = np.zeros((len(x), 2, 3))
    by_camera[:, 0, 0] = by_camera[:, 1, 1] = f / z
    by_camera[:, 0, 2] = -f * x / z**2
    by_camera[:, 1, 2] = -f * y / z**2
    moved = points_level_m @ turn_rate.T @ R_camera_from_ned.T
    jacobian = np.empty((len(x), 2, 4))
    jacobian[:, :, :3] = -by_camera @ R_camera_from_ned
    jacobian[:, :, 3] = np.einsum("nij,nj->ni", by_camera, moved)
    return jacobian.reshape(-1, 4), residuals_px
