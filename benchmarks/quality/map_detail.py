"""Detail of a map against single pictures: what blending, seams and wrong poses take away.

`python -m benchmarks.quality.map_detail FOLDER [MAP]` compares MAP [FOLDER/map.png] with the pictures of FOLDER, each
projected on the ground alone. For each patch of 1 m, the figure is the map's gradient energy over that of the picture
that looks most steeply down on the whole patch: 1 is the same detail, less is blurred. It also differs from 1 where
that picture shows something that moved, or shows what stands on the ground elsewhere than the map.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.mapping.alignment import align
from jezero.mapping.ground import fit_ground
from jezero.mapping.matching import find_matches
from jezero.mapping.projection import Grid, project
from jezero.mapping.survey import read_survey

PATCH_M = 1.0


def gradient_energy(pixels: NDArray[np.uint8], patch_px: int) -> Array:
    """Mean squared difference of neighbouring pixels in each patch."""
    grey = _patches(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(float), patch_px)
    down, right = (np.diff(grey, axis=axis) ** 2 for axis in (1, 3))
    return np.asarray(down.mean(axis=(1, 3)) + right.mean(axis=(1, 3)))


def _patches(values: Array, patch_px: int) -> Array:
    rows, columns = (size // patch_px for size in values.shape)
    cut = values[: rows * patch_px, : columns * patch_px]
    return np.asarray(cut.reshape(rows, patch_px, columns, patch_px))


def detail(folder: Path, file: Path) -> tuple[Array, Array]:
    """(rows, columns) the figure of each patch of the map, and of the plain mean of all pictures.

    NaN where no picture shows a whole patch.
    """
    picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise SystemExit(f"{file} is no picture")
    m_per_px, _, _, _, east_m, north_m = (float(line) for line in file.with_suffix(".pgw").read_text().split())
    patch_px = round(PATCH_M / m_per_px)
    rows, columns = (-(-size // patch_px) * patch_px for size in picture.shape[:2])
    whole = np.zeros((rows, columns, 4), np.uint8)
    whole[: picture.shape[0], : picture.shape[1]] = picture
    grid = Grid(north_m, east_m, m_per_px, rows, columns)
    survey = read_survey(folder, load_config(VehicleConfig, "vehicle"))
    ground = fit_ground(survey.spots_m)
    survey = align(survey, ground, find_matches(survey, ground)).survey
    best, slant2 = (np.full((rows // patch_px, columns // patch_px), value) for value in (np.nan, np.inf))
    total, count = np.zeros((rows, columns, 3)), np.zeros((rows, columns, 1))
    for number in range(len(survey)):
        patch = project(survey, ground, number, grid)
        if patch is None:
            continue
        pixels, slants = np.zeros((rows, columns, 3), np.uint8), np.full((rows, columns), np.inf)
        pixels[patch.place], slants[patch.place] = patch.colours, np.where(patch.seen, patch.slant2, np.inf)
        total[patch.place] += patch.seen[:, :, None] * patch.colours
        count[patch.place] += patch.seen[:, :, None]
        steeper = (mean := _patches(slants, patch_px).mean(axis=(1, 3))) < slant2
        best[steeper], slant2[steeper] = gradient_energy(pixels, patch_px)[steeper], mean[steeper]
    seen = _patches(whole[:, :, 3].astype(float), patch_px).min(axis=(1, 3)) > 0.0
    mean_of_all = np.rint(total / np.maximum(count, 1.0)).astype(np.uint8)
    shares, shares_of_mean = (
        np.where(seen, gradient_energy(pixels, patch_px) / best, np.nan)
        for pixels in (np.ascontiguousarray(whole[:, :, 2::-1]), mean_of_all)
    )
    return shares, shares_of_mean


def main() -> None:
    parser = argparse.ArgumentParser(description="Detail of a map against its pictures.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("map", type=Path, nargs="?")
    arguments = parser.parse_args()
    shares, shares_of_mean = detail(arguments.folder, arguments.map or arguments.folder / "map.png")
    known = shares[np.isfinite(shares)]
    print(
        f"{known.size} patches of {PATCH_M:g} m: median {np.median(known):.2f}, lowest {known.min():.2f}, "
        f"highest {known.max():.2f}, {np.count_nonzero(known < 0.8)} below 0.8"
    )
    known = shares_of_mean[np.isfinite(shares_of_mean)]
    print(f"the plain mean of all pictures: median {np.median(known):.2f}, lowest {known.min():.2f}")
    print(np.array2string(shares, precision=2, suppress_small=True, max_line_width=200))


if __name__ == "__main__":
    main()
