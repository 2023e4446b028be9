"""Matches: the same points of the ground in two images."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from jezero.mapping.ground import Ground
from jezero.mapping.survey import Pixels, Survey

Array = NDArray[np.float64]
FEATURES_MAX = 1200
NEIGHBOURS_MAX = 8
APART_MAX = 0.8
"""Images whose centres are farther apart than this share of their diagonal are not compared."""
RATIO_MAX = 0.8
ASTRAY_MAX_M = 1.0
"""Matches farther apart on the ground than this are of different places that look alike."""
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
        descriptors: (k, 128) as bytes, because those of all images are in memory.
    """

    points_px: Array
    descriptors: NDArray[np.uint8]

    @property
    def roots(self) -> NDArray[np.float32]:
        """(k, 128) unit vectors to compare. Source: Arandjelovic and Zisserman 2012, RootSIFT."""
        values = self.descriptors.astype(np.float32)
        return np.asarray(np.sqrt(values / np.maximum(values.sum(axis=1, keepdims=True), 1e-9)), np.float32)


def find_matches(survey: Survey, ground: Ground) -> list[Matches]:
    """Find the matches of all pairs of overlapping images."""
    detector = cv2.SIFT.create(FEATURES_MAX)
    features = [_features(detector, survey.pixels(number)) for number in range(len(survey))]
    found = []
    for first, second in _pairs(survey, ground):
        matches = _match(survey, ground, first, second, features[first], features[second])
        if matches is not None:
            found.append(matches)
    return found


def _features(detector: cv2.SIFT, pixels: Pixels) -> _Features:
    keypoints, descriptors = detector.detectAndCompute(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), None)
    if not keypoints:
        return _Features(np.zeros((0, 2)), np.zeros((0, 128), np.uint8))
    return _Features(np.array([keypoint.pt for keypoint in keypoints]), descriptors.astype(np.uint8))


def _pairs(survey: Survey, ground: Ground) -> Iterator[tuple[int, int]]:
    """Pairs of each image with the next one and with its nearest neighbours."""
    middles_m = np.array(
        [ground.met(survey.pos_m[i], survey.rotations[i, :, 2][None])[0, :2] for i in range(len(survey))]
    )
    heights_m = ground.down_m(survey.pos_m[:, :2]) - survey.pos_m[:, 2]
    reach_m = APART_MAX * float(np.median(heights_m)) * float(np.hypot(*survey.size_px)) / survey.focal_px
    pairs = {(i, i + 1) for i in range(len(survey) - 1)}
    for i in range(len(survey)):
        apart_m = np.linalg.norm(middles_m - middles_m[i], axis=1)
        near = [int(j) for j in np.argsort(apart_m, kind="stable") if j != i and apart_m[j] < reach_m]
        pairs |= {(min(i, j), max(i, j)) for j in _spread(near, middles_m, i)}
    yield from sorted(pairs)


def _spread(near: list[int], middles_m: Array, of: int) -> list[int]:
    """The nearest neighbour in each of eight sectors."""
    chosen: dict[int, int] = {}
    for j in near:
        away = middles_m[j] - middles_m[of]
        sector = int((np.arctan2(away[1], away[0]) + np.pi) / (2.0 * np.pi) * NEIGHBOURS_MAX) % NEIGHBOURS_MAX
        chosen.setdefault(sector, j)
    return list(chosen.values())


def _match(survey: Survey, ground: Ground, first: int, second: int, a: _Features, b: _Features) -> Matches | None:
    if min(len(a.points_px), len(b.points_px)) < MATCHES_MIN:
        return None
    on_a, on_b = (_on_ground(survey, ground, i, f.points_px) for i, f in ((first, a), (second, b)))
    pairs = _nearest_descriptors(a, b)
    if len(pairs) < MATCHES_MIN:
        return None
    astray_m = np.linalg.norm(on_a[pairs[:, 0]] - on_b[pairs[:, 1]], axis=1)
    pairs = pairs[astray_m < ASTRAY_MAX_M]
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


def _on_ground(survey: Survey, ground: Ground, number: int, points_px: Array) -> Array:
    rays = survey.rays(points_px) @ survey.rotations[number].T
    return np.nan_to_num(ground.met(survey.pos_m[number], rays)[:, :2], nan=1e6)
