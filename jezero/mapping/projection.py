"""The projection of images on the ground: the map's grid, and each image's part of it."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.base.lens import distort
from jezero.mapping.ground import MapGround
from jezero.mapping.survey import Survey, SurveyError

Field = NDArray[np.float32]
Place = tuple[slice, slice]
"""Rows and columns of a part of the map."""
PIXELS_MAX = 60_000_000
CELL_PX = 4
"""Side of a cell: the image that shows a place is chosen for whole cells."""
GRID_PX = 16
"""The projection from map to image is calculated at every 16th pixel and interpolated between them."""


@dataclass(frozen=True)
class Grid:
    """Pixels of the map; rows from the north. Rows and columns are multiples of CELL_PX.

    Attributes:
        north_m: north of the first, north-western pixel's centre.
        east_m: east of the same.
        m_per_px: resolution.
        rows: number of rows.
        columns: number of columns.
    """

    north_m: float
    east_m: float
    m_per_px: float
    rows: int
    columns: int


@dataclass(frozen=True)
class Patch:
    """An image's part of the map.

    Attributes:
        place: rows and columns in the map, multiples of CELL_PX.
        colours: (h, w, 3) red, green, blue.
        seen: (h, w) whether the image shows the pixel.
        slant2: (h, w) squared tangent of the angle between the view and the image's axis.
    """

    place: Place
    colours: NDArray[np.uint8]
    seen: NDArray[np.bool_]
    slant2: Field


def fit_grid(survey: Survey, ground: MapGround, m_per_px: float) -> Grid:
    """The grid that contains all images.

    Raises:
        SurveyError: the map would be too large, or no image shows the ground.
    """
    corners = np.concatenate([_footprint(survey, ground, number) for number in range(len(survey))])
    corners = corners[np.isfinite(corners).all(axis=1)]
    if len(corners) == 0:
        raise SurveyError("no image shows the ground")
    low, high = corners.min(axis=0), corners.max(axis=0)
    rows, columns = (CELL_PX * (int((high[axis] - low[axis]) / m_per_px / CELL_PX) + 2) for axis in (0, 1))
    if rows * columns > PIXELS_MAX:
        raise SurveyError(f"a map of {columns} x {rows} pixels is too large: choose more metres per pixel")
    north_m = float(np.ceil(high[0] / m_per_px)) * m_per_px
    east_m = float(np.floor(low[1] / m_per_px)) * m_per_px
    return Grid(north_m, east_m, m_per_px, rows, columns)


def project(survey: Survey, ground: MapGround, number: int, grid: Grid) -> Patch | None:
    """Project an image on the ground; None if a corner of it shows no ground."""
    corners = _footprint(survey, ground, number)
    if not np.isfinite(corners).all():
        return None
    rows = (grid.north_m - corners[:, 0]) / grid.m_per_px
    columns = (corners[:, 1] - grid.east_m) / grid.m_per_px
    place = (_whole_cells(rows, grid.rows), _whole_cells(columns, grid.columns))
    px, py = _lookup(survey, ground, number, place, grid)
    colours = cv2.remap(survey.pixels(number), px, py, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    away = ((px - survey.center_px[0]) ** 2 + (py - survey.center_px[1]) ** 2) / survey.focal_px**2
    return Patch(place, np.asarray(colours, np.uint8), _shown(survey, px, py), np.asarray(away, np.float32))


def _whole_cells(span_px: Array, count: int) -> slice:
    first, last = int(span_px.min()) // CELL_PX, int(span_px.max() + 2) // CELL_PX + 1
    return slice(max(0, CELL_PX * first), min(count, CELL_PX * last))


def _footprint(survey: Survey, ground: MapGround, number: int) -> Array:
    """(4, 2) north and east of an image's corners on the ground."""
    rays = survey.rays_of_corners @ survey.rotations[number].T
    return ground.met(survey.pos_m[number], rays)[:, :2]


def _lookup(survey: Survey, ground: MapGround, number: int, place: Place, grid: Grid) -> tuple[Field, Field]:
    """Pixel coordinates in an image for each pixel of a part of the map."""
    rows, columns = (np.arange(part.start, part.stop + GRID_PX, GRID_PX) for part in place)
    north_m, east_m = grid.north_m - grid.m_per_px * rows, grid.east_m + grid.m_per_px * columns
    at = np.stack(np.meshgrid(north_m, east_m, indexing="ij"), axis=-1)
    flat = at.reshape(-1, 2)
    points_m = np.column_stack((flat, ground.down_m(flat)))
    seen = (points_m - survey.pos_m[number]) @ survey.rotations[number]
    ahead = np.maximum(seen[:, 2], 1e-3)
    pixels = survey.focal_px * seen[:, :2] / ahead[:, None] + np.array(survey.center_px)
    coarse = pixels.reshape(*at.shape[:2], 2).astype(np.float32)
    height, width = place[0].stop - place[0].start, place[1].stop - place[1].start
    x, y = np.arange(width, dtype=np.float32) / GRID_PX, np.arange(height, dtype=np.float32) / GRID_PX
    fine_x, fine_y = (np.ascontiguousarray(part) for part in np.meshgrid(x, y))
    fine = cv2.remap(coarse, fine_x, fine_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(fine[:, :, 0], np.float32), np.asarray(fine[:, :, 1], np.float32)


def _shown(survey: Survey, px: Field, py: Field) -> NDArray[np.bool_]:
    """Whether pixels without distortion are in the image, and in what the lens showed."""
    width_px, height_px = survey.size_px
    center_px = np.array(survey.center_px)
    lens = distort((np.stack((px, py), axis=-1) - center_px) / survey.focal_px, survey.distortion, survey.aspect)
    x, y = np.moveaxis(survey.focal_px * lens + center_px, -1, 0)
    inside = (px >= 0) & (py >= 0) & (px <= width_px - 1) & (py <= height_px - 1)
    # NaN is outside too.
    return np.asarray(inside & (x >= 0) & (y >= 0) & (x <= width_px - 1) & (y <= height_px - 1))
