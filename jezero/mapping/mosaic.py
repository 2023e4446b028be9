"""The orthomosaic: all images projected on the ground, each shown where it is best, north at the top."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from jezero.mapping.ground import MapGround
from jezero.mapping.matching import Matches
from jezero.mapping.projection import CELL_PX, Field, Grid, fit_grid, project
from jezero.mapping.seams import SeamView, choose_images, common_part, view_of
from jezero.mapping.survey import Pixels, Survey, SurveyError

FALLBACK_WEIGHT = 1e-6
"""Weight of the images that were not chosen: they show the pixels of a cell at the map's edge that its image misses."""
STD_RATIO = 0.02
STD_GAIN = 0.3
"""Standard deviations, in logarithms: of the ratio of two images in the same place, and of a gain."""
CELLS_MIN = 20
DARK = 4.0
"""Darker colours, such as shadows at the black end of the camera's range, say nothing about the exposure."""


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


def make_mosaic(survey: Survey, ground: MapGround, matches: Sequence[Matches], m_per_px: float) -> Mosaic:
    """Project the images on the ground and join them.

    Raises:
        SurveyError: the map would be too large, or no image shows the ground.
    """
    grid = fit_grid(survey, ground, m_per_px)
    patches = ((number, project(survey, ground, number, grid)) for number in range(len(survey)))
    views = {number: view_of(patch) for number, patch in patches if patch is not None}
    if not views:
        raise SurveyError("no image shows the ground in all its corners: map images of a camera that looks down")
    gains = find_gains(views, matches)
    for number, view in views.items():
        view.colours *= gains[number]
    labels = choose_images(list(views.values()), (grid.rows // CELL_PX, grid.columns // CELL_PX))
    chosen = {number: labels == i for i, number in enumerate(views)}
    pixels, seen = _join(survey, ground, grid, chosen, gains)
    return Mosaic(pixels, seen, grid.north_m, grid.east_m, m_per_px)


def _join(
    survey: Survey, ground: MapGround, grid: Grid, cells: dict[int, NDArray[np.bool_]], gains: dict[int, Field]
) -> tuple[Pixels, NDArray[np.bool_]]:
    """The map's pixels, and whether each shows an image: the images in their cells, with soft seams one cell wide."""
    shape = (grid.rows, grid.columns)
    total, weight = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    for number, chosen in cells.items():
        patch = project(survey, ground, number, grid)
        assert patch is not None
        rows, columns = patch.place
        own = chosen[rows.start // CELL_PX : rows.stop // CELL_PX, columns.start // CELL_PX : columns.stop // CELL_PX]
        soft = cv2.resize(own.astype(np.float32), patch.seen.shape[::-1])
        share: Field = np.asarray((soft + FALLBACK_WEIGHT * np.exp(-patch.slant2)) * patch.seen, np.float32)
        total[patch.place] += share[:, :, None] * (gains[number] * patch.colours)
        weight[patch.place] += share
    mean = total / np.maximum(weight, 1e-12)[:, :, None]
    return np.clip(np.rint(mean), 0, 255).astype(np.uint8), weight > 0.0


def find_gains(views: Mapping[int, SeamView], matches: Sequence[Matches]) -> dict[int, Field]:
    """Find the (3,) gains of red, green and blue by which each image is to be multiplied.

    They give all images the same brightness and colour, as if the camera had kept its exposure.

    Args:
        views: the images by number.
        matches: pairs of images that show the same ground.
    Source: Brown and Lowe 2007, Automatic panoramic image stitching using invariant features, section 6, in logarithms.
    """
    index = {number: i for i, number in enumerate(views)}
    normal = np.eye(len(views)) / STD_GAIN**2
    right = np.zeros((len(views), 3))
    for pair in matches:
        if pair.first not in index or pair.second not in index:
            continue
        ratio = _log_ratio(views[pair.first], views[pair.second])
        if ratio is None:
            continue
        i, j = index[pair.first], index[pair.second]
        normal[[i, j], [i, j]] += 1.0 / STD_RATIO**2
        normal[[i, j], [j, i]] -= 1.0 / STD_RATIO**2
        right[i] -= ratio / STD_RATIO**2
        right[j] += ratio / STD_RATIO**2
    gains = np.exp(np.linalg.solve(normal, right)).astype(np.float32)
    return {number: gains[i] for number, i in index.items()}


def _log_ratio(first: SeamView, second: SeamView) -> Field | None:
    """Median logarithm of the first image's colours over the second's, where both show the ground."""
    common = common_part(first.place, second.place)
    if common is None:
        return None
    a, b = first.colours[common[0]], second.colours[common[1]]
    with np.errstate(invalid="ignore"):
        usable = (np.minimum(a, b) > DARK).all(axis=2)
    if np.count_nonzero(usable) < CELLS_MIN:
        return None
    return np.asarray(np.median(np.log(a[usable] / b[usable]), axis=0), np.float32)
