"""The terrain as clients get it: a coarser grid, so that the reply stays below 100 kB, and the rocks as balls."""

import numpy as np

from jezero.base.frames import Vec3
from jezero.schemas.terrain import Ground, Rock
from jezero.services.simulator.terrain import HALF_SIDE_M, ICOSAHEDRON, SPACING_M, Terrain

EVERY = 2
"""Every second height: what lies between differs by less than 2 cm from the straight line."""


def ground_reply(terrain: Terrain, origin_ned_m: Vec3) -> Ground:
    """The terrain around another origin.

    Args:
        origin_ned_m: (3,) origin of the reply's frame, in the map.
    """
    north_m, east_m, down_m = origin_ned_m
    heights_mm = np.rint(1000.0 * terrain.heights_m[::EVERY, ::EVERY]).astype(int)
    corners_m = terrain.rock_vertices_ned_m.reshape(-1, len(ICOSAHEDRON), 3)
    middles_m = corners_m.mean(axis=1)
    radii_m = np.linalg.norm(corners_m - middles_m[:, None], axis=2).mean(axis=1)
    places_m = np.round(middles_m - np.array(origin_ned_m), 3)
    return Ground(
        spacing_m=EVERY * SPACING_M,
        corner_ned_m=(-HALF_SIDE_M - north_m, -HALF_SIDE_M - east_m, -down_m),
        heights_mm=tuple(map(tuple, heights_mm.tolist())),
        rocks=tuple(
            Rock(pos_rock_ned_m=tuple(place), radius_m=radius)
            for place, radius in zip(places_m.tolist(), np.round(radii_m, 3).tolist(), strict=True)
        ),
    )
