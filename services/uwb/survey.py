"""Places of the UWB anchors from ranges to them: multilateration by least squares.

The frame is fixed by what was measured by hand: places of the tag, or of some anchors. From ranges of the tag at known
places each anchor follows by itself; ranges between anchors join them.
"""

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import Vec3

ITERATIONS_MAX = 50
CONVERGED_M = 1e-6
STEP_MAX_M = 1.0
STD_RANGE_MIN_M = 0.01
"""Ranges whose residuals are smaller fit by chance."""
UNKNOWN_STD_M = 100.0
"""Standard deviation of a coordinate of which the ranges say nothing."""
PLACES_MIN = 4


class Sighting(msgspec.Struct, frozen=True):
    """Ranges from one place of the tag.

    Attributes:
        place_m: of the tag's antenna, in `rover_body`.
        ranges_m: by the anchor's number; the median of many.
    """

    place_m: Vec3
    ranges_m: Mapping[int, float]


class LocatedAnchor(msgspec.Struct, frozen=True):
    """The place of an anchor.

    Attributes:
        pos_rover_body_m: the place.
        std_m: its standard deviation on each axis.
    """

    pos_rover_body_m: Vec3
    std_m: Vec3


class Located(msgspec.Struct, frozen=True):
    """The result of a survey.

    Attributes:
        anchors: by number.
        residual_m: root mean square of what the ranges differ by from these places.
    """

    anchors: dict[int, LocatedAnchor]
    residual_m: float


def locate(
    sightings: Sequence[Sighting],
    start_m: Mapping[int, Vec3],
    between_m: Mapping[tuple[int, int], float] | None = None,
    known_m: Mapping[int, Vec3] | None = None,
) -> Located:
    """Places of all anchors that are not known.

    Gauss-Newton starts from each of two mirror images, as ranges from places in one plane fit both; the one that fits
    better is the result, and of equal ones that near `start_m`.

    Args:
        sightings: ranges from places of the tag that were measured by hand.
        start_m: rough place of each anchor.
        between_m: ranges between two anchors.
        known_m: places of anchors that were measured by hand.
    """
    between, known = between_m or {}, known_m or {}
    unknown = [anchor for anchor in start_m if anchor not in known]
    places = {anchor: np.array(place, dtype=float) for anchor, place in {**start_m, **known}.items()}
    tries = [_solved(sightings, between, dict(places), unknown)]
    if len(sightings) >= PLACES_MIN:
        mirrored = {a: _mirrored(p, sightings) if a in unknown else p for a, p in tries[0][0].items()}
        tries.append(_solved(sightings, between, mirrored, unknown))
    solved, normal, residuals = min(tries, key=lambda each: round(float(each[2] @ each[2]), 6))
    freedom = max(1, len(residuals) - 3 * len(unknown))
    std_range_m = max(STD_RANGE_MIN_M, float(np.sqrt(residuals @ residuals / freedom)))
    covariance = std_range_m**2 * np.linalg.inv(normal + (std_range_m / UNKNOWN_STD_M) ** 2 * np.eye(len(normal)))
    stds = np.sqrt(np.diag(covariance)).reshape(-1, 3)
    anchors = {anchor: LocatedAnchor(_vec3(solved[anchor]), _vec3(stds[i])) for i, anchor in enumerate(unknown)}
    residual_m = float(np.sqrt(np.mean(residuals**2))) if len(residuals) else 0.0
    return Located(anchors, residual_m)


def _solved(
    sightings: Sequence[Sighting],
    between_m: Mapping[tuple[int, int], float],
    places: dict[int, Array],
    unknown: Sequence[int],
) -> tuple[dict[int, Array], Array, Array]:
    """Places, the normal matrix, and the residuals of all ranges."""
    at = {anchor: 3 * i for i, anchor in enumerate(unknown)}
    size = 3 * len(unknown)
    normal, residuals = np.zeros((size, size)), np.zeros(0)
    for _ in range(ITERATIONS_MAX):
        rows: list[Array] = []
        left: list[float] = []
        for sighting in sightings:
            for anchor, range_m in sighting.ranges_m.items():
                _add(rows, left, at, size, places, anchor, np.array(sighting.place_m), None, range_m)
        for (a, b), range_m in between_m.items():
            _add(rows, left, at, size, places, a, places[b], b, range_m)
        J, residuals = np.array(rows).reshape(-1, size), np.array(left)
        normal = J.T @ J
        # A little damping keeps coordinates still of which the ranges say nothing.
        step = np.linalg.solve(normal + 1e-6 * np.eye(size), J.T @ residuals)
        step = np.clip(step, -STEP_MAX_M, STEP_MAX_M)
        for anchor, i in at.items():
            places[anchor] = places[anchor] + step[i : i + 3]
        if np.abs(step).max(initial=0.0) < CONVERGED_M:
            break
    return places, normal, residuals


def _add(
    rows: list[Array], left: list[float], at: Mapping[int, int], size: int, places: Mapping[int, Array],
    anchor: int, other_m: Array, other: int | None, range_m: float,
) -> None:  # fmt: skip
    """Append the derivative and the residual of one range."""
    if anchor not in places:
        return
    offset = places[anchor] - other_m
    length = max(float(np.linalg.norm(offset)), 1e-3)
    row = np.zeros(size)
    if anchor in at:
        row[at[anchor] : at[anchor] + 3] = offset / length
    if other is not None and other in at:
        row[at[other] : at[other] + 3] = -offset / length
    rows.append(row)
    left.append(range_m - length)


def _mirrored(place_m: Array, sightings: Sequence[Sighting]) -> Array:
    """Mirror image at the plane that fits the places of the tag best."""
    tags = np.array([sighting.place_m for sighting in sightings])
    center = tags.mean(axis=0)
    normal = np.linalg.svd(tags - center)[2][-1]
    mirrored: Array = place_m - 2.0 * float((place_m - center) @ normal) * normal
    return mirrored


def _vec3(values: Array) -> Vec3:
    x, y, z = values.tolist()
    return (x, y, z)
