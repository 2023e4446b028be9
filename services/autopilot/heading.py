"""The heading: which readings of the compass correct it, and its error as measured by the vehicle's own motion.

In the air the gyroscope carries the heading for minutes, while a compass near iron or a current can jump by any angle
and stay there. So a compass that contradicts the heading is rejected for as long as it does. On the ground the heading
is reset to a compass that insists, because the vehicle may have been turned while the filter was disturbed.

In the air the motion measures the heading. Between two GNSS fixes the velocity changes by what the accelerometer
measures, turned into the world by the estimated attitude. When the estimated heading is wrong by an angle, all those
changes are turned by that angle, so the angle can be measured whenever the vehicle accelerates, without a compass.

Source: the purpose of PX4's EKF-GSF yaw estimator; here a fit in closed form takes the place of its bank of filters.
"""

import cmath
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from math import atan2, cos, degrees, inf, sin, sqrt
from typing import Literal

from jezero.base.frames import Vec3, wrap_pi
from jezero.services.autopilot.alignment import FIX_AGE_MAX_US
from jezero.services.autopilot.reset_detector import ResetDetector

# -- the compass -----------------------------------------------------------------------------------------

REOPENS_AFTER = 10
"""After a rejected reading, the compass is fused again when this number of readings in a row lie within the gate. With
noise, single readings of a wrong compass lie within the gate too, and each of them would pull the heading."""


class HeadingGate:
    """Gate of the compass' innovations.

    Attributes:
        landed: whether the vehicle is on the ground.

    Args:
        sensor: what measures the heading, for people.
    """

    def __init__(self, sensor: str = "magnetometer") -> None:
        self.landed = True
        self._sensor = sensor
        self._detector = ResetDetector()
        """Its innovation is the cosine and sine of the heading's innovation, which can be averaged."""
        self._good = REOPENS_AFTER
        """Number of readings within the gate since the last rejected one."""

    @property
    def error_rad(self) -> float:
        """Smoothed innovation while readings are rejected, otherwise 0."""
        if not self._detector.mean_innovation:
            return 0.0
        cosine, sine = self._detector.mean_innovation
        return atan2(sine, cosine)

    @property
    def rejection_reason(self) -> str:
        """Text on the compass that is being rejected, or ""."""
        if not self._detector.mean_innovation:
            return ""
        return f"the {self._sensor}'s heading is {abs(degrees(self.error_rad)):.0f} degrees off the estimate"

    def judge(self, t_us: int, error_rad: float, gate_rad: float) -> Literal["fuse", "reject", "reset"]:
        """Judge one reading; on "reset" the heading is reset by `error_rad`, then `clear` is called.

        Args:
            error_rad: innovation, the heading of the compass minus the estimated one.
            gate_rad: greatest innovation that is fused.
        """
        if abs(error_rad) < gate_rad:
            self._good += 1
            if self._good < REOPENS_AFTER:
                return "reject"
            self.clear()
            return "fuse"
        self._good = 0
        insists = self._detector.update(t_us, (cos(error_rad), sin(error_rad)), gate_rad)
        return "reset" if insists and self.landed else "reject"

    def clear(self) -> None:
        """Forget the rejected readings."""
        self._detector.clear()
        self._good = REOPENS_AFTER


# -- the motion ------------------------------------------------------------------------------------------

SEGMENT_US = 4_000_000
"""Length of one fit. Within it the gyroscope alone carries the attitude, whose drift is small for so long."""
SEGMENTS = 3
"""Number of past fits that count."""
FIXES_MIN = 8
"""A fit needs this number of fixes."""
INDEPENDENT = 6.0
"""Number of independent residuals of one fit: neighbouring ones have most of their error in common."""
ERROR_MIN_RAD, ERROR_SIGMAS, STD_MAX_RAD = 0.25, 3.0, 0.3
"""The heading is contradicted when its error exceeds ERROR_MIN_RAD by more than ERROR_SIGMAS standard deviations. A
measurement with more than STD_MAX_RAD contradicts nothing."""
CONTRADICTIONS = 2
"""The heading is reset after this number of segments in a row that contradict it."""
GROSS_US, GROSS_RAD, GROSS_STD_RAD = 2_000_000, 0.8, 0.12
"""An error that exceeds GROSS_RAD as clearly resets the heading at once, as soon as a segment has this length and
measures it with this standard deviation: with such a heading each correction of the position drives the vehicle away.
"""


@dataclass(frozen=True)
class _Fit:
    """Result of one segment.

    Attributes:
        product: of the integrated accelerations and the GNSS velocities; its angle is that of the heading's error,
            counted from a heading that nothing has corrected since the filter's start.
        energy_m2ps2: of the integrated accelerations.
        residual_m2ps2: sum of the squared velocities that the fit leaves unexplained.
    """

    product: complex
    energy_m2ps2: float
    residual_m2ps2: float


