"""The path over an area, without leaving it, in four steps.

1. Tracks that together bring every point of the area within half a resolution of the path. A pass along the outline,
   half a resolution inside, covers slanted edges and corners that sweep lines leave out; sweep lines cover the rest,
   cell by cell; parts narrower than the resolution, and parts left over, get a pass down their middle.
2. The direction of the sweep lines: the cheapest one that covers enough.
3. The order in which the tracks are flown, and the end from which each is flown: short ways between them.
4. The ways between the tracks: shortest ways inside the area, around its holes and inner corners.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, MultiPolygon, Point, Polygon

from jezero.base.arrays import Array
from jezero.services.actions.area_coverage.area import polygons_of

Track = tuple[Array, ...]
"""A part of the path: the ways in which it can be flown, (n, 2) points each."""
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
OUTSIDE_STEP_M = 0.1
"""Spacing of the points at which a path outside its area is measured."""


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
    tracks = _outline_tracks(area, resolution_m)
    angles_rad = _angles(area) if angle_rad is None else [angle_rad % np.pi]
    tracks += _best_sweep(area, resolution_m, tracks, angles_rad)
    for _ in range(LEFT_OVER_ROUNDS):
        left = _left_over_tracks(area, _swept(_first_ways(tracks), resolution_m), resolution_m, COVERED_MIN, fly)
        if not left:
            break
        tracks += left
    start = None if start_m is None else np.asarray(start_m, float)
    return _joined(_order_tracks(tracks, start), fly, resolution_m)


def covered_fraction(area: Polygon, path_m: Array, resolution_m: float) -> float:
    """Fraction of the area within half a resolution of the path."""
    return float(area.intersection(_swept([path_m], resolution_m)).area / area.area)


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


def _angles(area: Polygon) -> list[float]:
    """Directions of the longest edges of outlines and convex hull."""
    rings = [area.exterior, *area.interiors, area.convex_hull.exterior]
    edges = np.concatenate([np.diff(np.array(ring.coords), axis=0) for ring in rings])
    longest = edges[np.argsort(-np.linalg.norm(edges, axis=1), kind="stable")][: 3 * ANGLES_MAX]
    angles = np.arctan2(longest[:, 1], longest[:, 0]) % np.pi
    return list(dict.fromkeys(round(float(angle), 2) for angle in angles))[:ANGLES_MAX]


def _best_sweep(area: Polygon, resolution_m: float, outline: list[Track], angles_rad: Sequence[float]) -> list[Track]:
    """The cheapest sweep that covers enough together with the outline; else the sweep that covers most."""
    done = _swept(_first_ways(outline), resolution_m)
    trials = [
        _sweep_tracks(area, resolution_m, angle_rad, inset * resolution_m)
        for angle_rad in angles_rad
        for inset in INSETS
    ]
    best: tuple[float, list[Track]] = (-1.0, [])
    for trial in sorted(trials, key=_cost_m):
        covered = shapely.union_all([done, _swept(_first_ways(trial), resolution_m)]) if trial else done
        fraction = area.intersection(covered).area / area.area
        if fraction > best[0]:
            best = (fraction, trial)
        if fraction >= COVERED_BY_LINES_MIN:
            break
    return best[1]


def _cost_m(tracks: list[Track]) -> float:
    """Cost of sweep lines: their length, their turns and the ways between cells."""
    lengths = [float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) for way in _first_ways(tracks)]
    corners = sum(len(way) for way in _first_ways(tracks))
    return sum(lengths) + TURN_COST_M * (corners + 4 * len(tracks))


def _first_ways(tracks: Sequence[Track]) -> list[Array]:
    """One variant of each track."""
    return [track[0] for track in tracks]


def _swept(ways: Sequence[Array], resolution_m: float) -> Polygon | MultiPolygon:
    """The ground within half a resolution of the ways."""
    lines = [Point(way[0]) if np.ptp(way, axis=0).max() == 0.0 else LineString(way) for way in ways]
    return shapely.union_all([line.buffer(0.5 * resolution_m) for line in lines])


def _outline_tracks(area: Polygon, resolution_m: float) -> list[Track]:
    """One closed pass along each outline of the area, half a resolution inside."""
    inner = area.buffer(-0.5 * resolution_m, quad_segs=4)
    rings = [ring for part in polygons_of(inner) for ring in (part.exterior, *part.interiors)]
    return [_entries(np.array(ring.simplify(0.02 * resolution_m).coords)) for ring in rings]


def _sweep_tracks(area: Polygon, resolution_m: float, angle_rad: float, inset_m: float) -> list[Track]:
    """One zigzag of parallel lines for each cell of the area.

    Args:
        angle_rad: of the lines, from north towards east.
        inset_m: distance from the area's outline at which the lines end.
    """
    core = area.buffer(-resolution_m, quad_segs=4)
    field = area.buffer(-inset_m, quad_segs=4)
    if core.is_empty or field.is_empty:
        return []
    back = _turn_back(angle_rad)
    rows = _rows(field, back, _levels(core, back, resolution_m))
    return [tuple(way @ back for way in _zigzags(cell)) for cell in _cells(rows)]


def _left_over_tracks(
    area: Polygon, covered: Polygon | MultiPolygon, resolution_m: float, enough: float, fly: Polygon
) -> list[Track]:
    """Passes down the middles of uncovered pieces, the largest first, until the fraction `enough` is covered.

    Args:
        fly: part of the area that the passes may not leave.
    """
    found: list[Track] = []
    pieces = sorted(polygons_of(area.difference(covered)), key=lambda piece: -piece.area)
    left_m2 = sum(piece.area for piece in pieces)
    for piece in pieces:
        if left_m2 <= (1.0 - enough) * area.area:
            break
        left_m2 -= piece.area
        for part in [piece] if fly is area else polygons_of(piece.intersection(fly)):
            found.extend(_middles(part, resolution_m))
    return found


def _middles(piece: Polygon, resolution_m: float) -> Iterator[Track]:
    """Passes through the middles of a piece's cross-sections; several where it forks or bends back."""
    box = np.array(piece.minimum_rotated_rectangle.exterior.coords)
    edges = np.diff(box[:3], axis=0)
    along = edges[int(np.argmax(np.linalg.norm(edges, axis=1)))]
    back = _turn_back(float(np.arctan2(along[1], along[0])) + 0.5 * np.pi)
    for cell in _cells(_rows(piece, back, _levels(piece, back, 0.5 * resolution_m))):
        middles = np.array([chord.mean(axis=0) for chord in cell]) @ back
        straightened = LineString(middles).simplify(0.05 * resolution_m) if len(middles) > 1 else None
        points = np.repeat(middles, 2, axis=0) if straightened is None else np.array(straightened.coords)
        yield points, points[::-1]


