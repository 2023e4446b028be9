"""Which part of an area the pictures of a plan show, and what the user should know about it before the flight."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import floor

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Polygon

from jezero.frames import q_frd_from_camera as camera_attitude
from jezero.frames import quat_from_euler, quat_multiply
from jezero.services.actions.area_coverage.ground import PhotographedGround, footprint
from jezero.vehicle_config import CameraMountConfig

Array = NDArray[np.float64]
PHOTOGRAPHED_MIN = 0.9
"""A plan whose pictures show less of the area is refused: somebody who wants pictures of all of it has taken a wrong
number. Along the edge of the area some percent may be missing in a good plan too."""
PHOTOGRAPHED_GOOD = 0.99
OVERLAP_GOOD = 0.5
"""With less overlap, a tilt of some degrees or a drift of half a metre leaves a gap beside a picture, and too little
ground is on two pictures for a map to tie them together."""


@dataclass(frozen=True)
class Photographs:
    """The pictures of a plan, each of a vehicle that flies level over level ground.

    Attributes:
        footprint_m: (4, 2) north and east of a picture's corners on the ground, from the point of the picture.
        size_m: width across and along the lines of the part of a picture that counts.
        line_distance_m: between neighbouring lines.
        picture_distance_m: between pictures along the path.
        count: number of pictures.
        fraction: photographed fraction of the area.
    """

    footprint_m: Array
    size_m: tuple[float, float]
    line_distance_m: float
    picture_distance_m: float
    count: int
    fraction: float

    @property
    def overlap(self) -> tuple[float, float]:
        """Fraction of a picture that the picture beside it, and the next one on the line, show again; 0 at least."""
        across_m, along_m = self.size_m
        return max(0.0, 1.0 - self.line_distance_m / across_m), max(0.0, 1.0 - self.picture_distance_m / along_m)

    def refusal(self) -> str:
        """Reason why the pictures would show too little of the area, with what to change, or ""."""
        if self.fraction >= PHOTOGRAPHED_MIN:
            return ""
        return (
            f"only {floor(100.0 * self.fraction)} % of the area would be in the pictures: {self._spacing()}; take a "
            f"resolution of {0.5 * min(self.size_m):.2g} m, or an overlap of 0.5, or fly higher; with force (--force) "
            "it is flown like this"
        )

    def warnings(self) -> Iterator[str]:
        """What the user should know before the flight."""
        if self.fraction < PHOTOGRAPHED_GOOD:
            yield f"only {floor(100.0 * self.fraction)} % of the area will be in the pictures: {self._spacing()}"
        if self.count > 1 and min(self.overlap) < OVERLAP_GOOD - 1e-6:
            across, along = (100.0 * overlap for overlap in self.overlap)
            yield (
                f"pictures overlap by {along:.0f} % along the lines and {across:.0f} % across them: below "
                f"{100.0 * OVERLAP_GOOD:.0f} %, tilt and drift leave gaps, and a map can't tie all pictures together"
            )

    def _spacing(self) -> str:
        across_m, along_m = self.size_m
        return (
            f"each shows {across_m:.1f} m x {along_m:.1f} m of the ground, lines are {self.line_distance_m:.4g} m and "
            f"pictures {self.picture_distance_m:.4g} m apart"
        )


def planned_footprint(camera: CameraMountConfig, heading_rad: float, height_m: float) -> Array:
    """(4, 2) `footprint` of a vehicle that flies level, with its camera at rest."""
    q_ned_from_frd = quat_from_euler(0.0, 0.0, heading_rad)
    q_frd_from_camera = camera_attitude(camera.pitch_rest_rad, camera.roll_offset_rad, camera.turn_rad)
    return footprint(camera, quat_multiply(q_ned_from_frd, q_frd_from_camera), height_m)


def photographed_fraction(area: Polygon, pictures_m: Array, footprint_m: Array) -> float:
    """Fraction of an area that is in at least one of the pictures at (n, 2) points."""
    ground = PhotographedGround(area, footprint_m)
    for picture_m in pictures_m:
        ground.mark(footprint_m, *picture_m)
    return ground.fraction
