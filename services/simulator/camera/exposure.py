"""What the sensor adds to a picture: how far things move while it is exposed, and noise."""

import cv2
import numpy as np
import numpy.typing as npt

from jezero.schemas.sensors import CameraInfo
from jezero.services.simulator.camera.view import Array, View, half_tangents, project

Image = npt.NDArray[np.uint8]
POOL = 2_000_003
"""Noise is drawn once; each picture starts somewhere else in it."""
HEIGHT_MIN_M = 0.1


def moved_px(views: tuple[View, View, View], info: CameraInfo) -> float:
    """The longest way of anything at the ground's or the platform's distance across the picture during the exposure."""
    begin, middle, end = views
    eye = np.array(middle.pos_camera_ned_m)
    depth_m = max(middle.pos_rover_ned_m[2] - middle.pos_camera_ned_m[2], HEIGHT_MIN_M)
    across, along = half_tangents(info)
    rays = np.array([(0.0, 0.0, 1.0), *((a * across, b * along, 1.0) for a in (-1, 1) for b in (-1, 1))])
    points_m: Array = eye + depth_m * rays @ middle.rotation_ned_from_camera.T
    half_way_m = 0.5 * (np.array(end.pos_rover_ned_m) - np.array(begin.pos_rover_ned_m))
    ways = [
        project(points_m + moves_m, end, info) - project(points_m - moves_m, begin, info)
        for moves_m in (np.zeros(3), half_way_m)
    ]
    return float(np.nan_to_num(np.hypot(*np.concatenate(ways).T)).max())


class PixelNoise:
    """Normal noise on each colour of each pixel.

    Args:
        std: of 255.
    """

    def __init__(self, std: float, rng: np.random.Generator) -> None:
        self._rng = rng
        noise = np.round(std * rng.standard_normal(POOL, dtype=np.float32)) if std > 0.0 else None
        self._pool = None if noise is None else np.clip(noise, -127.0, 127.0).astype(np.int8)

    def add(self, picture: Image) -> Image:
        """A noisy copy."""
        if self._pool is None:
            return picture
        wanted = picture.size
        start = int(self._rng.integers(0, POOL - wanted)) if wanted < POOL else 0
        noise = np.resize(self._pool[start:], wanted).reshape(picture.shape)
        result = cv2.add(picture, noise, dtype=cv2.CV_8U)
        return np.asarray(result, dtype=np.uint8)
