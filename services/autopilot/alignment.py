"""Alignment of the filter: tilt, heading, gyroscope bias and origin of a vehicle at rest."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from math import atan2, cos, hypot, sin, sqrt

from jezero.base.frames import Quat, Vec3, quat_from_euler, wrap_pi
from jezero.base.vehicle_config import HeadingSource
from jezero.services.autopilot.config import StateEstimatorConfig

MIN_FIXES = 10
ALIGN_US = 1_000_000
"""Time for which the vehicle must stand still before the filter starts."""
MAG_CHECK_GAUSS = 0.06
"""A magnetic field is disturbed if its horizontal part differs from the expected one by more than this."""
FIX_AGE_MAX_US = 1_500_000
"""Older states of the vehicle are too inaccurate to be compared with a fix."""


@dataclass(frozen=True)
class Fix:
    """One GNSS fix.

    Attributes:
        t_us: time of the measurement on the clock of the other sensors, 0 if unknown. The fix arrives later.
        position_deg: (latitude_deg, longitude_deg, altitude_m).
        valid: whether the receiver has a 3D fix with enough satellites.
        satellites: number of satellites.
        yaw_rad: heading by two antennas; None of a receiver that doesn't measure it.
    """

    t_us: int
    position_deg: Vec3
    vel_ned_mps: Vec3
    valid: bool
    satellites: int = 0
    yaw_rad: float | None = None


def _mean(vectors: Iterable[Vec3], count: int) -> Vec3:
    north, east, down = zip(*vectors, strict=True)
    return (sum(north) / count, sum(east) / count, sum(down) / count)


class StartAlignment:
    """Averages the sensors of a vehicle at rest to find tilt, heading, gyroscope bias and origin.

    A movement or an invalid fix restarts it.
    """

    def __init__(self, config: StateEstimatorConfig, gravity_mps2: float, heading_by: HeadingSource) -> None:
        self._config = config
        self._gravity_mps2 = gravity_mps2
        self._heading_by = heading_by
        self._yaws_rad: deque[float] = deque(maxlen=MIN_FIXES)
        self._imu: deque[tuple[Vec3, Vec3]] = deque()
        self._fixes: deque[Vec3] = deque(maxlen=MIN_FIXES)
        self._mag: deque[Vec3] = deque(maxlen=MIN_FIXES)
        self._baro: deque[float] = deque(maxlen=MIN_FIXES)
        self._still_us = 0
        self._disturbed = False

    @property
    def incomplete_reason(self) -> str:
        """Why the alignment is incomplete, as a text for people; empty when it is complete."""
        if not self._imu:
            return "no IMU data, or the vehicle moves"
        if len(self._fixes) < MIN_FIXES:
            return "no GNSS fix yet"
        if reason := self._no_heading_reason:
            return reason
        if len(self._baro) < MIN_FIXES:
            return "no barometer data"
        if self._still_us < ALIGN_US:
            return "aligning, keep the vehicle still"
        return ""

    @property
    def _no_heading_reason(self) -> str:
        if self._heading_by == "gnss":
            return "" if len(self._yaws_rad) >= MIN_FIXES else "the GNSS receiver measures no heading yet"
        if len(self._mag) >= MIN_FIXES:
            return ""
        return "the magnetic field is disturbed" if self._disturbed else "no magnetometer data"

    def on_imu(self, dt_us: int, acc_frd_mps2: Vec3, gyro_frd_rps: Vec3) -> None:
        """Add an IMU sample; the vehicle must not move."""
        force = sqrt(sum(a * a for a in acc_frd_mps2))
        if abs(force - self._gravity_mps2) > 1.0 or max(abs(w) for w in gyro_frd_rps) > 0.15:
            self._imu.clear()
            self._still_us = 0
            return
        self._imu.append((acc_frd_mps2, gyro_frd_rps))
        self._still_us += dt_us
        if self._still_us > 2 * ALIGN_US:
            self._imu.popleft()

    def on_fix(self, fix: Fix) -> None:
        if fix.valid:
            self._fixes.append(fix.position_deg)
            if fix.yaw_rad is not None:
                self._yaws_rad.append(fix.yaw_rad)
        else:
            self._fixes.clear()
            self._yaws_rad.clear()

    def on_mag(self, field_frd_gauss: Vec3) -> None:
        """Add a magnetic field; its horizontal part is found with the direction of gravity."""
        down = self._imu[-1][0] if self._imu else (0.0, 0.0, -1.0)
        along = sum(f * d for f, d in zip(field_frd_gauss, down, strict=True)) / sqrt(sum(d * d for d in down))
        horizontal = sqrt(max(0.0, sum(f * f for f in field_frd_gauss) - along * along))
        self._disturbed = abs(horizontal - self._config.field_horizontal_gauss) > MAG_CHECK_GAUSS
        if self._disturbed:
            self._mag.clear()
        else:
            self._mag.append(field_frd_gauss)

    def on_baro(self, altitude_pressure_m: float) -> None:
        self._baro.append(altitude_pressure_m)

    def result(self) -> tuple[Quat, Vec3, Vec3, float]:
        """(q_ned_from_frd, gyro_bias_rps, origin_deg, pressure altitude of the origin in m)."""
        acc = _mean((a for a, _ in self._imu), len(self._imu))
        gyro = _mean((w for _, w in self._imu), len(self._imu))
        roll = atan2(-acc[1], -acc[2])
        pitch = atan2(acc[0], hypot(acc[1], acc[2]))
        origin = _mean(self._fixes, len(self._fixes))
        yaw = self._mean_yaw_rad() if self._heading_by == "gnss" else self._magnetic_yaw_rad(roll, pitch)
        return quat_from_euler(roll, pitch, yaw), gyro, origin, sum(self._baro) / len(self._baro)

    def _mean_yaw_rad(self) -> float:
        return atan2(sum(map(sin, self._yaws_rad)), sum(map(cos, self._yaws_rad)))

    def _magnetic_yaw_rad(self, roll: float, pitch: float) -> float:
        mx, my, mz = _mean(self._mag, len(self._mag))
        level_x = mx * cos(pitch) + sin(pitch) * (my * sin(roll) + mz * cos(roll))
        level_y = my * cos(roll) - mz * sin(roll)
        return wrap_pi(self._config.declination_rad - atan2(level_y, level_x))
