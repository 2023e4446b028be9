"""Correction of the images' poses so that features that two images share meet on the ground.

The unknowns are each image's position and attitude. Priors with their standard deviations fix what the matches can't:
the position of the whole, the direction of north, and the height.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.mapping.ground import MapGround
from jezero.mapping.matching import Matches, group_images
from jezero.mapping.survey import Survey

STD_MATCH_M = 0.02
HUBER_M = 0.04
STD_PLACE_M = 0.5
STD_WAY_M = 0.01
STD_WAY_M_PER_S = 0.01
STD_HEIGHT_M = 0.05
STD_TILT_RAD, STD_YAW_RAD = np.radians(1.0), np.radians(1.5)
STD_WOBBLE_RAD = np.radians(0.3)
"""Standard deviations of the priors. The error of an image's position is large (STD_PLACE_M, STD_HEIGHT_M), that of the
way between two exposures small (`std_way_m`). All images share an attitude error (STD_TILT_RAD, STD_YAW_RAD), to
which each adds a small one (STD_WOBBLE_RAD). The ways say where north is, so a map turns if they are trusted more than
flights in wind deserve."""
WAY_MAX_S = 30.0
"""Exposures farther apart in time may be of two flights."""
HUBER_WAY = 3.0
"""Standard deviations. Times of two flights can follow each other by chance, so this prior can be wrong."""
ITERATIONS = 12
STEP_MIN = 1e-4
"""Metres or radians; smaller steps can't be seen in the map."""
UNKNOWNS = 6
"""Unknowns per image: north, east, down, and a small rotation about these axes. A last rotation is common to all."""


@dataclass(frozen=True)
class MapAlignment:
    """Result of the alignment.

    Attributes:
        survey: the survey with corrected poses.
        pairs: number of matched pairs of images.
        groups: numbers of images in the groups that no match connects, the largest first.
        before_m: median distance on the ground between the two points of a match before; NaN without matches.
        after_m: the same afterwards.
    """

    survey: Survey
    pairs: int
    groups: tuple[int, ...]
    before_m: float
    after_m: float


def align(survey: Survey, ground: MapGround, matches: list[Matches]) -> MapAlignment:
    """Correct the poses by iterated least squares with robust (Huber) weights."""
    groups = tuple(sorted(np.bincount(group_images(len(survey), matches)).tolist(), reverse=True))
    if not matches:
        return MapAlignment(survey, 0, groups, float("nan"), float("nan"))
    ends = _Ends(survey, matches)
    before_m = _median_m(ends.apart(survey, ground)[0])
    moved = np.zeros(UNKNOWNS * len(survey) + 3)
    priors, is_way = _priors(survey)
    present = survey
    for _ in range(ITERATIONS):
        apart_m, slopes = ends.apart(present, ground)
        lengths_m = np.maximum(np.linalg.norm(apart_m, axis=1), 1e-9)
        weights = np.repeat(np.sqrt(np.minimum(1.0, HUBER_M / lengths_m)) / STD_MATCH_M, 2)
        departures = priors @ moved
        trust = np.where(is_way, np.sqrt(HUBER_WAY / np.maximum(np.abs(departures), HUBER_WAY)), 1.0)
        rows = scipy.sparse.vstack((slopes.multiply(weights[:, None]), priors.multiply(trust[:, None]))).tocsr()
        rest = np.concatenate((weights * apart_m.ravel(), trust * departures))
        step = scipy.sparse.linalg.spsolve((rows.T @ rows).tocsc(), -(rows.T @ rest))
        moved += step
        present = _moved(survey, moved)
        if np.abs(step).max() < STEP_MIN:
            break
    return MapAlignment(present, len(matches), groups, before_m, _median_m(ends.apart(present, ground)[0]))


def std_way_m(since_s: float) -> float:
    """Standard deviation of the way between two exposures, on each axis, by the time between them."""
    return STD_WAY_M + STD_WAY_M_PER_S * since_s


def _median_m(apart_m: Array) -> float:
    return float(np.median(np.linalg.norm(apart_m, axis=1)))


def _moved(survey: Survey, moved: Array) -> Survey:
    """The survey with each image's position shifted and its attitude rotated."""
    each = moved[:-3].reshape(-1, UNKNOWNS)
    turns = np.array([_turn(rotation) for rotation in each[:, 3:]])
    return survey.moved(survey.pos_m + each[:, :3], turns @ survey.rotations)


