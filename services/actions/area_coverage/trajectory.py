"""Motion along a path, from its corners: spline turns, bounded acceleration, pictures at even distances."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
import shapely
from scipy.interpolate import BSpline
from shapely.geometry import Polygon

from jezero.base.arrays import Array

SPACING_STRAIGHT_M = 0.25
SPEED_MIN_MPS = 0.05
SAMPLES_OF_TURN = np.linspace(0.0, 1.0, 17)
SHARP_RAD = np.pi / 4.0
"""A corner that bends this much from one sample to the next has no turn: the vehicle nearly stops there."""
CUT_HALVINGS = 6
ROUNDING_M = 1e-3
"""What a turn may leave the area by: far below what a vehicle flies by, and far above errors of rounding."""


@dataclass(frozen=True)
class Trajectory:
    """A motion in the plane, sampled; between samples it is linear.

    Attributes:
        t_s: (n,) from 0.
        distance_m: (n,) along the path.
        pos_m: (n, 2) positions.
        vel_mps: (n, 2) velocities.
        acc_mps2: (n, 2) accelerations.
    """

    t_s: Array
    distance_m: Array
    pos_m: Array
    vel_mps: Array
    acc_mps2: Array

    @property
    def length_m(self) -> float:
        return float(self.distance_m[-1])

    @property
    def duration_s(self) -> float:
        return float(self.t_s[-1])

    def length_left_m(self, t_s: float) -> float:
        """Length of the rest of the motion at a time."""
        return self.length_m - float(np.interp(t_s, self.t_s, self.distance_m))

    def at(self, t_s: float) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at a time; at rest before the start and after the end."""
        if not 0.0 <= t_s < self.duration_s:
            return self.pos_m[-1 if t_s > 0.0 else 0], np.zeros(2), np.zeros(2)
        i = int(self.t_s.searchsorted(t_s, side="right")) - 1
        since_s, step_s = t_s - self.t_s[i], self.t_s[i + 1] - self.t_s[i]
        position, velocity, acceleration = (
            (samples[i + 1] - samples[i]) / step_s * since_s + samples[i]
            for samples in (self.pos_m, self.vel_mps, self.acc_mps2)
        )
        return position, velocity, acceleration


def make_trajectory(
    corners_m: Array, *, speed_mps: float, acceleration_mps2: float, cut_m: Array | float, from_m: float = 0.0
) -> Trajectory:
    """Plan a motion along a path from rest to rest, as fast as speed and acceleration allow.

    Args:
        corners_m: (n, 2) of the path.
        acceleration_mps2: bound of the acceleration, split equally between the parts along and across the path.
        cut_m: greatest distance before a corner at which its turn begins; one for all, or (n,) one for each corner.
        from_m: the path before this distance along it is left out.
    """
    points = _rest_of(_smooth(corners_m, cut_m), from_m)
    part_mps2 = acceleration_mps2 / sqrt(2.0)
    steps_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    distance_m = np.concatenate(([0.0], np.cumsum(steps_m)))
    if distance_m[-1] < 1e-6:
        rest = np.zeros((2, 2))
        return Trajectory(np.array((0.0, 1e-3)), np.array((0.0, 0.0)), points[[0, -1]], rest, rest)
    tangents, curvature, turns_rad = _bend(points, steps_m)
    limit_mps = np.minimum(speed_mps, np.sqrt(part_mps2 / np.maximum(np.abs(curvature), 1e-9)))
    limit_mps[np.abs(turns_rad) > SHARP_RAD] = SPEED_MIN_MPS
    limit_mps[[0, -1]] = 0.0
    speeds = _reachable(limit_mps, steps_m, part_mps2)
    speeds = _reachable(speeds[::-1], steps_m[::-1], part_mps2)[::-1]
    mean_mps = np.maximum(0.5 * (speeds[:-1] + speeds[1:]), 0.5 * SPEED_MIN_MPS)
    t_s = np.concatenate(([0.0], np.cumsum(steps_m / mean_mps)))
    along = np.gradient(0.5 * speeds**2, distance_m)
    normals = np.column_stack((-tangents[:, 1], tangents[:, 0]))
    acc = along[:, None] * tangents + (curvature * speeds**2)[:, None] * normals
    return Trajectory(t_s, distance_m, points, speeds[:, None] * tangents, acc)


