"""The map of a coverage's folder."""

from dataclasses import dataclass
from pathlib import Path

from jezero.mapping.alignment import Alignment, align
from jezero.mapping.ground import fit_ground
from jezero.mapping.matching import find_matches
from jezero.mapping.mosaic import Mosaic, make_mosaic
from jezero.mapping.survey import read_survey
from jezero.vehicle_config import VehicleConfig


@dataclass(frozen=True)
class Map:
    """A map, and the alignment of its images.

    Attributes:
        mosaic: the map.
        alignment: the alignment.
        pictures: number of images.
    """

    mosaic: Mosaic
    alignment: Alignment
    pictures: int


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
    alignment = align(survey, ground, find_matches(survey, ground))
    return Map(make_mosaic(alignment.survey, ground, m_per_px), alignment, len(survey))
