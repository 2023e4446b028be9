"""The orthomosaic: all images projected on the ground and blended, north at the top."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from jezero.lens import distort
from jezero.mapping.ground import Ground
from jezero.mapping.survey import Array, Pixels, Survey, SurveyError
from jezero.os_errors import naming

Field = NDArray[np.float32]
Grid = tuple[float, float, float]
"""North and east of the map's first pixel, and metres per pixel."""
PIXELS_MAX = 60_000_000
SHARPNESS = 6.0
"""Rate at which an image's weight falls from its centre."""
SHADOW_LEVELS = 12.0
"""A pixel that differs from the other images by more brightness has a small weight, e.g. the vehicle's shadow."""
GRID_PX = 16
"""The projection from map to image is calculated at every 16th pixel and interpolated between them."""


@dataclass(frozen=True)
class Mosaic:
    """An orthomosaic.

    Attributes:
        pixels: (rows, columns, 3) red, green, blue; rows from the north.
        seen: (rows, columns) whether any image shows the pixel.
        north_m: north of the first, north-western pixel's centre.
        east_m: east of the same.
        m_per_px: resolution.
    """

    pixels: Pixels
    seen: NDArray[np.bool_]
    north_m: float
    east_m: float
    m_per_px: float

    def save(self, file: Path) -> Path:
        """Write a PNG, transparent where no image shows the ground, and its world file; returns the world file.

        Coordinates are metres: x to the east, y to the north, in the world frame.
        """
        alpha = np.where(self.seen, 255, 0).astype(np.uint8)
        picture = np.dstack((self.pixels[:, :, ::-1], alpha))
        file.parent.mkdir(parents=True, exist_ok=True)
        _, encoded = cv2.imencode(".png", picture)
        with naming(file):
            file.write_bytes(encoded.tobytes())
        world = file.with_suffix(".pgw")
        numbers = (self.m_per_px, 0.0, 0.0, -self.m_per_px, self.east_m, self.north_m)
        with naming(world):
            world.write_text("".join(f"{number:.6f}\n" for number in numbers))
        return world


def make_mosaic(survey: Survey, ground: Ground, m_per_px: float) -> Mosaic:
    """Project the images on the ground and blend them.

    Raises:
        SurveyError: the map would be too large, or no image shows the ground.
    """
    north_m, east_m, rows, columns = _extent(survey, ground, m_per_px)
    if rows * columns > PIXELS_MAX:
        raise SurveyError(f"a map of {columns} x {rows} pixels is too large: choose more metres per pixel")
    grid, size = (north_m, east_m, m_per_px), (rows, columns)
    first, _ = _blend(survey, ground, grid, size, None)
    mean, seen = _blend(survey, ground, grid, size, first)
    pixels = np.clip(np.rint(mean), 0, 255).astype(np.uint8)
    return Mosaic(pixels, seen, north_m, east_m, m_per_px)


def _blend(
    survey: Survey, ground: Ground, grid: Grid, size: tuple[int, int], expected: Field | None
) -> tuple[Field, NDArray[np.bool_]]:
    """Weighted mean of the images, and whether each pixel has any; deviations from `expected` get a small weight."""
    total, weight = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    for place, patch, share in _patches(survey, ground, grid, size):
        trust = share
        if expected is not None:
            departure = np.abs(patch - expected[place]).mean(axis=2)
            trust = share * (1e-3 + np.exp(-0.5 * (departure / SHADOW_LEVELS) ** 2))
        total[place] += trust[:, :, None] * patch
        weight[place] += trust
    mean: Field = (total / np.maximum(weight, 1e-12)[:, :, None]).astype(np.float32)
    return mean, weight > 0.0


def _extent(survey: Survey, ground: Ground, m_per_px: float) -> tuple[float, float, int, int]:
    """North and east of the first pixel, and the numbers of rows and columns that contain all images."""
    corners = np.concatenate([_footprint(survey, ground, number) for number in range(len(survey))])
    corners = corners[np.isfinite(corners).all(axis=1)]
    if len(corners) == 0:
        raise SurveyError("no image shows the ground")
    low, high = corners.min(axis=0), corners.max(axis=0)
    rows, columns = (int(np.ceil((high[axis] - low[axis]) / m_per_px)) + 1 for axis in (0, 1))
    north_m = float(np.ceil(high[0] / m_per_px)) * m_per_px
    east_m = float(np.floor(low[1] / m_per_px)) * m_per_px
    return north_m, east_m, rows + 1, columns + 1


def _footprint(survey: Survey, ground: Ground, number: int) -> Array:
    """(4, 2) north and east of an image's corners on the ground."""
    rays = survey.rays_of_corners @ survey.rotations[number].T
    return ground.met(survey.pos_m[number], rays)[:, :2]


def _patches(
    survey: Survey, ground: Ground, grid: Grid, size: tuple[int, int]
) -> Iterator[tuple[tuple[slice, slice], Field, Field]]:
    """Yield each image's part of the map, its colours there, and its weights, highest straight below the camera."""
    north_m, east_m, m_per_px = grid
    for number in range(len(survey)):
        corners = _footprint(survey, ground, number)
        if not np.isfinite(corners).all():
            continue
        rows = (north_m - corners[:, 0]) / m_per_px
        columns = (corners[:, 1] - east_m) / m_per_px
        top, bottom = max(0, int(rows.min())), min(size[0], int(rows.max()) + 2)
        left, right = max(0, int(columns.min())), min(size[1], int(columns.max()) + 2)
        place = (slice(top, bottom), slice(left, right))
        px, py = _lookup(survey, ground, number, place, grid)
        colours = cv2.remap(survey.pixels(number), px, py, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        yield place, colours.astype(np.float32), _weight(survey, px, py)


def _lookup(survey: Survey, ground: Ground, number: int, place: tuple[slice, slice], grid: Grid) -> tuple[Field, Field]:
    """Pixel coordinates in an image for each pixel of a part of the map."""
    north_m, east_m, m_per_px = grid
    rows, columns = (np.arange(part.start, part.stop + GRID_PX, GRID_PX) for part in place)
    at = np.stack(np.meshgrid(north_m - m_per_px * rows, east_m + m_per_px * columns, indexing="ij"), axis=-1)
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


def _weight(survey: Survey, px: Field, py: Field) -> Field:
    """Weights of pixels: 1 in an image's centre, lower towards its edges, 0 where the lens showed nothing."""
    width_px, height_px = survey.size_px
    across = np.abs(px - survey.center_px[0]) / (0.5 * width_px)
    along = np.abs(py - survey.center_px[1]) / (0.5 * height_px)
    inside = np.clip(1.0 - np.maximum(across, along), 0.0, 1.0)
    away = ((px - survey.center_px[0]) ** 2 + (py - survey.center_px[1]) ** 2) / survey.focal_px**2
    center_px = np.array(survey.center_px)
    shown = distort((np.stack((px, py), axis=-1) - center_px) / survey.focal_px, survey.distortion)
    x, y = np.moveaxis(survey.focal_px * shown + center_px, -1, 0)  # NaN is outside too
    inside[~((x >= 0) & (y >= 0) & (x <= width_px - 1) & (y <= height_px - 1))] = 0.0
    return np.asarray(np.minimum(1.0, 5.0 * inside) * np.exp(-SHARPNESS * away), np.float32)
