"""The ground keeps its promises whatever the seed."""

import numpy as np
import pytest

from jezero.services.simulator.config import TerrainConfig
from jezero.services.simulator.terrain import (
    CLEAR_OF_ROCKS_M,
    HALF_SIDE_M,
    POINTS,
    SPACING_M,
    Terrain,
    make_terrain,
    steepest,
)

SEEDS = range(8)


def test_steepest_of_a_plane_is_its_slope() -> None:
    """A plane that rises 0.03 per metre to the north and 0.04 to the east has the slope 0.05."""
    i, j = np.meshgrid(np.arange(POINTS), np.arange(POINTS), indexing="ij")
    assert steepest((0.03 * i + 0.04 * j) * SPACING_M) == pytest.approx(0.05, abs=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_ground_is_within_half_a_metre_and_five_degrees(seed: int) -> None:
    heights_m = make_terrain(TerrainConfig(seed=seed)).heights_m
    assert np.abs(heights_m).max() <= 0.5
    assert steepest(heights_m) <= np.tan(np.radians(5.0))
    assert np.ptp(heights_m) > 0.2


@pytest.mark.parametrize("seed", SEEDS)
def test_the_takeoff_point_is_level_and_free_of_rocks(seed: int) -> None:
    terrain = make_terrain(TerrainConfig(seed=seed))
    for north_m, east_m in ((0.0, 0.0), (0.7, 0.0), (0.0, -0.7), (-0.5, 0.5)):
        assert abs(terrain.height_m(north_m, east_m)) < 0.01
    distance_m = np.hypot(terrain.rock_vertices_ned_m[:, 0], terrain.rock_vertices_ned_m[:, 1])
    assert distance_m.min() > CLEAR_OF_ROCKS_M - TerrainConfig().radius_rock_max_m


def test_the_edge_is_level() -> None:
    heights_m = make_terrain(TerrainConfig(seed=3)).heights_m
    for edge in (heights_m[0], heights_m[-1], heights_m[:, 0], heights_m[:, -1]):
        assert np.abs(edge).max() == 0.0


def test_the_same_seed_gives_the_same_ground_and_another_one_another() -> None:
    first, again, other = (make_terrain(TerrainConfig(seed=seed)) for seed in (1, 1, 2))
    assert first.heights_m.tobytes() == again.heights_m.tobytes()
    assert first.rock_vertices_ned_m.tobytes() == again.rock_vertices_ned_m.tobytes()
    assert first.heights_m.tobytes() != other.heights_m.tobytes()


def test_craters_make_hollows() -> None:
    flat = make_terrain(TerrainConfig(std_ground_m=0.0, craters=10, rocks=0))
    assert flat.heights_m.min() < -0.1
    bare = make_terrain(TerrainConfig(std_ground_m=0.0, craters=0, rocks=0))
    assert not bare.heights_m.any()
    assert len(bare.rock_faces) == 0


def test_heights_between_the_points_are_interpolated() -> None:
    heights_m = np.zeros((POINTS, POINTS))
    heights_m[100, 120] = 1.0
    terrain = Terrain(heights_m, np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    north_m, east_m = 100 * SPACING_M - HALF_SIDE_M, 120 * SPACING_M - HALF_SIDE_M
    assert terrain.height_m(north_m, east_m) == pytest.approx(1.0)
    assert terrain.height_m(north_m + 0.5 * SPACING_M, east_m) == pytest.approx(0.5)
    assert terrain.height_m(north_m - 0.25 * SPACING_M, east_m + 0.5 * SPACING_M) == pytest.approx(0.375)
    assert terrain.height_m(1000.0, 0.0) == 0.0


def test_the_faces_of_rocks_look_outwards() -> None:
    terrain = make_terrain(TerrainConfig(rocks=5))
    for i in range(5):
        corners = terrain.rock_vertices_ned_m[12 * i : 12 * i + 12]
        middle = corners.mean(axis=0)
        for a, b, c in terrain.rock_faces[20 * i : 20 * i + 20] - 12 * i:
            outwards = np.cross(corners[b] - corners[a], corners[c] - corners[a])
            assert outwards @ (corners[a] - middle) > 0.0


def test_a_hillside_has_its_slope_where_the_vehicle_starts_and_a_level_edge() -> None:
    config = TerrainConfig(slope_deg=15.0, slope_towards_deg=90.0, std_ground_m=0.0, craters=0, rocks=0)
    terrain = make_terrain(config)
    assert terrain.height_m(0.0, 10.0) == pytest.approx(-10.0 * np.tan(np.radians(15.0)), abs=1e-6)
    assert terrain.height_m(14.0, -10.0) == pytest.approx(10.0 * np.tan(np.radians(15.0)), abs=1e-6)
    edges = (terrain.heights_m[0], terrain.heights_m[-1], terrain.heights_m[:, 0], terrain.heights_m[:, -1])
    assert max(float(np.abs(edge).max()) for edge in edges) < 0.05
    assert steepest(terrain.heights_m) < np.tan(np.radians(30.0))
