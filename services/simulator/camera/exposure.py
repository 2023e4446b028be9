"""Motion blur and noise of the image sensor."""

import cv2
import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.schemas.sensors import CameraInfo
from jezero.services.simulator.camera.view import CameraView, half_tangents, project

Image = npt.NDArray[np.uint8]
POOL = 2_000_003
"""Values of noise that are drawn once; each picture uses a part with another start."""
HEIGHT_MIN_M = 0.1


def moved_px(views: tuple[CameraView, CameraView, CameraView], info: CameraInfo) -> float:
    """Greatest motion in the picture during the exposure, of points at the distance of the ground or the platform."""
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
        std: standard deviation, of 255.
    """

    def __init__(self, std: float, rng: np.random.Generator) -> None:
        self._rng = rng
        noise = np.round(std * rng.standard_normal(POOL, dtype=np.float32)) if std > 0.0 else None
        self._pool = None if noise is None else np.clip(noise, -127.0, 127.0).astype(np.int8)

    def add(self, picture: Image) -> Image:
        """A noisy copy."""
        if self._pool is None:
            return picture
        size = picture.size
        start = int(self._rng.integers(0, POOL - size)) if size < POOL else 0
        noise = np.resize(self._pool[start:], size).reshape(picture.shape)
        result = cv2.add(picture, noise, dtype=cv2.CV_8U)
        return np.asarray(result, dtype=np.uint8)
