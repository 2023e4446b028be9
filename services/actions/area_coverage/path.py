"""The path over an area: outline, cells of sweep lines, left-overs, in a short order, without leaving the area."""

from collections.abc import Iterator, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, MultiPolygon, Point, Polygon

from jezero.services.actions.area_coverage.roads import Roads
from jezero.services.actions.area_coverage.tour import order_tracks
from jezero.services.actions.area_coverage.tracks import Track, left_over_tracks, outline_tracks, sweep_tracks

Array = NDArray[np.float64]
ANGLES_MAX = 10
INSETS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Distances from the outline at which sweep lines may end, in resolutions."""
COVERED_BY_LINES_MIN = 0.995
"""Fraction of the area that outline and sweep lines must cover."""
COVERED_MIN = 0.998
"""Fraction of the area that must be covered together with the passes through the parts left over."""
TURN_COST_M = 0.1
"""A turn costs as much as this length of a straight line."""
LEFT_OVER_ROUNDS = 3
CUT_HALVINGS = 6
OUTSIDE_STEP_M = 0.1
"""Spacing of the points at which a path outside its area is measured."""
ROUNDING_M = 1e-3
"""What a turn may leave the area by: far below what a vehicle flies by, and far above errors of rounding."""


def plan_path(
    area: Polygon,
    resolution_m: float,
    start_m: Sequence[float] | None = None,
    fly: Polygon | None = None,
    angle_rad: float | None = None,
) -> Array:
    """Plan a path from which every point of the area is at most half a resolution away, as far as the area allows.

    Args:
        area: metres, (north, east).
        start_m: (2,) the vehicle's position; the path begins near it.
        fly: part of the area that the path may not leave; the whole area by default.
        angle_rad: direction of the sweep lines, from north towards east; None chooses the one with the shortest path.

    Returns:
        (n, 2) corners of the path.
    """
    fly = area if fly is None else fly
    tracks = outline_tracks(area, resolution_m)
    angles_rad = _angles(area) if angle_rad is None else [angle_rad % np.pi]
    tracks += _best_sweep(area, resolution_m, tracks, angles_rad)
    for _ in range(LEFT_OVER_ROUNDS):
        left = left_over_tracks(area, swept(tracks_of(tracks), resolution_m), resolution_m, COVERED_MIN, fly)
        if not left:
            break
        tracks += left
    start = None if start_m is None else np.asarray(start_m, float)
    return _joined(order_tracks(tracks, start), fly, resolution_m)


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


def distance_outside_m(path_m: Array, area: Polygon) -> float:
    """Greatest distance of a path, (n, 2), from an area that it should not leave.

    0 inside; infinite for a path that has a coordinate which is no finite number.
    """
    if not np.isfinite(path_m).all():
        return np.inf
    shapely.prepare(area)
    outside = LineString(path_m).difference(area)
    between_m = shapely.get_coordinates(shapely.segmentize(outside, OUTSIDE_STEP_M))
    # The difference has no points where the path stands still, so the path's own points are measured too.
    points = shapely.points(np.concatenate((between_m, path_m)))
    return float(shapely.distance(points, area).max())


def tracks_of(tracks: Sequence[Track]) -> list[Array]:
    """One variant of each track."""
    return [track.variants[0] for track in tracks]


def swept(ways: Sequence[Array], resolution_m: float) -> Polygon | MultiPolygon:
    """The ground within half a resolution of the ways."""
    lines = [Point(way[0]) if np.ptp(way, axis=0).max() == 0.0 else LineString(way) for way in ways]
    return shapely.union_all([line.buffer(0.5 * resolution_m) for line in lines])


def covered_fraction(area: Polygon, path_m: Array, resolution_m: float) -> float:
    """Fraction of the area within half a resolution of the path."""
    return float(area.intersection(swept([path_m], resolution_m)).area / area.area)


def _best_sweep(area: Polygon, resolution_m: float, outline: list[Track], angles_rad: Sequence[float]) -> list[Track]:
    """The cheapest sweep that covers enough together with the outline; else the sweep that covers most."""
    done = swept(tracks_of(outline), resolution_m)
    trials = [
        sweep_tracks(area, resolution_m, angle_rad, inset * resolution_m)
        for angle_rad in angles_rad
        for inset in INSETS
    ]
    best: tuple[float, list[Track]] = (-1.0, [])
    for trial in sorted(trials, key=_cost_m):
        covered = shapely.union_all([done, swept(tracks_of(trial), resolution_m)]) if trial else done
        fraction = area.intersection(covered).area / area.area
        if fraction > best[0]:
            best = (fraction, trial)
        if fraction >= COVERED_BY_LINES_MIN:
            break
    return best[1]


def _angles(area: Polygon) -> list[float]:
    """Directions of the longest edges of outlines and convex hull."""
    rings = [area.exterior, *area.interiors, area.convex_hull.exterior]
    edges = np.concatenate([np.diff(np.array(ring.coords), axis=0) for ring in rings])
    longest = edges[np.argsort(-np.linalg.norm(edges, axis=1), kind="stable")][: 3 * ANGLES_MAX]
    angles = np.arctan2(longest[:, 1], longest[:, 0]) % np.pi
    return list(dict.fromkeys(round(float(angle), 2) for angle in angles))[:ANGLES_MAX]


def _cost_m(tracks: list[Track]) -> float:
    """Cost of sweep lines: their length, their turns and the ways between cells."""
    lengths = [float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) for way in tracks_of(tracks)]
    corners = sum(len(way) for way in tracks_of(tracks))
    return sum(lengths) + TURN_COST_M * (corners + 4 * len(tracks))


def _joined(ways: list[Array], area: Polygon, resolution_m: float) -> Array:
    """Join the ways in turn, by ways inside the area wherever a straight line would leave it."""
    if not ways:
        return np.array([area.representative_point().coords[0]] * 2)
    clear = area.buffer(-0.25 * resolution_m, join_style="mitre", mitre_limit=2.0).simplify(0.02 * resolution_m)
    inner = None if clear.is_empty else Roads(clear, 1e-6)
    outer = Roads(area, 1e-6)
    points = _moved_inside(np.concatenate(ways), area)
    points = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)]
    joined = [points[:1]]
    for step in _steps(points, inner, outer):
        joined.append(step[1:])
    return np.concatenate(joined)


def _moved_inside(points: Array, area: Polygon) -> Array:
    """The points, those outside the area moved to the nearest point of it: simplified tracks may cut its corners."""
    shapely.prepare(area)
    to_points = shapely.shortest_line(area, shapely.points(points))
    nearest: Array = shapely.get_coordinates(shapely.get_point(to_points, 0))
    return np.where(shapely.covers(area, shapely.points(points))[:, None], points, nearest)


def _steps(points: Array, inner: Roads | None, outer: Roads) -> Iterator[Array]:
    """Ways from each point to the next; clear of the outline where that is possible."""
    straight = outer.is_inside(points[:-1], points[1:])
    for start, end, is_straight in zip(points, points[1:], straight, strict=False):
        if is_straight:
            yield np.array((start, end))
            continue
        way = None if inner is None else inner.way(start, end)
        if way is None or not outer.is_inside(way[:-1], way[1:]).all():
            way = outer.way(start, end)
        yield way
