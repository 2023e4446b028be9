"""A path for drawing, of a limited number of points however long it is."""

from jezero.base.frames import Vec3, add, distance

POINTS_MAX = 400
SPACING_MIN_M = 0.1


class ThinnedPath:
    """Points of a path that are a spacing apart; the spacing doubles each time that there are too many."""

    def __init__(self) -> None:
        self._points_m: list[Vec3] = []
        self._spacing_m = SPACING_MIN_M
        self._end_m: Vec3 | None = None

    @property
    def points_m(self) -> tuple[Vec3, ...]:
        """The points so far, with the newest one at the end."""
        if self._end_m is None or self._points_m[-1] == self._end_m:
            return tuple(self._points_m)
        return (*self._points_m, self._end_m)

    def add(self, point_m: Vec3) -> None:
        """Extend the path to a point."""
        self._end_m = point_m
        if self._points_m and distance(point_m, self._points_m[-1]) < self._spacing_m:
            return
        self._points_m.append(point_m)
        if len(self._points_m) > POINTS_MAX:
            del self._points_m[1::2]
            self._spacing_m *= 2.0

    def shift(self, offset_m: Vec3) -> None:
        """Move all points, as after a position reset."""
        self._points_m = [add(point_m, offset_m) for point_m in self._points_m]
        self._end_m = None if self._end_m is None else add(self._end_m, offset_m)

    def clear(self) -> None:
        """Begin a new path."""
        self._points_m, self._end_m, self._spacing_m = [], None, SPACING_MIN_M
