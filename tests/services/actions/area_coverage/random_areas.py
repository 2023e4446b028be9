"""Random areas as people and programs draw them, with the mistakes that such drawings have."""

from typing import NamedTuple

import numpy as np
import shapely
from shapely.affinity import rotate
from shapely.geometry import Point as Place
from shapely.geometry import Polygon

from jezero.services.actions.area_coverage.area import Point

Corners = list[Point]


class RandomArea(NamedTuple):
    """An area, and how far its lines are apart."""

    kind: str
    corners_m: Corners
    holes_m: list[Corners]
    resolution_m: float


def random_area(seed: int) -> RandomArea:
    """The area of a seed: one of several shapes of 20 to 200 m, with holes or without, and with mistakes or without."""
    rng = np.random.default_rng(seed)
    kinds = {"star": _star, "coast": _coast, "comb": _comb, "sliver": _sliver, "stairs": _stairs}
    kind = list(kinds)[int(rng.integers(len(kinds)))]
    size_m = float(rng.uniform(20.0, 200.0))
    outline = Polygon(kinds[kind](rng, size_m))
    holes = _holes(rng, outline, size_m) if rng.random() < 0.5 else []
    turn_deg, to_m = float(rng.uniform(0.0, 360.0)), rng.uniform(-150.0, 150.0, 2)
    rings = [_moved(ring, turn_deg, to_m) for ring in (outline, *holes)]
    corners_m, *holes_m = [_with_mistakes(rng, ring) for ring in rings]
    return RandomArea(kind, corners_m, holes_m, size_m / float(rng.uniform(8.0, 25.0)))


def _star(rng: np.random.Generator, size_m: float) -> Corners:
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, int(rng.integers(5, 30))))
    return _polar(angles, 0.5 * size_m * rng.uniform(0.4, 1.0, len(angles)))


def _coast(rng: np.random.Generator, size_m: float) -> Corners:
    angles = np.linspace(0.0, 2.0 * np.pi, int(rng.integers(100, 800)), endpoint=False)
    waves = np.arange(2, 60)
    rough = (np.sin(np.outer(angles, waves) + rng.uniform(0.0, 2.0 * np.pi, len(waves))) / waves**1.3).sum(axis=1)
    return _polar(angles, 0.4 * size_m * (1.0 + 0.25 * rough / np.abs(rough).max()))


def _polar(angles: np.ndarray, radii_m: np.ndarray) -> Corners:
    return [(float(r * np.cos(a)), float(r * np.sin(a))) for a, r in zip(angles, radii_m, strict=True)]


def _comb(rng: np.random.Generator, size_m: float) -> Corners:
    """A back with teeth, as fields around a village."""
    teeth = int(rng.integers(2, 6))
    width_m, back_m = size_m / (2 * teeth - 1), 0.3 * size_m
    corners: Corners = [(0.0, size_m), (0.0, 0.0)]
    for tooth in range(teeth):
        west_m, north_m = 2 * tooth * width_m, float(rng.uniform(0.4, 1.0)) * size_m
        corners += [(north_m, west_m), (north_m, west_m + width_m)]
        if tooth < teeth - 1:
            corners += [(back_m, west_m + width_m), (back_m, west_m + 2 * width_m)]
    return corners


def _sliver(rng: np.random.Generator, size_m: float) -> Corners:
    width_m = size_m * float(rng.uniform(0.03, 0.2))
    return [(0.0, 0.0), (size_m, 0.3 * size_m), (size_m + width_m, 0.3 * size_m), (width_m, -0.1 * width_m)]


def _stairs(rng: np.random.Generator, size_m: float) -> Corners:
    steps = int(rng.integers(3, 10))
    norths = np.sort(rng.uniform(0.1, 1.0, steps)) * size_m
    easts = np.linspace(size_m, 0.2 * size_m, steps)
    corners: Corners = [(0.0, 0.0), (0.0, size_m)]
    for north_m, east_m in zip(norths.tolist(), easts.tolist(), strict=True):
        corners += [(north_m, corners[-1][1]), (north_m, east_m)]
    return [*corners, (corners[-1][0], 0.0)]


def _holes(rng: np.random.Generator, outline: Polygon, size_m: float) -> list[Polygon]:
    """Round and square holes, some of which touch each other or the outline."""
    holes = []
    west_m, south_m, east_m, north_m = outline.bounds
    for _ in range(int(rng.integers(1, 6))):
        middle = Place(rng.uniform(west_m, east_m), rng.uniform(south_m, north_m))
        disc = middle.buffer(size_m * float(rng.uniform(0.01, 0.08)), quad_segs=int(rng.integers(1, 8)))
        hole = disc.intersection(outline)
        if isinstance(hole, Polygon) and hole.area > 0.1:
            holes.append(hole)
    return holes


def _moved(ring: Polygon, turn_deg: float, to_m: np.ndarray) -> Corners:
    corners_m = shapely.get_coordinates(rotate(ring, turn_deg, origin=(0.0, 0.0)).exterior)[:-1] + to_m
    return [(north_m, east_m) for north_m, east_m in corners_m.tolist()]


def _with_mistakes(rng: np.random.Generator, ring: Corners) -> Corners:
    """The corners, some of them twice, nearly twice, on a line, with a spike, in the other direction, or closed."""
    corners: Corners = []
    for here, after in zip(ring, [*ring[1:], ring[0]], strict=True):
        mistake = rng.random()
        corners.append(here)
        if mistake < 0.05:
            corners.append(corners[-1])
        elif mistake < 0.1:
            corners.append((corners[-1][0] + 4e-4, corners[-1][1]))
        elif mistake < 0.15:
            corners.append((0.5 * (here[0] + after[0]), 0.5 * (here[1] + after[1])))
        elif mistake < 0.16:
            corners += [(corners[-1][0] + 3.0, corners[-1][1] + 2.0), corners[-1]]
    if rng.random() < 0.3:
        corners.append(corners[0])
    return corners[::-1] if rng.random() < 0.5 else corners