def _smooth(corners_m: Array, cut_m: Array | float) -> Array:
    """Points (m, 2) along straight lines and turns; a turn is a cubic B-spline whose curvature begins and ends at 0.

    The control points of a turn at V, between directions u and w, are V - 2cu, V - cu, V, V + cw, V + 2cw: the curve
    leaves the first line at V - cu, joins the second at V + cw, and stays inside the triangle between these and V.
    """
    distinct = np.append(True, np.linalg.norm(np.diff(corners_m, axis=0), axis=1) > 1e-6)
    corners, cuts_m = corners_m[distinct], np.broadcast_to(cut_m, len(corners_m))[distinct]
    if len(corners) < 3:
        return _filled(corners if len(corners) == 2 else np.repeat(corners, 2, axis=0))
    legs = np.diff(corners, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    directions = legs / lengths[:, None]
    pieces = [corners[:1]]
    for i in range(1, len(corners) - 1):
        cut = min(cuts_m[i], 0.5 * lengths[i - 1], 0.5 * lengths[i])
        before, after = directions[i - 1], directions[i]
        turn = np.stack([corners[i] + k * cut * (before if k < 0 else after) for k in (-2, -1, 0, 1, 2)])
        spline = BSpline(np.arange(9.0), turn, 3)
        pieces.append(spline(3.0 + 2.0 * SAMPLES_OF_TURN))
    pieces.append(corners[-1:])
    return _filled(np.concatenate(pieces))


def _filled(points: Array) -> Array:
    """The same line with no two points further apart than `SPACING_STRAIGHT_M`, and none closer than a micrometre."""
    kept = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6)]
    if len(kept) < 2:
        return np.repeat(points[:1], 2, axis=0)
    distance = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(kept, axis=0), axis=1))))
    counts = np.maximum(np.ceil(np.diff(distance) / SPACING_STRAIGHT_M).astype(int), 1)
    at = np.concatenate(
        [a + (b - a) * np.arange(n) / n for a, b, n in zip(distance, distance[1:], counts, strict=False)]
    )
    at = np.append(at, distance[-1])
    return np.column_stack([np.interp(at, distance, kept[:, k]) for k in (0, 1)])


def _rest_of(points: Array, from_m: float) -> Array:
    """The part of the line after a distance along it."""
    if from_m <= 0.0:
        return points
    distance = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    first = np.array([[np.interp(from_m, distance, points[:, k]) for k in (0, 1)]])
    return _filled(np.concatenate((first, points[distance > from_m])))


def _bend(points: Array, steps_m: Array) -> tuple[Array, Array, Array]:
    """Unit tangents (n, 2), and (n,) curvatures and turns at the points, positive towards east when flying north."""
    directions = np.diff(points, axis=0) / steps_m[:, None]
    headings = np.unwrap(np.arctan2(directions[:, 1], directions[:, 0]))
    turns = np.diff(headings)
    curvature = np.zeros(len(points))
    curvature[1:-1] = turns / (0.5 * (steps_m[:-1] + steps_m[1:]))
    middle = np.concatenate((headings[:1], headings[:-1] + 0.5 * turns, headings[-1:]))
    tangents: Array = np.column_stack((np.cos(middle), np.sin(middle)))
    return tangents, curvature, np.concatenate(([0.0], turns, [0.0]))


def _reachable(limit_mps: Array, steps_m: Array, acceleration_mps2: float) -> Array:
    """Greatest speeds that need no acceleration beyond the bound, going forward."""
    speeds: Array = limit_mps.copy()
    for i, step_m in enumerate(steps_m):
        speeds[i + 1] = min(speeds[i + 1], np.sqrt(speeds[i] ** 2 + 2.0 * acceleration_mps2 * step_m))
    return speeds


def turn_cuts(path_m: Array, area: Polygon, cut_max_m: float) -> Array:
    """(n,) the largest distance before each corner of a path at which its turn may begin without leaving the area.

    The turn stays in the triangle between its begin, its end and the corner. Where even a small triangle leaves the
    area, at a corner on the outline itself, there is no turn.
    """
    cuts_m = np.full(len(path_m), cut_max_m)
    if len(path_m) < 3:
        return cuts_m
    around = area.buffer(ROUNDING_M, join_style="mitre")
    shapely.prepare(around)
    legs = np.diff(path_m, axis=0)
    lengths_m = np.linalg.norm(legs, axis=1)
    directions = legs / np.maximum(lengths_m, 1e-9)[:, None]
    cuts_m[1:-1] = np.minimum(cut_max_m, 0.5 * np.minimum(lengths_m[:-1], lengths_m[1:]))
    left = np.arange(1, len(path_m) - 1)
    for _ in range(CUT_HALVINGS + 1):
        begins, ends = cuts_m[left, None] * directions[left - 1], cuts_m[left, None] * directions[left]
        chords = np.stack((path_m[left] - begins, path_m[left], path_m[left] + ends, path_m[left] - begins), axis=1)
        inside = shapely.covers(around, shapely.polygons(chords))
        left = left[~np.asarray(inside, bool)]
        cuts_m[left] *= 0.5
    cuts_m[left] = 0.0
    return cuts_m


def picture_distances(length_m: float, spacing_m: float) -> Array:
    """Distances along the path at which pictures are taken: from the start, at even spacing.

    Source: thesis Alg. 6, eq. 3.7.
    """
    count = int(length_m / spacing_m + 1e-9) + 1
    distances: Array = np.arange(count, dtype=np.float64) * spacing_m
    return distances