def _rows(area: Polygon | MultiPolygon, back: Array, ys: Array) -> list[list[Array]]:
    """The pieces inside the area of each line, (2, 2) each, in the lines' own axes, from left to right."""
    reach = shapely.get_coordinates(area) @ back.T
    left, right = np.full(len(ys), reach[:, 0].min() - 1.0), np.full(len(ys), reach[:, 0].max() + 1.0)
    lines = np.stack((np.column_stack((left, ys)), np.column_stack((right, ys))), axis=1) @ back
    cuts, owners = shapely.get_parts(shapely.intersection(shapely.linestrings(lines), area), return_index=True)
    rows: list[list[Array]] = [[] for _ in ys]
    for cut, owner in zip(cuts[shapely.length(cuts) > 0.0], owners[shapely.length(cuts) > 0.0], strict=True):
        piece = shapely.get_coordinates(cut) @ back.T
        rows[owner].append(piece[np.argsort(piece[:, 0])][[0, -1]])
    return [sorted(row, key=lambda piece: float(piece[0, 0])) for row in rows]


def _levels(area: Polygon | MultiPolygon, back: Array, spacing_max_m: float) -> Array:
    """Positions of the lines across their direction: evenly, half a spacing from the area's ends."""
    reach = shapely.get_coordinates(area) @ back.T
    low, high = float(reach[:, 1].min()), float(reach[:, 1].max())
    count = max(1, ceil((high - low) / spacing_max_m - 1e-6))
    return low + (np.arange(count) + 0.5) * (high - low) / count


def _cells(rows: list[list[Array]]) -> list[list[Array]]:
    """Boustrophedon decomposition: chords of neighbouring lines that overlap only each other are one cell."""
    finished: list[list[Array]] = []
    running: list[list[Array]] = []
    for row in rows:
        above = [[i for i, cell in enumerate(running) if _overlap(cell[-1], chord)] for chord in row]
        below = [[j for j, chord in enumerate(row) if _overlap(cell[-1], chord)] for cell in running]
        following: list[list[Array]] = []
        goes_on = set()
        for j, chord in enumerate(row):
            if len(above[j]) == 1 and below[above[j][0]] == [j]:
                goes_on.add(above[j][0])
                running[above[j][0]].append(chord)
                following.append(running[above[j][0]])
            else:
                following.append([chord])
        finished.extend(cell for i, cell in enumerate(running) if i not in goes_on)
        running = following
    return finished + running


def _overlap(a: Array, b: Array) -> bool:
    return bool(min(a[1, 0], b[1, 0]) > max(a[0, 0], b[0, 0]))


def _zigzags(chords: list[Array]) -> Iterator[Array]:
    """The four zigzags of a cell: from either side of the first line, and both backwards."""
    for first in (0, 1):
        way = np.concatenate([chord if i % 2 == first else chord[::-1] for i, chord in enumerate(chords)])
        yield way
        yield way[::-1]


