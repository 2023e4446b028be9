"""Matches: the same points of the ground in two images."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.mapping.ground import MapGround
from jezero.mapping.survey import Survey

FEATURES_MAX = 1200
NEIGHBOURS_MAX = 8
APART_MAX = 0.8
"""Images whose centres are farther apart than this share of their diagonal are not compared."""
RATIO_MAX = 0.8
ASTRAY_MAX_M = 1.0
"""Matches of one flight that are farther apart on the ground than this are of different places that look alike."""
ASTRAY_FLIGHTS_MAX_M = 5.0
"""The same of two flights, whose positions differ by the errors of GNSS."""
AGREE_PX = 3.0
MATCHES_MIN = 12
MATCHES_MAX = 80


@dataclass(frozen=True)
class Matches:
    """Matches between two images.

    Attributes:
        first: number of the first image.
        second: number of the second image.
        points_first_px: (k, 2) pixels in the first image.
        points_second_px: (k, 2) pixels in the second image.
    """

    first: int
    second: int
    points_first_px: Array
    points_second_px: Array


@dataclass(frozen=True)
class _Features:
    """SIFT features of one image.

    Attributes:
        points_px: (k, 2) pixels.
        points_m: (k, 2) north and east of the same on the ground; NaN above the horizon.
        descriptors: (k, 128) as bytes, because those of all images are in memory.
    """

    points_px: Array
    points_m: Array
    descriptors: NDArray[np.uint8]

    @property
    def roots(self) -> NDArray[np.float32]:
        """(k, 128) unit vectors to compare. Source: Arandjelovic and Zisserman 2012, RootSIFT."""
        values = self.descriptors.astype(np.float32)
        return np.asarray(np.sqrt(values / np.maximum(values.sum(axis=1, keepdims=True), 1e-9)), np.float32)


def find_matches(survey: Survey, ground: MapGround) -> list[Matches]:
    """Find the matches of all pairs of overlapping images.

    Images that these matches don't connect, e.g. those of two flights, are compared again with less trust in their
    positions.
    """
    detector = cv2.SIFT.create(FEATURES_MAX)
    features = [_features(detector, survey, ground, number) for number in range(len(survey))]
    follow = {(i, i + 1) for i in range(len(survey) - 1)}
    compared = follow | _neighbours(survey, ground, np.ones((len(survey), len(survey)), bool))
    found = _match_pairs(features, compared, ASTRAY_MAX_M)
    groups = group_images(len(survey), found)
    apart = _neighbours(survey, ground, groups[:, None] != groups)
    return found + _match_pairs(features, apart, ASTRAY_FLIGHTS_MAX_M)


def group_images(count: int, matches: list[Matches]) -> NDArray[np.int64]:
    """(count,) number of the group of each image; matches connect the images of a group."""
    first, second = ([getattr(pair, end) for pair in matches] for end in ("first", "second"))
    graph = scipy.sparse.coo_matrix((np.ones(len(matches)), (first, second)), shape=(count, count))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], np.int64)


def _match_pairs(features: list[_Features], pairs: Iterable[tuple[int, int]], astray_max_m: float) -> list[Matches]:
    matched = (_match(a, b, features[a], features[b], astray_max_m) for a, b in sorted(pairs))
    return [matches for matches in matched if matches is not None]


def _features(detector: cv2.SIFT, survey: Survey, ground: MapGround, number: int) -> _Features:
    keypoints, descriptors = detector.detectAndCompute(cv2.cvtColor(survey.pixels(number), cv2.COLOR_RGB2GRAY), None)
    if not keypoints:
        return _Features(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 128), np.uint8))
    points_px = np.array([keypoint.pt for keypoint in keypoints])
    rays = survey.rays(points_px) @ survey.rotations[number].T
    return _Features(points_px, ground.met(survey.pos_m[number], rays)[:, :2], descriptors.astype(np.uint8))


def _neighbours(survey: Survey, ground: MapGround, may: NDArray[np.bool_]) -> set[tuple[int, int]]:
    """Pairs of each image with its nearest neighbours among those of which `may` (n, n) is true."""
    middles_m = np.array(
        [ground.met(survey.pos_m[i], survey.rotations[i, :, 2][None])[0, :2] for i in range(len(survey))]
    )
    heights_m = ground.down_m(survey.pos_m[:, :2]) - survey.pos_m[:, 2]
    reach_m = APART_MAX * float(np.median(heights_m)) * float(np.hypot(*survey.size_px)) / survey.focal_px
    pairs: set[tuple[int, int]] = set()
    for i in range(len(survey)):
        apart_m = np.linalg.norm(middles_m - middles_m[i], axis=1)
        order = np.argsort(apart_m, kind="stable")
        near = [int(j) for j in order if j != i and apart_m[j] < reach_m and may[i, j]]
        pairs |= {(min(i, j), max(i, j)) for j in _spread(near, middles_m, i)}
    return pairs


def _spread(near: list[int], middles_m: Array, of: int) -> list[int]:
    """The nearest neighbour in each of eight sectors."""
    chosen: dict[int, int] = {}
    for j in near:
        away = middles_m[j] - middles_m[of]
        sector = int((np.arctan2(away[1], away[0]) + np.pi) / (2.0 * np.pi) * NEIGHBOURS_MAX) % NEIGHBOURS_MAX
        chosen.setdefault(sector, j)
    return list(chosen.values())


def _match(first: int, second: int, a: _Features, b: _Features, astray_max_m: float) -> Matches | None:
    if min(len(a.points_px), len(b.points_px)) < MATCHES_MIN:
        return None
    pairs = _nearest_descriptors(a, b)
    if len(pairs) < MATCHES_MIN:
        return None
    astray_m = np.linalg.norm(a.points_m[pairs[:, 0]] - b.points_m[pairs[:, 1]], axis=1)
    pairs = pairs[astray_m < astray_max_m]
    if len(pairs) < MATCHES_MIN:
        return None
    points_a, points_b = a.points_px[pairs[:, 0]], b.points_px[pairs[:, 1]]
    _, agree = cv2.findHomography(points_a, points_b, cv2.USAC_MAGSAC, AGREE_PX)
    kept = np.flatnonzero(agree.ravel()) if agree is not None else np.zeros(0, int)
    if len(kept) < MATCHES_MIN:
        return None
    kept = kept[np.linspace(0, len(kept) - 1, min(len(kept), MATCHES_MAX)).astype(int)]
    return Matches(first, second, points_a[kept], points_b[kept])


def _nearest_descriptors(a: _Features, b: _Features) -> NDArray[np.int64]:
    """(k, 2) indices of features that are mutually nearest and pass the ratio test."""
    likeness = a.roots @ b.roots.T
    best_b = np.argmax(likeness, axis=1)
    best_a = np.argmax(likeness, axis=0)
    rows = np.arange(len(likeness))
    top = likeness[rows, best_b]
    likeness[rows, best_b] = -1.0
    next_top = likeness.max(axis=1)
    apart, next_apart = np.sqrt(np.maximum(2.0 - 2.0 * top, 0.0)), np.sqrt(np.maximum(2.0 - 2.0 * next_top, 1e-9))
    good = (best_a[best_b] == rows) & (apart < RATIO_MAX * next_apart)
    return np.column_stack((rows[good], best_b[good]))
