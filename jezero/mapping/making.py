"""From a coverage's folder to its map."""

from dataclasses import dataclass
from pathlib import Path

from jezero.mapping.alignment import Alignment, align
from jezero.mapping.ground import fit_ground
from jezero.mapping.matching import find_matches
from jezero.mapping.mosaic import Mosaic, make_mosaic
from jezero.mapping.survey import read_survey


@dataclass(frozen=True)
class Map:
    """A map, and how well its pictures agree."""

    mosaic: Mosaic
    alignment: Alignment
    pictures: int


def make_map(folder: Path, m_per_px: float) -> Map:
    """The orthomosaic of the pictures in a folder.

    The ground's height comes from the altimeter's ranges that the pictures carry.

    Raises:
        SurveyError: the folder holds no pictures that can be mapped.
    """
    survey = read_survey(folder)
    ground = fit_ground(survey.spots_m)
    alignment = align(survey, ground, find_matches(survey, ground))
    return Map(make_mosaic(alignment.survey, ground, m_per_px), alignment, len(survey))
