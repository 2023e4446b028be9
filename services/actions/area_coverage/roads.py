"""Shortest ways inside an area, around its holes and inner corners."""

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from shapely.geometry import MultiPolygon, Polygon

Array = NDArray[np.float64]


class Roads:
    """Visibility graph over the corners of an area that a way can bend around.

    Args:
        area: that ways may not leave.
        tolerance_m: distance by which a way may leave the area.
    """

    def __init__(self, area: Polygon | MultiPolygon, tolerance_m: float) -> None:
        self._area = area.buffer(tolerance_m, join_style="mitre")
        shapely.prepare(self._area)
        self._bends = _bends(area)
        count = len(self._bends)
        first, second = np.triu_indices(count, 1)
        inside = self.is_inside(self._bends[first], self._bends[second])
        lengths = np.full((count, count), np.inf)
        lengths[first[inside], second[inside]] = np.linalg.norm(self._bends[first] - self._bends[second], axis=1)[
            inside
        ]
        self._lengths, self._before = dijkstra(
            np.where(np.isinf(lengths), 0.0, lengths), directed=False, return_predecessors=True
        )

    def is_inside(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Whether the straight lines between points, (n, 2) each, run inside the area."""
        if len(starts) == 0:
            return np.zeros(0, bool)
        lines = shapely.linestrings(np.stack((starts, ends), axis=1))
        return np.asarray(shapely.covers(self._area, lines), bool)

    def way(self, start: Array, end: Array) -> Array:
        """(n, 2) points of the shortest way, both ends included; the straight line where there is no way."""
        if self.is_inside(start[None], end[None])[0] or len(self._bends) == 0:
            return np.array((start, end))
        from_start, to_end = self._reach(start), self._reach(end)
        total = from_start[:, None] + self._lengths + to_end[None, :]
        first, last = np.unravel_index(int(np.argmin(total)), total.shape)
        if not np.isfinite(total[first, last]):
            return np.array((start, end))
        bends = [int(last)]
        while bends[-1] != first:
            bends.append(int(self._before[first, bends[-1]]))
        return np.array((start, *(self._bends[i] for i in reversed(bends)), end))

    def _reach(self, point: Array) -> Array:
        """Distance to each bend that a straight line inside the area reaches, else infinity."""
        starts = np.broadcast_to(point, self._bends.shape)
        distances = np.linalg.norm(self._bends - point, axis=1)
        return np.where(self.is_inside(starts, self._bends), distances, np.inf)


def _bends(area: Polygon | MultiPolygon) -> Array:
    """Corners at which a way can bend: the reflex corners of the outline."""
    found = []
    for part in shapely.get_parts(area):
        outlined = shapely.geometry.polygon.orient(part)
        for ring in (outlined.exterior, *outlined.interiors):
            corners = np.array(ring.coords)[:-1]
            before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
            found.append(corners[before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] < -1e-9])
    return np.concatenate(found) if found else np.zeros((0, 2))
