"""Mars-like ground from a seed, fractal hills, eroded craters and rocks; or that of a real place, from a file.

Heights are positive up, over a square grid whose middle is the map's origin. The hills stay within
+-0.48 m and below 4.8 degrees; it is level around the origin and at the grid's edge. Rocks lie on top.
"""

from dataclasses import dataclass
from functools import cached_property
from math import cos, floor, pi, radians, sin, sqrt, tan
from typing import Any

import numpy as np
import numpy.typing as npt

from jezero.base.config import ConfigError
from jezero.base.frames import Vec3
from jezero.schemas.terrain import Ground, Obstacle, Rock
from jezero.services.simulator.config import TerrainConfig
from jezero.services.simulator.heights import read_heights
from jezero.services.simulator.noise import generator

Field = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

POINTS = 256
SPACING_M = 0.5
HALF_SIDE_M = 0.5 * (POINTS - 1) * SPACING_M
HEIGHT_MAX_M = 0.48
SLOPE_MAX = tan(radians(4.8))
LEVEL_RADIUS_M = 1.5
LEVEL_BLEND_M = 6.0
EDGE_BLEND_M = 12.0
CLEAR_OF_ROCKS_M = 8.0
HILLSIDE_HALF_M = 15.0
PIER_RADIUS_M = 1.0
WAVELENGTH_MAX_M = 60.0
FILE_HEIGHT_MAX_M = 50.0