def _entries(ring: Array) -> tuple[Array, ...]:
    """A closed way, begun at each of its corners."""
    corners = ring[:-1]
    rolled = [np.roll(corners, -i, axis=0) for i in range(len(corners))]
    return tuple(np.concatenate((way, way[:1])) for way in rolled)


def _turn_back(angle_rad: float) -> Array:
    """(2, 2) matrix that turns rows of points from the lines' own axes, along and across, into north and east."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array(((c, s), (-s, c)))


TRIALS_MAX = 400


class _Ends:
    """Both ends of the variants of all tracks.

    Attributes:
        entries: for each track the (n, 2) begins of its variants.
        exits: for each track the (n, 2) ends of its variants.
    """

    def __init__(self, entries: list[Array], exits: list[Array]) -> None:
        self.entries = entries
        self.exits = exits
        self._gaps_m: dict[tuple[int, int], Array] = {}

    def gaps_m(self, before: int, after: int) -> Array:
        """Distances from the exits of one track, in rows, to the entries of another one; the trials repeat most."""
        gaps_m = self._gaps_m.get((before, after))
        if gaps_m is None:
            between = self.exits[before][:, None, :] - self.entries[after][None, :, :]
            gaps_m = self._gaps_m[before, after] = np.sqrt(np.einsum("ijk,ijk->ij", between, between))
        return gaps_m


def _order_tracks(tracks: Sequence[Track], start_m: Array | None) -> list[Array]:
    """Order the tracks so that the ways between them are short: nearest neighbour, then 2-opt.

    Distances are those of straight lines; the ways themselves are found later.
    """
    if not tracks:
        return []
    ends = _Ends(
        [np.array([way[0] for way in track]) for track in tracks],
        [np.array([way[-1] for way in track]) for track in tracks],
    )
    order = _nearest(ends, start_m)
    cost, chosen = _choose(order, ends, start_m)
    trials = 0
    improved = True
    while improved and trials < TRIALS_MAX:
        improved = False
        for i in range(len(order) - 1):
            for j in range(i + 1, len(order)):
                trial = order[:i] + order[i : j + 1][::-1] + order[j + 1 :]
                trial_cost, trial_chosen = _choose(trial, ends, start_m)
                trials += 1
                if trial_cost < cost - 1e-9:
                    order, cost, chosen, improved = trial, trial_cost, trial_chosen, True
            if trials >= TRIALS_MAX:
                break
    return [tracks[i][variant] for i, variant in zip(order, chosen, strict=True)]


def _nearest(ends: _Ends, start_m: Array | None) -> list[int]:
    entries, exits = ends.entries, ends.exits
    at = entries[0][0] if start_m is None else start_m
    left, order = set(range(len(entries))), []
    while left:
        distances = {i: np.linalg.norm(entries[i] - at, axis=1) for i in left}
        nearest = min(left, key=lambda i: (float(distances[i].min()), i))
        at = exits[nearest][int(np.argmin(distances[nearest]))]
        order.append(nearest)
        left.remove(nearest)
    return order


def _choose(order: list[int], ends: _Ends, start_m: Array | None) -> tuple[float, list[int]]:
    """The variants with the shortest ways between them for a given order, by dynamic programming."""
    first = ends.entries[order[0]]
    costs = np.zeros(len(first)) if start_m is None else np.linalg.norm(first - start_m, axis=1)
    froms: list[NDArray[np.intp]] = []
    for before, after in pairwise(order):
        total = costs[:, None] + ends.gaps_m(before, after)
        nearest = total.argmin(axis=0)
        froms.append(nearest)
        costs = total[nearest, np.arange(total.shape[1])]
    chosen = [int(np.argmin(costs))]
    for back in reversed(froms):
        chosen.append(int(back[chosen[-1]]))
    return float(costs.min()), chosen[::-1]


DETOURS = (1.5, 4.0, np.inf)
"""Lengths up to which a way is looked for, one after the other, divided by that of the straight line: only bends that
such a way can reach are looked at."""


class Roads:
    """Visibility graph over the corners of an area that a way can bend around; its edges are found when needed.

    Args:
        area: that ways may not leave.
        tolerance_m: distance by which a way may leave the area.
    """

    def __init__(self, area: Polygon | MultiPolygon, tolerance_m: float) -> None:
        inside = area.buffer(tolerance_m, join_style="mitre")
        self._outside = shapely.box(*area.bounds).buffer(1.0).difference(inside)
        shapely.prepare(self._outside)
        self._bends, self._before, self._after = _bends(area)
        count = len(self._bends)
        self._edges_m = np.full((count, count), np.nan)
        """Lengths of the straight ways between bends, infinite where there is none; NaN where nobody has looked yet."""

    def is_inside(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Whether the straight lines between points of the area, (n, 2) each, run inside it."""
        if len(starts) == 0:
            return np.zeros(0, bool)
        lines = shapely.linestrings(np.stack((starts, ends), axis=1))
        return np.asarray(~shapely.intersects(self._outside, lines), bool)

    def way(self, start: Array, end: Array) -> Array:
        """(n, 2) points of the shortest way, both ends included; the straight line where there is no way."""
        straight = np.array((start, end))
        if self.is_inside(start[None], end[None])[0]:
            return straight
        to_start, to_end = (np.linalg.norm(self._bends - point, axis=1) for point in (start, end))
        direct_m = float(np.linalg.norm(end - start))
        for detour in DETOURS:
            near = np.flatnonzero(to_start + to_end <= detour * direct_m)
            found = self._shortest(start, end, near, detour * direct_m)
            if found is not None:
                return np.array((start, *self._bends[found], end))
        return straight

    def _shortest(self, start: Array, end: Array, near: NDArray[np.intp], length_max_m: float) -> list[int] | None:
        """Bends of the shortest way over some of them, by A*; None when it would be longer than the limit."""
        if len(near) == 0:
            return None
        bends = self._bends[near]
        rest_m = np.linalg.norm(bends - end, axis=1)
        starts, ends = np.broadcast_to(start, bends.shape), np.broadcast_to(end, bends.shape)
        way_m = np.where(self.is_inside(starts, bends), np.linalg.norm(bends - start, axis=1), np.inf)
        at_end = np.where(self.is_inside(bends, ends), rest_m, np.inf)
        before = np.full(len(near), -1)
        estimate_m = way_m + rest_m
        best_m, last = np.inf, -1
        while (nearest := int(np.argmin(estimate_m))) >= 0 and estimate_m[nearest] < min(best_m, length_max_m + 1e-9):
            estimate_m[nearest] = np.inf
            if way_m[nearest] + at_end[nearest] < best_m:
                best_m, last = float(way_m[nearest] + at_end[nearest]), nearest
            onwards_m = way_m[nearest] + self._edges(int(near[nearest]), near)
            shorter = onwards_m < way_m - 1e-12
            way_m[shorter], before[shorter] = onwards_m[shorter], nearest
            estimate_m[shorter] = way_m[shorter] + rest_m[shorter]
        if last < 0 or best_m > length_max_m + 1e-9:
            return None
        found = [last]
        while before[found[-1]] >= 0:
            found.append(int(before[found[-1]]))
        return [int(near[i]) for i in reversed(found)]

    def _edges(self, bend: int, others: NDArray[np.intp]) -> Array:
        """Distances from a bend to others that a shortest way may go straight to, else infinity."""
        unknown = others[np.isnan(self._edges_m[bend, others])]
        if len(unknown):
            onwards = self._bends[unknown] - self._bends[bend]
            lengths_m = np.full(len(unknown), np.inf)
            taut = np.flatnonzero(self._is_taut(np.full(len(unknown), bend), onwards) & self._is_taut(unknown, onwards))
            starts = np.broadcast_to(self._bends[bend], (len(taut), 2))
            free = taut[self.is_inside(starts, self._bends[unknown[taut]])]
            lengths_m[free] = np.linalg.norm(onwards[free], axis=1)
            self._edges_m[bend, unknown] = self._edges_m[unknown, bend] = lengths_m
        known: Array = self._edges_m[bend, others]
        return known

    def _is_taut(self, bends: NDArray[np.intp], directions: Array) -> NDArray[np.bool_]:
        """Whether the outline at each bend is on one side of a way that passes there in a direction.

        A shortest way lies around its bends like a string that is pulled; all other ways needn't be looked at.
        """
        sides = [
            directions[:, 0] * beside[:, 1] - directions[:, 1] * beside[:, 0]
            for beside in (self._before[bends], self._after[bends])
        ]
        return np.asarray(sides[0] * sides[1] >= -1e-9, bool)


def _bends(area: Polygon | MultiPolygon) -> tuple[Array, Array, Array]:
    """Corners at which a way can bend, the reflex corners of the outline, and from each the corners beside it."""
    found: list[tuple[Array, Array, Array]] = [(np.zeros((0, 2)),) * 3]
    for part in shapely.get_parts(area):
        outlined = shapely.geometry.polygon.orient(part)
        for ring in (outlined.exterior, *outlined.interiors):
            corners = np.array(ring.coords)[:-1]
            before, after = np.roll(corners, 1, axis=0) - corners, np.roll(corners, -1, axis=0) - corners
            reflex = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] > 0.0
            found.append((corners[reflex], before[reflex], after[reflex]))
    bends, before, after = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return bends, before, after


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
