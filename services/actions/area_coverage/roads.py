"""Shortest ways inside an area, around its holes and inner corners."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

Array = NDArray[np.float64]
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