class _Segment:
    """Sums over the fixes of one segment, for a fit that leaves out constant offsets and drifts of the velocity.

    The drift takes the error of the tilt, which turns gravity into an acceleration.
    """

    def __init__(self, t_us: int, turned_ned_rad: Vec3) -> None:
        self.start_us = t_us
        self.turned_ned_rad = turned_ned_rad
        self._samples: list[tuple[float, complex, complex]] = []

    def add(self, t_us: int, integrated_mps: complex, measured_mps: complex) -> None:
        """Add the velocity that the IMU gives since the segment's start, and that of a fix at the same time."""
        self._samples.append(((t_us - self.start_us) * 1e-6, integrated_mps, measured_mps))

    def fit(self) -> _Fit | None:
        """The fit; None with too few fixes."""
        count = len(self._samples)
        if count < FIXES_MIN:
            return None
        times, integrated, measured = zip(*self._samples, strict=True)
        by_imu, by_gnss = _without_trend(times, integrated), _without_trend(times, measured)
        product = sum(u.conjugate() * v for u, v in zip(by_imu, by_gnss, strict=True))
        energy = sum(abs(u) ** 2 for u in by_imu)
        # The heading turns the velocities and doesn't stretch them: other factors than 1 are unexplained, too.
        residual = sum(abs(v) ** 2 for v in by_gnss) + energy - 2.0 * abs(product)
        return _Fit(product * cmath.exp(1j * self.turned_ned_rad[2]), energy, max(0.0, residual))


class MotionHeading:
    """Measures the error of the estimated heading by the vehicle's motion.

    Attributes:
        std_rad: standard deviation of the error as measured; infinite without enough motion.
        insists: whether the heading should be reset by `error_rad`.
    """

    def __init__(self) -> None:
        self.std_rad = inf
        self.insists = False
        self._contradictions = 0
        self._integrated_mps = 0j
        self._turned_ned_rad: Vec3 = (0.0, 0.0, 0.0)
        self._history: deque[tuple[int, complex]] = deque(maxlen=FIX_AGE_MAX_US // 20_000)
        self._segment: _Segment | None = None
        self._fits: deque[_Fit] = deque(maxlen=SEGMENTS)

    @property
    def error_rad(self) -> float:
        """True heading minus estimated heading; only as good as `std_rad` says."""
        product = sum(fit.product for fit in self._fits)
        return wrap_pi(cmath.phase(product) - self._turned_ned_rad[2]) if product else 0.0

    def on_motion(self, t_us: int, delta_vel_ned_mps: Vec3, turned_ned_rad: Vec3) -> None:
        """Integrate one step.

        Args:
            delta_vel_ned_mps: integral of the specific force over the step.
            turned_ned_rad: sum of all corrections of the attitude since the filter's start. Those since the segment's
                start are taken back: they may be the filter's attempt to explain a wrong heading by the tilt.
        """
        self._turned_ned_rad = turned_ned_rad
        if self._segment is None:
            self._segment = _Segment(t_us, turned_ned_rad)
        before = self._segment.turned_ned_rad
        north, east, down = (now - then for now, then in zip(turned_ned_rad, before, strict=True))
        vn, ve, vd = delta_vel_ned_mps
        self._integrated_mps += complex(vn - (east * vd - down * ve), ve - (down * vn - north * vd))
        self._history.append((t_us, self._integrated_mps))

    def on_fix(self, t_us: int, vel_ned_mps: Vec3) -> None:
        """Add the velocity of a fix.

        Args:
            t_us: time of the fix's measurement.
        """
        segment = self._segment
        self.insists = False
        if segment is None or not self._history or t_us < segment.start_us:
            return
        integrated_mps = min(self._history, key=lambda entry: abs(entry[0] - t_us))[1]
        segment.add(t_us, integrated_mps, complex(vel_ned_mps[0], vel_ned_mps[1]))
        duration_us = t_us - segment.start_us
        if duration_us >= SEGMENT_US:
            self._segment = None
            self._evaluate(segment.fit() if duration_us < 2 * SEGMENT_US else None)
        elif duration_us >= GROSS_US and (fit := segment.fit()) is not None and self._is_gross(fit):
            self._segment = None
            self._fits.clear()
            self._fits.append(fit)
            self.std_rad = _std_rad([fit])
            self.insists = True

    def _is_gross(self, fit: _Fit) -> bool:
        """Whether a part of a segment alone shows that the heading is wrong by a large angle."""
        std_rad = _std_rad([fit])
        error_rad = wrap_pi(cmath.phase(fit.product) - self._turned_ned_rad[2])
        return std_rad < GROSS_STD_RAD and abs(error_rad) > GROSS_RAD + ERROR_SIGMAS * std_rad

    def _evaluate(self, fit: _Fit | None) -> None:
        """Add a segment's fit; None, after too few fixes or a pause of GNSS, starts the measurement again."""
        if fit is None:
            self._fits.clear()
            self.std_rad = inf
            self._contradictions = 0
            return
        self._fits.append(fit)
        self.std_rad = _std_rad(self._fits)
        limit_rad = ERROR_MIN_RAD + ERROR_SIGMAS * self.std_rad
        contradicted = self.std_rad < STD_MAX_RAD and abs(self.error_rad) > limit_rad
        self._contradictions = self._contradictions + 1 if contradicted else 0
        self.insists = self._contradictions >= CONTRADICTIONS


def _std_rad(fits: Collection[_Fit]) -> float:
    """Standard deviation of the angle that some fits measure together; infinite without motion."""
    energy = sum(fit.energy_m2ps2 for fit in fits)
    variance = sum(fit.residual_m2ps2 for fit in fits) / (INDEPENDENT * len(fits))
    return sqrt(variance / energy) if energy > 0.0 else inf


def _without_trend(times: tuple[float, ...], values: tuple[complex, ...]) -> list[complex]:
    """Values minus the straight line that fits them best."""
    count = len(times)
    time_mean, mean = sum(times) / count, sum(values) / count
    spread = sum((time - time_mean) ** 2 for time in times)
    slope = sum((time - time_mean) * value for time, value in zip(times, values, strict=True)) / spread
    return [value - mean - slope * (time - time_mean) for time, value in zip(times, values, strict=True)]
