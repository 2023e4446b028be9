"""The simulated ground from straight above, for maps to be compared with."""

import numpy as np

from jezero.base.vehicle_config import VehicleConfig
from jezero.services.simulator.camera.egl_renderer import EglRenderer
from jezero.services.simulator.camera.exposure import Image, PixelNoise
from jezero.services.simulator.config import TerrainConfig

TILE_TEXELS = 1024


def make_orthophoto(
    terrain: TerrainConfig,
    vehicle: VehicleConfig,
    middle_m: tuple[float, float],
    side_m: float,
    m_per_texel: float,
) -> Image:
    """A square of the ground without vehicle and rover, in the sunlight of the camera's pictures, without noise.

    Args:
        middle_m: north and east in the simulator's map.
    Returns:
        (n, n, 3) red, green, blue; rows from the north, columns from the west, n = side_m / m_per_texel.

    Raises:
        NoEglError: there is no OpenGL.
    """
    renderer = EglRenderer(terrain, vehicle, PixelNoise(0.0, np.random.default_rng(0)))
    texels = max(1, round(side_m / m_per_texel))
    picture = np.empty((texels, texels, 3), dtype=np.uint8)
    corner_north_m, corner_west_m = middle_m[0] + 0.5 * side_m, middle_m[1] - 0.5 * side_m
    tile_m = TILE_TEXELS * m_per_texel
    for row in range(0, texels, TILE_TEXELS):
        for column in range(0, texels, TILE_TEXELS):
            north_m = corner_north_m - row * m_per_texel - 0.5 * tile_m
            east_m = corner_west_m + column * m_per_texel + 0.5 * tile_m
            tile = renderer.orthophoto((north_m, east_m, 0.0), tile_m, TILE_TEXELS)
            part = picture[row : row + TILE_TEXELS, column : column + TILE_TEXELS]
            part[:] = tile[: part.shape[0], : part.shape[1]]
    return picture
