"""The ground that a vehicle has covered so far, on a grid, which is cheap enough for every step of a flight."""

from itertools import pairwise
from math import ceil, hypot, sqrt

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

Array = NDArray[np.float64]
CELLS_PER_LINE = 20
CELLS_MAX = 1_000_000


class CoveredGround:
    """Covered and uncovered cells of an area.

    Cells within half a line distance of the vehicle's path count as covered.

    Args:
        area: metres, (north, east).
    """

    def __init__(self, area: Polygon, line_distance_m: float) -> None:
        self._reach_m = 0.5 * line_distance_m
        north_m, east_m, north_end_m, east_end_m = area.bounds
        extent_m2 = (north_end_m - north_m) * (east_end_m - east_m)
        self._cell_m = max(line_distance_m / CELLS_PER_LINE, sqrt(extent_m2 / CELLS_MAX))
        rows = max(1, ceil((north_end_m - north_m) / self._cell_m))
        columns = max(1, ceil((east_end_m - east_m) / self._cell_m))
        self._north_m = north_m + (np.arange(rows) + 0.5) * self._cell_m
        self._east_m = east_m + (np.arange(columns) + 0.5) * self._cell_m
        shapely.prepare(area)
        grid = np.meshgrid(self._north_m, self._east_m, indexing="ij")
        self._left = np.asarray(shapely.contains_xy(area, *grid), bool)
        self._cells = int(self._left.sum())
        self._last_m: tuple[float, float] | None = None

    @property
    def fraction(self) -> float:
        """Covered fraction of the area, 0 to 1; 1 for an area that is smaller than a cell."""
        return 1.0 - float(self._left.sum()) / self._cells if self._cells else 1.0

    def mark(self, north_m: float, east_m: float) -> None:
        """Mark the surroundings of the vehicle's position as covered, once per cell flown."""
        if self._last_m is not None and hypot(north_m - self._last_m[0], east_m - self._last_m[1]) < self._cell_m:
            return
        self._last_m = (north_m, east_m)
        rows = slice(*np.searchsorted(self._north_m, (north_m - self._reach_m, north_m + self._reach_m)))
        columns = slice(*np.searchsorted(self._east_m, (east_m - self._reach_m, east_m + self._reach_m)))
        away_m2 = (self._north_m[rows, None] - north_m) ** 2 + (self._east_m[None, columns] - east_m) ** 2
        self._left[rows, columns] &= away_m2 > self._reach_m**2

    def mark_way(self, way_m: Array) -> None:
        """Mark the surroundings of a flown path, (n, 2) points, as covered."""
        for start, end in pairwise(way_m):
            count = max(1, ceil(float(np.linalg.norm(end - start)) / self._cell_m))
            for fraction in np.arange(1, count + 1) / count:
                self.mark(*(start + fraction * (end - start)))
