"""Pictures through a lens that distorts: the picture of a wider pinhole, moved pixel by pixel."""

from math import atan, degrees

import cv2
import msgspec
import numpy as np

from jezero.base.arrays import Array
from jezero.base.config import ConfigError
from jezero.base.lens import undistort
from jezero.base.vehicle_config import CameraMountConfig
from jezero.schemas.sensors import NO_DISTORTION
from jezero.schemas.state import Scene
from jezero.services.simulator.camera.service import Renderer
from jezero.services.simulator.camera.view import CameraView

ANGLE_MAX_DEG = 150.0
"""Largest angle of view of the picture that is bent through the lens: in a wider one most pixels are at the edge."""


def pinhole_behind(camera: CameraMountConfig) -> CameraMountConfig:
    """A camera without distortion whose picture contains all that the distorting one sees.

    Raises:
        ConfigError: the lens shows more than a pinhole can.
    """
    reach = np.abs(_ideal_points(camera)).reshape(-1, 2).max(axis=0)
    half = max(float(reach[0]), float(reach[1]) * camera.width_px / camera.height_px)
    angle_deg = degrees(2.0 * atan(half))
    if not angle_deg <= ANGLE_MAX_DEG:  # NaN, where a corner of the image is beyond 90 degrees from the axis
        raise ConfigError(
            f"the camera of vehicle.toml sees more than {ANGLE_MAX_DEG:g} degrees across, which the simulated camera "
            'can\'t render: set mode = "projected" in camera.toml, or another lens for the simulation'
        )
    none = dict.fromkeys(("fx_px", "fy_px", "cx_px", "cy_px"))
    return msgspec.structs.replace(
        camera, field_of_view_deg=angle_deg, distortion_model="plumb_bob", distortion=NO_DISTORTION, **none
    )


class LensRenderer:
    """Renders with a wider pinhole and moves each pixel to where the lens puts it.

    Args:
        pinhole: renderer of `wide`.
        camera: the camera with its distortion.
        wide: result of `pinhole_behind`.

    Attributes:
        description: name of the renderer, for people.
        rate_max_hz: greatest number of pictures per second.
    """

    def __init__(self, pinhole: Renderer, camera: CameraMountConfig, wide: CameraMountConfig) -> None:
        self._pinhole = pinhole
        self._size_px = (camera.width_px, camera.height_px)
        places_px = wide.focal_px * _ideal_points(camera) + np.array(wide.center_px)
        self._columns_px, self._rows_px = places_px[..., 0].astype(np.float32), places_px[..., 1].astype(np.float32)
        self.description = f"{pinhole.description}, through a lens with distortion"
        self.rate_max_hz = pinhole.rate_max_hz

    def picture(self, scene: Scene, views: tuple[CameraView, CameraView, CameraView]) -> bytes:
        """The picture of a scene, as the renderer's own."""
        width_px, height_px = self._size_px
        pixels = np.frombuffer(self._pinhole.picture(scene, views), np.uint8).reshape(height_px, width_px, 3)
        return cv2.remap(pixels, self._columns_px, self._rows_px, cv2.INTER_LINEAR).tobytes()


def _ideal_points(camera: CameraMountConfig) -> Array:
    """(height, width, 2) points of the ideal image, at unit distance, that each pixel shows."""
    columns_px, rows_px = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    pixels = np.stack((columns_px, rows_px), axis=-1)
    return undistort((pixels - np.array(camera.center_px)) / camera.focal_px, camera.distortion, camera.aspect)
