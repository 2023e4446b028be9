"""The ground that a vehicle has swept or photographed so far, on a grid: cheap enough for every step of a flight."""

from collections.abc import Sequence
from itertools import pairwise
from math import ceil, hypot, sqrt

import numpy as np
import shapely
from shapely.geometry import Polygon

from jezero.base.arrays import Array
from jezero.base.frames import Quat, q_frd_from_camera, quat_from_euler, quat_multiply, quat_rotate
from jezero.base.lens import undistort
from jezero.base.vehicle_config import CameraMountConfig

CELLS_PER_LINE = 20
CELLS_PER_PICTURE = 40
"""Cells of the photographed ground along the shorter side of a picture."""
CELLS_MAX = 1_000_000
HORIZON = 0.1
"""A ray that goes down by less than this fraction of its length is taken to do so: it meets the ground far away."""


class _Cells:
    """The cells of an area that are still left.

    Attributes:
        north_m: (rows,) middles of the cells.
        east_m: (columns,) middles of the cells.
        left: (rows, columns) whether a cell is in the area and nothing was done there yet.
        cell_m: side of a cell.
    """

    def __init__(self, area: Polygon, cell_m: float) -> None:
        north_m, east_m, north_end_m, east_end_m = area.bounds
        extent_m2 = (north_end_m - north_m) * (east_end_m - east_m)
        self.cell_m = max(cell_m, sqrt(extent_m2 / CELLS_MAX))
        rows = max(1, ceil((north_end_m - north_m) / self.cell_m))
        columns = max(1, ceil((east_end_m - east_m) / self.cell_m))
        self.north_m = north_m + (np.arange(rows) + 0.5) * self.cell_m
        self.east_m = east_m + (np.arange(columns) + 0.5) * self.cell_m
        shapely.prepare(area)
        self.left = np.asarray(shapely.contains_xy(area, *np.meshgrid(self.north_m, self.east_m, indexing="ij")), bool)
        self._count = int(self.left.sum())

    @property
    def fraction(self) -> float:
        """Fraction of the area that is done, 0 to 1; 1 for an area that is smaller than a cell."""
        return 1.0 - float(self.left.sum()) / self._count if self._count else 1.0

    def window(self, low_m: Sequence[float] | Array, high_m: Sequence[float] | Array) -> tuple[slice, slice]:
        """Rows and columns of the cells between two corners, north and east."""
        rows = slice(*np.searchsorted(self.north_m, (low_m[0], high_m[0])))
        return rows, slice(*np.searchsorted(self.east_m, (low_m[1], high_m[1])))


class CoveredGround:
    """Covered and uncovered cells of an area.

    Cells within half a line distance of the vehicle's path count as covered.

    Args:
        area: metres, (north, east).
    """

    def __init__(self, area: Polygon, line_distance_m: float) -> None:
        self._reach_m = 0.5 * line_distance_m
        self._cells = _Cells(area, line_distance_m / CELLS_PER_LINE)
        self._last_m: tuple[float, float] | None = None

    @property
    def fraction(self) -> float:
        """Covered fraction of the area, 0 to 1; 1 for an area that is smaller than a cell."""
        return self._cells.fraction

    def mark(self, north_m: float, east_m: float) -> None:
        """Mark the surroundings of the vehicle's position as covered, once per cell flown."""
        cells, reach_m = self._cells, self._reach_m
        if self._last_m is not None and hypot(north_m - self._last_m[0], east_m - self._last_m[1]) < cells.cell_m:
            return
        self._last_m = (north_m, east_m)
        rows, columns = cells.window((north_m - reach_m, east_m - reach_m), (north_m + reach_m, east_m + reach_m))
        away_m2 = (cells.north_m[rows, None] - north_m) ** 2 + (cells.east_m[None, columns] - east_m) ** 2
        cells.left[rows, columns] &= away_m2 > reach_m**2

    def mark_way(self, way_m: Array) -> None:
        """Mark the surroundings of a flown path, (n, 2) points, as covered."""
        for start, end in pairwise(way_m):
            count = max(1, ceil(float(np.linalg.norm(end - start)) / self._cells.cell_m))
            for fraction in np.arange(1, count + 1) / count:
                self.mark(*(start + fraction * (end - start)))


class PhotographedGround:
    """Cells of an area that are in at least one picture.

    Args:
        area: metres, (north, east).
        footprint_m: (4, 2) a typical `footprint`.
    """

    def __init__(self, area: Polygon, footprint_m: Array) -> None:
        self._cells = _Cells(area, float(np.ptp(footprint_m, axis=0).min()) / CELLS_PER_PICTURE)

    @property
    def fraction(self) -> float:
        """Photographed fraction of the area, 0 to 1; 1 for an area that is smaller than a cell."""
        return self._cells.fraction

    def mark(self, footprint_m: Array, north_m: float, east_m: float) -> None:
        """Mark the ground in a picture that was taken above a point as photographed."""
        cells = self._cells
        corners_m = footprint_m + np.array((north_m, east_m))
        rows, columns = cells.window(corners_m.min(axis=0), corners_m.max(axis=0))
        left = np.zeros(cells.left[rows, columns].shape, bool)
        right = left.copy()
        for start, end in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
            away = (end[0] - start[0]) * (cells.east_m[None, columns] - start[1])
            away = away - (end[1] - start[1]) * (cells.north_m[rows, None] - start[0])
            left |= away > 0.0
            right |= away < 0.0
        cells.left[rows, columns] &= left & right  # a cell that is on one side of all edges is inside


def footprint(camera: CameraMountConfig, q_ned_from_camera: Quat, height_m: float) -> Array:
    """(4, 2) north and east of an image's corners on level ground, from the point straight below the camera.

    Args:
        q_ned_from_camera: attitude of the camera (right, down, forward).
        height_m: of the camera above the ground.
    """
    (center_x_px, center_y_px), focal_px = camera.center_px, camera.focal_px
    left, top = -(center_x_px + 0.5) / focal_px, -(center_y_px + 0.5) / focal_px
    right, down = (camera.width_px - 0.5 - center_x_px) / focal_px, (camera.height_px - 0.5 - center_y_px) / focal_px
    corners = np.array(((left, top), (right, top), (right, down), (left, down)))
    seen = undistort(corners, camera.distortion, camera.aspect)
    rays = [quat_rotate(q_ned_from_camera, (float(x), float(y), 1.0)) for x, y in seen]
    scales = [height_m / max(ray[2], HORIZON * float(np.linalg.norm(ray))) for ray in rays]
    return np.array([(scale * ray[0], scale * ray[1]) for scale, ray in zip(scales, rays, strict=True)])


def planned_footprint(camera: CameraMountConfig, heading_rad: float, height_m: float) -> Array:
    """(4, 2) `footprint` of a vehicle that flies level, with its camera at rest."""
    q_ned_from_frd = quat_from_euler(0.0, 0.0, heading_rad)
    q_camera = q_frd_from_camera(camera.pitch_rest_rad, camera.roll_offset_rad, camera.turn_rad)
    return footprint(camera, quat_multiply(q_ned_from_frd, q_camera), height_m)


def photographed_fraction(area: Polygon, pictures_m: Array, footprint_m: Array) -> float:
    """Fraction of an area that is in at least one of the pictures at (n, 2) points."""
    ground = PhotographedGround(area, footprint_m)
    for picture_m in pictures_m:
        ground.mark(footprint_m, *picture_m)
    return ground.fraction
