"""Tracks that together bring every point of an area within half a resolution of the path.

A pass along the outline, half a resolution inside, covers slanted edges and corners that sweep lines leave out; sweep
lines cover the rest, cell by cell; parts narrower than the resolution, and parts left over, get a pass down their
middle.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, MultiPolygon, Polygon

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """A part of the path.

    Attributes:
        variants: the ways in which it can be flown, (n, 2) points each.
    """

    variants: tuple[Array, ...]


def outline_tracks(area: Polygon, resolution_m: float) -> list[Track]:
    """One closed pass along each outline of the area, half a resolution inside."""
    inner = area.buffer(-0.5 * resolution_m, quad_segs=4)
    rings = [ring for part in _parts(inner) for ring in (part.exterior, *part.interiors)]
    return [Track(_entries(np.array(ring.simplify(0.02 * resolution_m).coords))) for ring in rings]


def sweep_tracks(area: Polygon, resolution_m: float, angle_rad: float, inset_m: float) -> list[Track]:
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
    return [Track(tuple(way @ back for way in _zigzags(cell))) for cell in _cells(rows)]


def left_over_tracks(
    area: Polygon, covered: Polygon | MultiPolygon, resolution_m: float, enough: float, fly: Polygon
) -> list[Track]:
    """Passes down the middles of uncovered pieces, the largest first, until the fraction `enough` is covered.

    Args:
        fly: part of the area that the passes may not leave.
    """
    found: list[Track] = []
    pieces = sorted(_parts(area.difference(covered)), key=lambda piece: -piece.area)
    left_m2 = sum(piece.area for piece in pieces)
    for piece in pieces:
        if left_m2 <= (1.0 - enough) * area.area:
            break
        left_m2 -= piece.area
        for part in [piece] if fly is area else _parts(piece.intersection(fly)):
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
        yield Track((points, points[::-1]))


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


def _parts(area: Polygon | MultiPolygon) -> list[Polygon]:
    return [part for part in shapely.get_parts(area) if isinstance(part, Polygon) and not part.is_empty]
