"""Accuracy of a map: a coverage flown in virtual time with rendered pictures, against the simulator's own orthophoto.

`python -m benchmarks.quality.map [--seeds N] [--keep FOLDER]` maps 6 x 6 m from 5 m up in 3 m/s wind, at 2 cm per
pixel. Patches of 1.3 m of the map are looked for in the orthophoto; their median error without a common translation is
the figure, the translation (which GNSS decides) is printed beside it.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.quality.covering import Covering
from jezero.base.arrays import Array
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.mapping.making import Map, make_map
from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.simulator.camera.orthophoto import make_orthophoto
from jezero.services.simulator.config import SimulatorConfig

Pixels = NDArray[np.uint8]
SOUTH_M, NORTH_M, WEST_M, EAST_M = 1.0, 7.0, -3.0, 3.0
M_PER_PX = 0.02
MARGIN_PX = 100
PATCH_PX = 64
STEP_PX = 32
SEARCH_PX = 20
COARSE = 4
LIKENESS_MIN = 0.5
GOAL = AreaCoverageGoal(
    goal_id="map",
    polygon_ned_m=((SOUTH_M, WEST_M), (NORTH_M, WEST_M), (NORTH_M, EAST_M), (SOUTH_M, EAST_M)),
    z_ned_m=-5.0,
    overlap=0.65,
)


@dataclass(frozen=True)
class Comparison:
    """A map against a reference, patch by patch.

    Attributes:
        places_m: (k, 2) positions of the patches in the part, to the north and to the east.
        errors_m: (k, 2) errors of the map there, to the north and to the east.
        found_share: fraction of the patches that were found; the rover, for one, is not in the reference.
    """

    places_m: Array
    errors_m: Array
    found_share: float

    @property
    def offset_m(self) -> Array:
        """(2,) the common translation: the median, north and east."""
        return np.asarray(np.median(self.errors_m, axis=0))

    @property
    def rest_m(self) -> Array:
        """(k,) lengths of the errors without the common translation."""
        return np.asarray(np.linalg.norm(self.errors_m - self.offset_m, axis=1))

    @property
    def turn_rad(self) -> float:
        """Rotation of the whole map, clockwise."""
        return float(self._turned()[0])

    @property
    def unturned_m(self) -> Array:
        """(k,) lengths of the errors without the common translation and turn."""
        return np.asarray(np.linalg.norm(self._turned()[1], axis=1))

    @property
    def undistorted_m(self) -> Array:
        """(k,) lengths of the errors without the common translation, turn, stretch and shear."""
        at = np.column_stack((self.places_m, np.ones(len(self.places_m))))
        fitted = np.linalg.lstsq(at, self.errors_m, rcond=None)[0]
        return np.asarray(np.linalg.norm(self.errors_m - at @ fitted, axis=1))

    def _turned(self) -> tuple[float, Array]:
        """Fit the rotation of the map; returns it and the remaining errors."""
        at, errors_m = (values - values.mean(axis=0) for values in (self.places_m, self.errors_m))
        aside = np.column_stack((-at[:, 1], at[:, 0]))
        turn_rad = float((aside * errors_m).sum() / (aside**2).sum())
        return turn_rad, np.asarray(errors_m - turn_rad * aside)


def compare(part: Pixels, reference: Pixels) -> Comparison:
    """Find each patch of a part of a map in the reference.

    Args:
        reference: the same ground by its coordinates, and MARGIN_PX more on each side.
    """
    picture, wanted = (np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), np.uint8) for pixels in (part, reference))
    down, right = _coarse(picture, wanted)
    side_px = PATCH_PX + 2 * SEARCH_PX
    places_px, errors_px, count = [], [], 0
    for row in range(0, picture.shape[0] - PATCH_PX + 1, STEP_PX):
        for column in range(0, picture.shape[1] - PATCH_PX + 1, STEP_PX):
            count += 1
            top, left = row + down - SEARCH_PX, column + right - SEARCH_PX
            window = wanted[max(top, 0) : top + side_px, max(left, 0) : left + side_px]
            patch = picture[row : row + PATCH_PX, column : column + PATCH_PX]
            if window.shape == (side_px, side_px) and (found := _found(patch, window)) is not None:
                places_px.append((-row, column))
                errors_px.append((top + found[0] - row - MARGIN_PX, left + found[1] - column - MARGIN_PX))
    errors_m = M_PER_PX * np.array(errors_px, float).reshape(-1, 2) * np.array((1.0, -1.0))
    places_m = M_PER_PX * np.array(places_px, float).reshape(-1, 2)
    return Comparison(places_m, errors_m, len(errors_px) / max(count, 1))


def _coarse(picture: Pixels, wanted: Pixels) -> tuple[int, int]:
    """Row and column in the reference where the whole picture fits best."""
    small, large = (
        cv2.resize(pixels, None, fx=1.0 / COARSE, fy=1.0 / COARSE, interpolation=cv2.INTER_AREA)
        for pixels in (picture, wanted)
    )
    _, _, _, (column, row) = cv2.minMaxLoc(cv2.matchTemplate(large, small, cv2.TM_CCOEFF_NORMED))
    return COARSE * row, COARSE * column


def _found(patch: Pixels, window: Pixels) -> tuple[float, float] | None:
    """Row and column of the patch in the window, with fractions of a pixel; None without a match."""
    likeness = cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (column, row) = cv2.minMaxLoc(likeness)
    if best < LIKENESS_MIN or not (0 < row < likeness.shape[0] - 1 and 0 < column < likeness.shape[1] - 1):
        return None
    return row + _peak(*likeness[row - 1 : row + 2, column]), column + _peak(*likeness[row, column - 1 : column + 2])


def _peak(before: float, top: float, after: float) -> float:
    """Maximum of the parabola through three values, relative to the middle one."""
    bend = before - 2.0 * top + after
    return 0.0 if abs(bend) < 1e-12 else float(0.5 * (before - after) / bend)


def measure(seed: int, folder: Path, simulator: SimulatorConfig) -> tuple[Map, Comparison]:
    """Fly, map and compare; the folder keeps the dataset, the map and the reference."""
    flight = Covering(seed, rendered=True, simulator=simulator)
    flight.keep(folder, GOAL, flight.fly(GOAL))
    made = make_map(folder, M_PER_PX, load_config(VehicleConfig, "vehicle"))
    mosaic = made.mosaic
    made.save(folder / "map.png")
    top, bottom = (round((mosaic.north_m - north_m) / M_PER_PX) for north_m in (NORTH_M, SOUTH_M))
    left, right = (round((east_m - mosaic.east_m) / M_PER_PX) for east_m in (WEST_M, EAST_M))
    part = mosaic.pixels[top:bottom, left:right]
    if not mosaic.seen[top:bottom, left:right].all():
        raise RuntimeError("the map has holes")
    middle_m = (
        mosaic.north_m - 0.5 * M_PER_PX * (top + bottom - 1),
        mosaic.east_m + 0.5 * M_PER_PX * (left + right - 1),
    )
    side_m = (max(part.shape[:2]) + 2 * MARGIN_PX) * M_PER_PX
    reference = make_orthophoto(simulator.terrain, load_config(VehicleConfig, "vehicle"), middle_m, side_m, M_PER_PX)
    cv2.imwrite(str(folder / "reference.png"), reference[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX, ::-1])
    return made, compare(part, reference)


def main() -> None:
    parser = argparse.ArgumentParser(description="How true a map is.")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="keep datasets, maps and references in this folder")
    arguments = parser.parse_args()
    simulator = load_config(SimulatorConfig, "simulator")
    for seed in range(arguments.seeds):
        with TemporaryDirectory() as temporary:
            folder = Path(temporary) if arguments.keep is None else arguments.keep / str(seed)
            made, found = measure(seed, folder, simulator)
        north_m, east_m = found.offset_m
        print(
            f"seed {seed}: {made.pictures} pictures; median error {100 * np.median(found.rest_m):.1f} cm, 95 % "
            f"{100 * np.percentile(found.rest_m, 95):.1f} cm (without a turn of {np.degrees(found.turn_rad):.2f}° "
            f"{100 * np.median(found.unturned_m):.1f} cm, without turn, stretch and shear 95 % "
            f"{100 * np.percentile(found.undistorted_m, 95):.1f} cm) of {100 * found.found_share:.0f} % of the "
            f"patches; absolute offset {100 * north_m:+.0f} cm north, {100 * east_m:+.0f} cm east; what two pictures "
            f"show of one place was {100 * made.alignment.before_m:.1f} cm apart and is "
            f"{100 * made.alignment.after_m:.1f} cm",
            flush=True,
        )


if __name__ == "__main__":
    main()
