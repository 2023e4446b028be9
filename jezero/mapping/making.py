"""The map of a coverage's folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.mapping.alignment import MapAlignment, align
from jezero.mapping.files import save_map
from jezero.mapping.ground import fit_ground
from jezero.mapping.matching import find_matches
from jezero.mapping.mosaic import Mosaic, make_mosaic
from jezero.mapping.survey import read_survey


@dataclass(frozen=True)
class Map:
    """A map, and the alignment of its images.

    Attributes:
        mosaic: the map.
        alignment: the alignment.
        pictures: number of images.
        picture_m_per_px: ground that a pixel of the images shows, in the middle of the median image.
        origin_deg: latitude, longitude and altitude of the map's origin; None without positions in degrees.
    """

    mosaic: Mosaic
    alignment: MapAlignment
    pictures: int
    picture_m_per_px: float
    origin_deg: Vec3 | None

    @property
    def description(self) -> str:
        """Resolutions of the map and of its images, for people."""
        map_cm, picture_cm = 100.0 * self.mosaic.m_per_px, 100.0 * self.picture_m_per_px
        finer = ", finer than its images" if map_cm < 0.99 * picture_cm else ""
        return f"{map_cm:.3g} cm per pixel{finer}; its {self.pictures} images have {picture_cm:.2g} cm per pixel"

    def save(self, file: Path) -> list[Path]:
        """Write the map's files; see `save_map`."""
        return save_map(self.mosaic, self.origin_deg, f"jezero map: {self.description}", file)


def make_map(folder: Path, m_per_px: float, vehicle: VehicleConfig) -> Map:
    """Make the orthomosaic of a folder's images.

    The ground's height comes from the altimeter ranges in the dataset.

    Args:
        vehicle: with which the images were taken.

    Raises:
        SurveyError: the folder has no images that can be mapped.
    """
    survey = read_survey(folder, vehicle)
    ground = fit_ground(survey.spots_m)
    matches = find_matches(survey, ground)
    alignment = align(survey, ground, matches)
    heights_m = ground.down_m(survey.pos_m[:, :2]) - survey.pos_m[:, 2]
    picture_m_per_px = float(np.median(heights_m)) / survey.focal_px
    mosaic = make_mosaic(alignment.survey, ground, matches, m_per_px)
    return Map(mosaic, alignment, len(survey), picture_m_per_px, survey.origin_deg)