def _turn(vector: Array) -> Array:
    """(3, 3) rotation of a rotation vector."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    skew = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew)


class _Ends:
    """Both points of all matches: the number of the image and the ray of each."""

    def __init__(self, survey: Survey, matches: list[Matches]) -> None:
        counts = [len(pair.points_first_px) for pair in matches]
        self._numbers = [np.repeat([getattr(pair, end) for pair in matches], counts) for end in ("first", "second")]
        self._rays = [
            survey.rays(np.concatenate([getattr(pair, f"points_{end}_px") for pair in matches]))
            for end in ("first", "second")
        ]
        self._unknowns = UNKNOWNS * len(survey) + 3

    def apart(self, survey: Survey, ground: MapGround) -> tuple[Array, scipy.sparse.csr_matrix]:
        """(k, 2) offset of the first point from the second on the ground, and its (2k, unknowns) Jacobian."""
        (first_m, first_slopes), (second_m, second_slopes) = (self._on_ground(survey, ground, end) for end in (0, 1))
        slopes = (first_slopes - second_slopes).tocsr()
        # A ray that an iteration turned above the horizon says nothing.
        slopes.data = np.nan_to_num(slopes.data)
        return np.nan_to_num(first_m - second_m), slopes

    def _on_ground(self, survey: Survey, ground: MapGround, end: int) -> tuple[Array, scipy.sparse.csr_matrix]:
        """Points at which the rays of one end meet the ground, and their Jacobian.

        With u = d_north/d_down, v = d_east/d_down and the height h, a point is at (N + hu, E + hv).
        """
        numbers = self._numbers[end]
        along = np.einsum("kij,kj->ki", survey.rotations[numbers], self._rays[end])
        met_m = ground.met(survey.pos_m[numbers], along)
        height_m = met_m[:, 2] - survey.pos_m[numbers, 2]
        u, v = along[:, 0] / along[:, 2], along[:, 1] / along[:, 2]
        one, zero = np.ones_like(u), np.zeros_like(u)
        north = np.stack((one, zero, -u, -height_m * u * v, height_m * (1.0 + u * u), -height_m * v))
        east = np.stack((zero, one, -v, -height_m * (1.0 + v * v), height_m * u * v, height_m * u))
        values = np.stack((north, east)).transpose(2, 0, 1)
        count = len(numbers)
        rows = np.repeat(np.arange(2 * count), UNKNOWNS)
        columns = (UNKNOWNS * numbers[:, None, None] + np.arange(UNKNOWNS)[None, None, :]).repeat(2, axis=1)
        shape = (2 * count, self._unknowns)
        return met_m[:, :2], scipy.sparse.csr_matrix((values.ravel(), (rows, columns.ravel())), shape=shape)


def _priors(survey: Survey) -> tuple[scipy.sparse.csr_matrix, NDArray[np.bool_]]:
    """Priors: each row is a sum of unknowns over its standard deviation, with the expected value zero.

    Returns:
        The rows, and whether each is of the way between two exposures.
    """
    count = len(survey)
    shared = UNKNOWNS * count
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    is_way: list[bool] = []

    def know(std: float, terms: dict[int, float], way: bool = False) -> None:
        is_way.append(way)
        row = rows[-1] + 1 if rows else 0
        for column, value in terms.items():
            rows.append(row)
            columns.append(column)
            values.append(value / std)

    for i in range(count):
        at = UNKNOWNS * i
        for axis, std_m in enumerate((STD_PLACE_M, STD_PLACE_M, STD_HEIGHT_M)):
            know(std_m, {at + axis: 1.0})
        for axis in range(3):
            know(STD_WOBBLE_RAD, {at + 3 + axis: 1.0, shared + axis: -1.0})
        # An image that was taken later than the next one, or much later than the one before, is of another flight.
        if i > 0 and 0.0 < (since_s := float(survey.times_s[i] - survey.times_s[i - 1])) < WAY_MAX_S:
            for axis in range(2):
                know(std_way_m(since_s), {at + axis: 1.0, at - UNKNOWNS + axis: -1.0}, way=True)
    for axis, std_rad in enumerate((STD_TILT_RAD, STD_TILT_RAD, STD_YAW_RAD)):
        know(float(std_rad), {shared + axis: 1.0})
    shape = (rows[-1] + 1, shared + 3)
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=shape), np.array(is_way)
