"""4 x 4 matrices of the renderer, for column vectors. In clip space y goes down, as rows do: nothing is flipped."""

import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import Quat, Vec3, quat_rotate
from jezero.schemas.sensors import CameraInfo
from jezero.services.simulator.camera.view import CameraView


def clip_from_camera(info: CameraInfo, near_m: float, far_m: float) -> Array:
    """The pinhole: right, down, forward to clip space."""
    a = (far_m + near_m) / (far_m - near_m)
    b = -2.0 * far_m * near_m / (far_m - near_m)
    across, along = 2.0 * info.focal_px / info.width_px, 2.0 * info.focal_px / info.height_px
    return np.array(((across, 0, 0, 0), (0, along, 0, 0), (0, 0, a, b), (0, 0, 1, 0)), dtype=np.float64)


def camera_from_ned(view: CameraView) -> Array:
    """Transformation from the map into the camera's axes."""
    rotation = view.rotation_ned_from_camera.T
    return _rigid(rotation, -rotation @ np.array(view.pos_camera_ned_m))


def clip_from_above(middle_ned_m: Vec3, half_north_m: float, half_east_m: float) -> Array:
    """The map without perspective, north at the top; within 100 m of the middle's height."""
    north, east, down = middle_ned_m
    return np.array(
        (
            (0, 1 / half_east_m, 0, -east / half_east_m),
            (-1 / half_north_m, 0, 0, north / half_north_m),
            (0, 0, 0.01, -0.01 * down),
            (0, 0, 0, 1),
        ),
        dtype=np.float64,
    )


def clip_from_sun(to_sun_ned: Vec3, middle_ned_m: Vec3, reach_m: float, depth_m: float) -> Array:
    """The view from the sun within `reach_m` of a point, without perspective."""
    forward = -np.array(to_sun_ned)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    scale = np.diag((1.0 / reach_m, 1.0 / reach_m, 1.0 / depth_m, 1.0))
    result: Array = scale @ _rigid(rotation, -rotation @ np.array(middle_ned_m))
    return result


def ned_from_rover_body(view: CameraView) -> Array:
    return ned_from_frd(view.pos_rover_ned_m, view.q_ned_from_rover_body)


def ned_from_frd(pos_ned_m: Vec3, q_ned_from_frd: Quat) -> Array:
    axes = [quat_rotate(q_ned_from_frd, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    return _rigid(np.array(axes).T, np.array(pos_ned_m))


def _rigid(rotation: Array, translation: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix
