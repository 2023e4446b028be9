"""Colour of the ground: two procedural textures over the simulator's own terrain.

The coarse one covers the whole terrain once, so that no two places are alike; the fine one, of sand, ripples and
pebbles with the shadows they throw, repeats at two scales that share no period.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import atan2, cos, hypot, radians, sin, tan

import cv2
import numpy as np
import numpy.typing as npt
import scipy.fft

from jezero.services.simulator.camera.sun import SUN_ELEVATION_DEG, TO_SUN_NED
from jezero.services.simulator.config import TerrainConfig
from jezero.services.simulator.noise import generator
from jezero.services.simulator.terrain import POINTS, SPACING_M, Terrain, make_terrain

Image = npt.NDArray[np.uint8]
Field = npt.NDArray[np.float32]

SIDE_M = POINTS * SPACING_M
"""Side of the coarse texture, which repeats beyond the terrain."""
COARSE_TEXELS = 1024
FINE_TEXELS = 1024
FINE_SIDE_M = 5.3
SAND = np.array((0.56, 0.41, 0.30), dtype=np.float32)
DUST = np.array((0.68, 0.51, 0.38), dtype=np.float32)
BASALT = np.array((0.38, 0.29, 0.24), dtype=np.float32)
"""Colours as roots of their reflectances, as the textures keep them."""


@dataclass(frozen=True)
class GroundTextures:
    """Rows to the north, columns to the east.

    Attributes:
        coarse: (1024, 1024, 3) colour, root of the reflectance.
        fine: (1024, 1024, 4) slope to the north and to the east (127.5 is level, 127 units are a slope of 1), factor
            on the colour (127.5 is 1), share of sunlight that reaches it.
    """

    coarse: Image
    fine: Image


@lru_cache(maxsize=2)
def ground_textures(config: TerrainConfig) -> GroundTextures:
    """The textures that belong to a terrain."""
    rng = generator(config.seed, "ground")
    return GroundTextures(_coarse(make_terrain(config), rng), _fine(rng))


def fractal(
    rng: np.random.Generator, texels: int, power: float, longest: float, shortest: float = 2.0, stretch: float = 1.0
) -> Field:
    """(texels, texels) periodic noise of unit variance.

    Args:
        power: amplitudes fall with this power of the wave number.
        longest: longest wavelength in texels.
        shortest: shortest wavelength in texels.
        stretch: factor by which the pattern is longer along the columns than across.
    """
    k_north = scipy.fft.fftfreq(texels).astype(np.float32)[:, None]
    k_east = scipy.fft.rfftfreq(texels).astype(np.float32)[None, :]
    k = np.hypot(k_north, stretch * k_east)
    weight = np.maximum(k, np.float32(1.0 / longest)) ** np.float32(-power) * (k < 1.0 / shortest)
    weight[0, 0] = 0.0
    white = scipy.fft.rfft2(rng.standard_normal((texels, texels), dtype=np.float32))
    field: Field = scipy.fft.irfft2(white * weight, s=(texels, texels), overwrite_x=True)
    field /= field.std()
    return field


def _coarse(terrain: Terrain, rng: np.random.Generator) -> Image:
    """Dust in the hollows, darker sand on rims, streaks along the wind, patches of bare rock."""
    n = COARSE_TEXELS
    heights = np.asarray(terrain.heights_m, dtype=np.float32)
    relief = cv2.resize(heights - cv2.blur(heights, (7, 7)), (n, n), interpolation=cv2.INTER_LINEAR)
    dusty = 0.5 + 0.26 * fractal(rng, n, 1.5, 250.0) - 9.0 * relief + 0.16 * fractal(rng, n, 0.9, 60.0, stretch=7.0)
    bare = np.clip(0.42 * fractal(rng, n, 1.2, 90.0) - 0.45, 0.0, 0.75)[..., None]
    colour = SAND + np.clip(dusty, 0.0, 1.0)[..., None] * (DUST - SAND)
    colour += bare * (BASALT - colour)
    image: Image = np.clip(255.0 * colour, 0.0, 255.0).astype(np.uint8)
    return image


def _fine(rng: np.random.Generator) -> Image:
    n = FINE_TEXELS
    texel_m = FINE_SIDE_M / n
    height_m = 0.0035 * fractal(rng, n, 1.7, 200.0) + 0.0008 * fractal(rng, n, 0.7, 12.0)
    height_m += _ripples(rng, n)
    tone = 1.0 + 0.05 * fractal(rng, n, 0.5, 30.0)
    _scatter_pebbles(rng, height_m, tone, texel_m)
    slope_north = (np.roll(height_m, -1, 0) - np.roll(height_m, 1, 0)) / (2.0 * texel_m)
    slope_east = (np.roll(height_m, -1, 1) - np.roll(height_m, 1, 1)) / (2.0 * texel_m)
    lit = _sunlit(height_m, texel_m)
    channels = (127.5 + 127.0 * slope_north, 127.5 + 127.0 * slope_east, 127.5 * tone, 255.0 * lit)
    return np.clip(np.stack(channels, axis=-1), 0.0, 255.0).astype(np.uint8)


def _ripples(rng: np.random.Generator, n: int) -> Field:
    """Wind ripples in patches, 17 to the side of the tile."""
    north, east = np.meshgrid(np.arange(n) / n, np.arange(n) / n, indexing="ij")
    phase = 2.0 * np.pi * (14.0 * north + 9.0 * east) + 2.2 * fractal(rng, n, 2.2, 300.0)
    patches = np.clip(0.6 * fractal(rng, n, 2.0, 400.0), 0.0, 1.0)
    ripples: Field = (0.004 * patches * np.sin(phase)).astype(np.float32)
    return ripples


def _scatter_pebbles(rng: np.random.Generator, height_m: Field, tone: Field, texel_m: float) -> None:
    """Flat, half buried stones of 0.6 to 6 cm; small ones are more frequent."""
    n = len(height_m)
    for radius_m in 0.006 * (1.0 - rng.random(2600)) ** -0.62:
        if radius_m > 0.06:
            continue
        middle = rng.random(2) * n
        aspect, turn_rad = rng.uniform(0.6, 1.0), rng.uniform(0.0, np.pi)
        reach = int(radius_m / texel_m) + 2
        rows = np.arange(int(middle[0]) - reach, int(middle[0]) + reach + 1)
        columns = np.arange(int(middle[1]) - reach, int(middle[1]) + reach + 1)
        dr, dc = (rows - middle[0])[:, None] * texel_m, (columns - middle[1])[None, :] * texel_m
        along = (cos(turn_rad) * dr + sin(turn_rad) * dc) / radius_m
        across = (cos(turn_rad) * dc - sin(turn_rad) * dr) / (aspect * radius_m)
        lump = 1.0 - along**2 - across**2 - rng.uniform(-0.4, 0.4) * along * across
        window = np.ix_(rows % n, columns % n)
        stone = lump > 0.0
        top_m = 0.5 * radius_m * aspect * np.maximum(lump, 0.0) ** 0.6
        height_m[window] = np.where(stone, height_m[window] + top_m, height_m[window])
        tone[window] = np.where(stone, tone[window] * rng.uniform(0.78, 1.18), tone[window])


def _sunlit(height_m: Field, texel_m: float) -> Field:
    """1 in the sun, 0.25 where something towards the sun is higher than the ray, softened."""
    towards = atan2(TO_SUN_NED[1], TO_SUN_NED[0])
    rise_m = texel_m * tan(radians(SUN_ELEVATION_DEG))
    shade = np.zeros_like(height_m)
    for step in range(1, 14):
        shift = (-round(step * cos(towards)), -round(step * sin(towards)))
        ray_m = height_m + rise_m * hypot(*shift)
        shade = np.maximum(shade, np.clip((np.roll(height_m, shift, (0, 1)) - ray_m) / (0.5 * rise_m), 0.0, 1.0))
    lit: Field = 1.0 - 0.8 * shade
    return lit
