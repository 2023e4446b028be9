"""Comparison of measured positions with the vehicle's own motion, which finds a wrong geometry of the anchors."""

from collections import deque
from math import atan2, degrees, hypot, sqrt
from typing import NamedTuple

from jezero.schemas.units import NS_PER_S

WINDOW_NS = 8 * NS_PER_S
PERIOD_NS = NS_PER_S // 4
EXTENT_MIN_M = 0.35
"""RMS distance from the mean of the window's places; with less motion the directions say nothing."""
DIFFERENCE_MAX = 0.45
"""Measured motion that is turned by 26 degrees, or 45 % too long or too short, contradicts the vehicle's own."""
SIGMAS = 4.0
LASTS_NS = NS_PER_S


class _Place(NamedTuple):
    """One position of the vehicle relative to the rover, north and east, by dead reckoning and as measured."""

    t_ns: int
    reckoned_m: tuple[float, float]
    measured_m: tuple[float, float]
    std_m: float


class MotionCheck:
    """Fits the measured path to the dead-reckoned one by a turn and a factor; both should be none.

    Attributes:
        contradiction: how the measured path differs, or "".
        turn_rad: angle by which the measured path is turned, clockwise; 0 when its length is wrong too.
    """

    def __init__(self) -> None:
        self.contradiction = ""
        self.turn_rad = 0.0
        self._places: deque[_Place] = deque()
        self._since_ns: int | None = None

    def clear(self) -> None:
        """Start again, because one of the two paths jumped."""
        self.contradiction = ""
        self._places.clear()
        self._since_ns = None

    def is_due(self, t_ns: int) -> bool:
        """Whether the next position is due."""
        return not self._places or t_ns - self._places[-1].t_ns >= PERIOD_NS

    def add(self, t_ns: int, reckoned_m: tuple[float, float], measured_m: tuple[float, float], std_m: float) -> None:
        """Add a position, north and east of the rover.

        Args:
            reckoned_m: (2,) by dead reckoning, from any origin.
            measured_m: (2,) measured.
            std_m: standard deviation of the measured position on an axis.
        """
        places = self._places
        places.append(_Place(t_ns, reckoned_m, measured_m, std_m))
        while places[0].t_ns < t_ns - WINDOW_NS:
            places.popleft()
        found = self._difference()
        if found is None:
            return
        if not found:
            self._since_ns, self.contradiction = None, ""
            return
        self._since_ns = t_ns if self._since_ns is None else self._since_ns
        if t_ns - self._since_ns >= LASTS_NS:
            self.contradiction = found

    def _difference(self) -> str | None:
        """How the paths differ, "" when they agree; None when the window holds too little motion."""
        places, n = self._places, len(self._places)
        mean = [sum(p.reckoned_m[i] for p in places) / n for i in (0, 1)]
        mean += [sum(p.measured_m[i] for p in places) / n for i in (0, 1)]
        along = across = square = 0.0
        for p in places:
            north, east = p.reckoned_m[0] - mean[0], p.reckoned_m[1] - mean[1]
            to_north, to_east = p.measured_m[0] - mean[2], p.measured_m[1] - mean[3]
            along += north * to_north + east * to_east
            across += north * to_east - east * to_north
            square += north * north + east * east
        extent_m = sqrt(square / n)
        if extent_m < EXTENT_MIN_M:
            return None
        along, across = along / square, across / square
        std = max(p.std_m for p in places) / extent_m * sqrt(3.0 / n)
        if hypot(along - 1.0, across) < DIFFERENCE_MAX + SIGMAS * std:
            return ""
        length = hypot(along, across)
        self.turn_rad = atan2(across, along) if abs(length - 1.0) < DIFFERENCE_MAX else 0.0
        return (
            f"turned by {degrees(atan2(across, along)):.0f} degrees against the vehicle's own motion and "
            f"{length:.1f} times as long"
        )