_G = 0.5 * (1.0 + sqrt(5.0))
ICOSAHEDRON: Field = np.array(
    [
        (-1, _G, 0), (1, _G, 0), (-1, -_G, 0), (1, -_G, 0), (0, -1, _G), (0, 1, _G),
        (0, -1, -_G), (0, 1, -_G), (_G, 0, -1), (_G, 0, 1), (-_G, 0, -1), (-_G, 0, 1),
    ]
) / sqrt(1.0 + _G * _G)  # fmt: skip
"""(12, 3) corners at unit distance."""
ICOSAHEDRON_FACES = (
    (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
    (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7),
    (9, 8, 1),
)  # fmt: skip


@dataclass(frozen=True)
class Terrain:
    """The ground in the map.

    Attributes:
        heights_m: (256, 256), rows to the north, columns to the east, positive up.
        rock_vertices_ned_m: (N, 3) corners of all rocks.
        rock_faces: (M, 3) indices of the triangles' corners, counter-clockwise from outside.
    """

    heights_m: Field
    rock_vertices_ned_m: Field
    rock_faces: Indices

    def height_m(self, north_m: float, east_m: float) -> float:
        """Ground without rocks, bilinear; 0 beyond the grid."""
        row = (north_m + HALF_SIDE_M) / SPACING_M
        column = (east_m + HALF_SIDE_M) / SPACING_M
        i, j = floor(row), floor(column)
        if not (0 <= i < POINTS - 1 and 0 <= j < POINTS - 1):
            return 0.0
        a, b = row - i, column - j
        h = self.heights_m
        south = (1.0 - b) * float(h[i, j]) + b * float(h[i, j + 1])
        north = (1.0 - b) * float(h[i + 1, j]) + b * float(h[i + 1, j + 1])
        return (1.0 - a) * south + a * north

    def height_of_wheel_m(self, north_m: float, east_m: float, radius_m: float) -> float:
        """Height of the lowest point of a wheel that stands on the ground or on a rock.

        The wheel is a ball, and so are the rocks.

        Args:
            radius_m: radius of the wheel.
        """
        ground_m = self.height_m(north_m, east_m)
        middles_ned_m, radii_m = self.rock_balls
        reach_m = radii_m + radius_m
        squares_m2 = reach_m**2 - (middles_ned_m[:, 0] - north_m) ** 2 - (middles_ned_m[:, 1] - east_m) ** 2
        touched = squares_m2 > 0.0
        if not touched.any():
            return ground_m
        on_rocks_m = np.sqrt(squares_m2[touched]) - middles_ned_m[touched, 2] - radius_m
        return max(ground_m, float(on_rocks_m.max()))

    @cached_property
    def rock_balls(self) -> tuple[Field, Field]:
        """(N, 3) middles of the rocks in NED and (N,) radii, as if they were balls."""
        corners_m = self.rock_vertices_ned_m.reshape(-1, len(ICOSAHEDRON), 3)
        middles_m: Field = corners_m.mean(axis=1)
        radii_m: Field = np.linalg.norm(corners_m - middles_m[:, None], axis=2).mean(axis=1)
        return middles_m, radii_m


def make_terrain(config: TerrainConfig) -> Terrain:
    """The ground that belongs to the settings.

    Raises:
        ConfigError: the file with its heights can't be used.
    """
    rng = generator(config.seed, "terrain")
    axis_m = np.linspace(-HALF_SIDE_M, HALF_SIDE_M, POINTS)
    north_m, east_m = np.meshgrid(axis_m, axis_m, indexing="ij")
    to_edge_m = HALF_SIDE_M - np.maximum(np.abs(north_m), np.abs(east_m))
    if config.heights:
        heights_m = read_heights(config.heights, (config.heights_north_m, config.heights_east_m), axis_m)
        heights_m *= _smooth_step(to_edge_m / EDGE_BLEND_M)
        if (highest_m := float(np.abs(heights_m).max())) > FILE_HEIGHT_MAX_M:
            raise ConfigError(
                f"heights in simulator.toml: the ground differs by {highest_m:.0f} m from that at the start, and "
                f"{FILE_HEIGHT_MAX_M:g} m are the most: change heights_north_m and heights_east_m"
            )
    else:
        heights_m = _procedural(config, rng, north_m, east_m, to_edge_m)
    heights_m += _hillside(config, north_m, east_m, to_edge_m)
    if config.basin_radius_m:
        heights_m += _basin(config, north_m, east_m) * _smooth_step(to_edge_m / EDGE_BLEND_M)
    heights_m -= np.where(np.hypot(north_m, east_m) > PIER_RADIUS_M, config.water_depth_m, 0.0)
    bare = Terrain(heights_m, np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    rocks = [_rock(rng, config, bare) for _ in range(config.rocks)]
    if not rocks:
        return bare
    faces = np.array([[12 * i + corner for corner in face] for i in range(len(rocks)) for face in ICOSAHEDRON_FACES])
    return Terrain(heights_m, np.concatenate(rocks), faces)


def _procedural(
    config: TerrainConfig, rng: np.random.Generator, north_m: Field, east_m: Field, to_edge_m: Field
) -> Field:
    """Hills and craters, within the limits of height and slope."""
    heights_m = config.std_ground_m * _fractal(rng)
    for _ in range(config.craters):
        heights_m += _crater(rng, config, north_m, east_m)
    level = heights_m[POINTS // 2 - 1 : POINTS // 2 + 1, POINTS // 2 - 1 : POINTS // 2 + 1].mean()
    distance_m = np.hypot(north_m, east_m)
    heights_m = (heights_m - level) * _smooth_step((distance_m - LEVEL_RADIUS_M) / LEVEL_BLEND_M)
    heights_m *= _smooth_step(to_edge_m / EDGE_BLEND_M)
    heights_m *= min(
        1.0,
        HEIGHT_MAX_M / max(float(np.abs(heights_m).max()), 1e-9),
        SLOPE_MAX / max(steepest(heights_m), 1e-9),
    )
    result: Field = heights_m
    return result


def _basin(config: TerrainConfig, north_m: Field, east_m: Field) -> Field:
    """A crater at one place: a parabolic bowl of 11 degrees on average, whose rim falls off outside."""
    radius_m = config.basin_radius_m
    depth_m, rim_m = 0.16 * radius_m, 0.04 * radius_m
    r = np.hypot(north_m - config.basin_north_m, east_m - config.basin_east_m) / radius_m
    shape: Field = np.where(r < 1.0, (depth_m + rim_m) * r**2 - depth_m, rim_m * np.exp(-4.0 * (r - 1.0)))
    return shape


def _hillside(config: TerrainConfig, north_m: Field, east_m: Field, to_edge_m: Field) -> Field:
    """A plane through the origin that returns to the level of the grid's edge."""
    downhill_rad = radians(config.slope_towards_deg)
    downhill_m = cos(downhill_rad) * north_m + sin(downhill_rad) * east_m
    fade: Field = _smooth_step(to_edge_m / (HALF_SIDE_M - HILLSIDE_HALF_M))
    return -tan(radians(config.slope_deg)) * downhill_m * fade


def steepest(heights_m: Field) -> float:
    """Largest tangent of slope over all triangles of the grid, whichever way its squares are split."""
    rise_north = np.diff(heights_m, axis=0) / SPACING_M
    rise_east = np.diff(heights_m, axis=1) / SPACING_M
    norths = (rise_north[:, :-1], rise_north[:, 1:])
    easts = (rise_east[:-1, :], rise_east[1:, :])
    return max(float(np.hypot(n, e).max()) for n in norths for e in easts)


def _fractal(rng: np.random.Generator) -> Field:
    """Unit-variance noise whose amplitude falls with the square of the wave number."""
    white = np.fft.rfft2(rng.standard_normal((POINTS, POINTS)))
    k_north = np.fft.fftfreq(POINTS, SPACING_M)[:, None]
    k_east = np.fft.rfftfreq(POINTS, SPACING_M)[None, :]
    k = np.maximum(np.hypot(k_north, k_east), 1.0 / WAVELENGTH_MAX_M)
    filtered: Field = np.fft.irfft2(white * k**-2.0, s=(POINTS, POINTS))
    filtered -= filtered.mean()
    filtered /= filtered.std()
    return filtered


def _crater(rng: np.random.Generator, config: TerrainConfig, north_m: Field, east_m: Field) -> Field:
    """A parabolic bowl with a raised rim that falls off outside; small ones are more frequent."""
    at_north, at_east = rng.uniform(-HALF_SIDE_M, HALF_SIDE_M, 2)
    smallest, largest = config.radius_crater_min_m, max(config.radius_crater_min_m, config.radius_crater_max_m)
    radius_m = float(smallest * (largest / smallest) ** (rng.random() ** 2))
    depth_m = 0.04 * radius_m
    rim_m = 0.3 * depth_m
    r = np.hypot(north_m - at_north, east_m - at_east) / radius_m
    bowl = (depth_m + rim_m) * r**2 - depth_m
    shape: Field = np.where(r < 1.0, bowl, rim_m * np.exp(-3.0 * (r - 1.0)))
    return shape


def _rock(rng: np.random.Generator, config: TerrainConfig, ground: Terrain) -> Field:
    """(12, 3) corners of a half buried, dented and turned icosahedron somewhere on the grid, not near the origin."""
    while True:
        north_m, east_m = (float(x) for x in rng.uniform(-HALF_SIDE_M + 1.0, HALF_SIDE_M - 1.0, 2))
        if north_m**2 + east_m**2 > CLEAR_OF_ROCKS_M**2:
            break
    smallest, largest = config.radius_rock_min_m, max(config.radius_rock_min_m, config.radius_rock_max_m)
    radius_m = float(smallest * (largest / smallest) ** (rng.random() ** 2))
    turn_rad = float(rng.uniform(0.0, 2.0 * pi))
    c, s = cos(turn_rad), sin(turn_rad)
    turned = ICOSAHEDRON @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    dents = rng.uniform(0.75, 1.0, (12, 1))
    corners: Field = radius_m * dents * turned + np.array([north_m, east_m, -ground.height_m(north_m, east_m)])
    return corners


def _smooth_step(x: Any) -> Field:
    """0 below 0, 1 above 1, with zero slope at both."""
    t = np.clip(x, 0.0, 1.0)
    result: Field = t * t * (3.0 - 2.0 * t)
    return result


# -- the terrain as clients get it -----------------------------------------------------------------------

REPLY_EVERY = 2
"""Clients get every second height, so that the reply stays below 100 kB: what lies between differs by less than 2 cm
from the straight line."""


def ground_reply(terrain: Terrain, origin_ned_m: Vec3, obstacles: tuple[Obstacle, ...] = ()) -> Ground:
    """The terrain around another origin: a coarser grid, and the rocks as balls.

    Args:
        origin_ned_m: (3,) origin of the reply's frame, in the map.
        obstacles: what else stands in it, around the same origin.
    """
    north_m, east_m, down_m = origin_ned_m
    heights_mm = np.rint(1000.0 * terrain.heights_m[::REPLY_EVERY, ::REPLY_EVERY]).astype(int)
    middles_m, radii_m = terrain.rock_balls
    places_m = np.round(middles_m - np.array(origin_ned_m), 3)
    return Ground(
        spacing_m=REPLY_EVERY * SPACING_M,
        corner_ned_m=(-HALF_SIDE_M - north_m, -HALF_SIDE_M - east_m, -down_m),
        heights_mm=tuple(map(tuple, heights_mm.tolist())),
        rocks=tuple(
            Rock(pos_rock_ned_m=tuple(place), radius_m=radius)
            for place, radius in zip(places_m.tolist(), np.round(radii_m, 3).tolist(), strict=True)
        ),
        obstacles=obstacles,
    )
