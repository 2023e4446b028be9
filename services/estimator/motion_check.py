"""Comparison of measured positions with the motion of vehicle and rover, which finds what measures them wrong.

The measured path is that of UWB or of the tags. When it differs from the dead-reckoned one, one of two things explains
it: the path is turned or has another length, by a wrong geometry of anchors, camera or tags; or the rover drives at
another speed than its odometry says.
"""

from collections import deque
from math import atan2, degrees, hypot, sqrt
from typing import NamedTuple

from jezero.schemas.units import NS_PER_S

WINDOW_NS = 8 * NS_PER_S
PERIOD_NS = NS_PER_S // 4
EXTENT_MIN_M = 0.35
"""RMS distance from the mean of the window's places; with less motion the directions say nothing."""
DIFFERENCE_MAX = 0.45
"""Measured motion that is turned by 26 degrees, or 45 % too long or too short, contradicts the dead-reckoned one."""
LENGTH_KEPT_MAX = 0.15
"""A path that is only turned keeps its length within this; what else explains it comes second then. On straight ways
both a turn and another speed of the rover may explain a difference."""
SPEED_ERROR_MIN_MPS = 0.3
EXPLAINED_MAX = 0.5
"""Another speed of the rover explains a difference when it leaves less than this part of it."""
SIGMAS = 4.0
LASTS_NS = NS_PER_S

Place = tuple[float, float]
"""North and east in m."""


class PathDifference(NamedTuple):
    """How a measured path differs from the dead-reckoned one.

    Attributes:
        text: the difference, for people; "" for paths that agree.
        turn_rad: angle by which the measured path is turned, clockwise; 0 when its length is wrong too, or when the
            rover's speed is wrong.
        speed_error_mps: true speed of the rover along its heading minus that of its odometry, when that explains the
            difference; else 0.
    """

    text: str = ""
    turn_rad: float = 0.0
    speed_error_mps: float = 0.0


AGREES = PathDifference()


class PathSample(NamedTuple):
    """Places at one time.

    Attributes:
        t_ns: their time.
        reckoned_m: the vehicle relative to the rover by the odometry of both, from an origin that stays.
        heading_way_m: way of a rover that drives at 1 m/s along its heading, from an origin that stays.
        measured_m: the vehicle relative to the rover, as measured.
        std_m: standard deviation of the measured position on an axis.
    """

    t_ns: int
    reckoned_m: Place
    heading_way_m: Place
    measured_m: Place
    std_m: float


class MotionCheck:
    """Fits the measured path to the dead-reckoned one.

    Attributes:
        contradiction: the difference that has lasted, or `AGREES`.
        difference: the newest difference, or `AGREES`.
    """

    def __init__(self) -> None:
        self.contradiction = self.difference = AGREES
        self._samples: deque[PathSample] = deque()
        self._since_ns: int | None = None

    def clear(self) -> None:
        """Start again, because one of the two paths jumped."""
        self.contradiction = self.difference = AGREES
        self._samples.clear()
        self._since_ns = None

    def is_due(self, t_ns: int) -> bool:
        """Whether the next sample is due."""
        return not self._samples or t_ns - self._samples[-1].t_ns >= PERIOD_NS

    def add(self, sample: PathSample) -> None:
        """Add a sample."""
        samples, t_ns = self._samples, sample.t_ns
        samples.append(sample)
        while samples[0].t_ns < t_ns - WINDOW_NS:
            samples.popleft()
        found = _difference(list(samples))
        if found is None:
            return
        self.difference = found
        if not found.text:
            self._since_ns, self.contradiction = None, AGREES
            return
        self._since_ns = t_ns if self._since_ns is None else self._since_ns
        if t_ns - self._since_ns >= LASTS_NS:
            self.contradiction = found


def _difference(samples: list[PathSample]) -> PathDifference | None:
    """How the paths differ; None when the samples hold too little motion."""
    n = len(samples)
    reckoned, way = _centred([s.reckoned_m for s in samples]), _centred([s.heading_way_m for s in samples])
    measured = _centred([s.measured_m for s in samples])
    std_mean_m = SIGMAS * max(s.std_m for s in samples) * sqrt(3.0 / n)
    by_speed, rest_speed_m = _by_speed(reckoned, way, measured, std_mean_m)
    square_m2 = sum(north * north + east * east for north, east in reckoned)
    extent_m = sqrt(square_m2 / n)
    if extent_m < EXTENT_MIN_M:
        return by_speed
    pairs = list(zip(reckoned, measured, strict=True))
    along = sum(a[0] * b[0] + a[1] * b[1] for a, b in pairs) / square_m2
    across = sum(a[0] * b[1] - a[1] * b[0] for a, b in pairs) / square_m2
    if hypot(along - 1.0, across) < DIFFERENCE_MAX + std_mean_m / extent_m:
        return by_speed or AGREES
    length = hypot(along, across)
    rest_m = _rms([(b[0] - along * a[0] + across * a[1], b[1] - across * a[0] - along * a[1]) for a, b in pairs])
    turn_rad = atan2(across, along) if abs(length - 1.0) < DIFFERENCE_MAX else 0.0
    only_turned = abs(length - 1.0) < LENGTH_KEPT_MAX and rest_m <= rest_speed_m + std_mean_m
    if by_speed is not None and not only_turned:
        return by_speed
    return PathDifference(
        f"turned by {degrees(atan2(across, along)):.0f} degrees against the motion of vehicle and rover and "
        f"{length:.1f} times as long",
        turn_rad=turn_rad,
    )


def _by_speed(
    reckoned: list[Place], way: list[Place], measured: list[Place], std_mean_m: float
) -> tuple[PathDifference | None, float]:
    """The difference that another speed of the rover explains, None for none, and the RMS distance that it leaves."""
    apart = [(m[0] - r[0], m[1] - r[1]) for m, r in zip(measured, reckoned, strict=True)]
    extent_m = _rms(way)
    if extent_m < EXTENT_MIN_M:
        return None, 0.0
    faster_mps = -sum(a[0] * w[0] + a[1] * w[1] for a, w in zip(apart, way, strict=True)) / len(way) / extent_m**2
    rest_m = _rms([(a[0] + faster_mps * w[0], a[1] + faster_mps * w[1]) for a, w in zip(apart, way, strict=True)])
    if abs(faster_mps) < SPEED_ERROR_MIN_MPS + std_mean_m / extent_m or rest_m > EXPLAINED_MAX * _rms(apart):
        return None, rest_m
    return PathDifference(
        f"that of a rover which drives {abs(faster_mps):.1f} m/s {'faster' if faster_mps > 0.0 else 'slower'} than its "
        "odometry says",
        speed_error_mps=faster_mps,
    ), rest_m


def _centred(places: list[Place]) -> list[Place]:
    """The places from their mean."""
    north_m, east_m = sum(p[0] for p in places) / len(places), sum(p[1] for p in places) / len(places)
    return [(p[0] - north_m, p[1] - east_m) for p in places]


def _rms(places: list[Place]) -> float:
    return sqrt(sum(north * north + east * east for north, east in places) / len(places))
