"""Compares the three heights of a takeoff, by altimeter, barometer and autopilot, and names the one that is wrong."""

from collections.abc import Sequence
from math import hypot
from statistics import median

from jezero.base.frames import altitude_m, quat_rotate, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.sensors import Altimeter, Barometer
from jezero.schemas.state import Odometry, Status
from jezero.schemas.units import NS_PER_S

CLIMB_MIN_M = 1.5
"""Least height of a comparison. Lower, the altimeter is near its least range, and the rotors disturb the barometer."""
WATCHED_NS = 60 * NS_PER_S
"""Later the weather changes the pressure."""
HORIZONTAL_MAX_M = 3.0
"""Farther from the place of the takeoff the ground may be higher or lower."""
RANGE_SHARE = 0.8
"""Up to this part of its greatest range an altimeter surely measures."""
PLATFORM_MARGIN_M, BAROMETER_MARGIN_M, SLOPE = 0.3, 2.0, 0.1
"""Differences that are normal: beyond the platform's height for the altimeter, for the barometer, and for each metre of
height for both."""
LASTS_NS = NS_PER_S
BAROMETERS = 5
ADVICE = "check it and how it is mounted, then start the vehicle anew"


class HeightWatch:
    """Follows each takeoff.

    Args:
        vehicle: the vehicle itself.

    Attributes:
        problem: which height is wrong, for people, or "". It stays until the vehicle starts anew: on the ground nothing
            contradicts an altimeter that stands still.
        listens: the readings of altimeter and barometer are needed now.
    """

    def __init__(self, vehicle: VehicleConfig) -> None:
        self.problem = ""
        self.listens = False
        self._range_sure_m = RANGE_SHARE * vehicle.altimeter.range_max_m
        self._altimeter_margin_m = vehicle.platform.height_m + PLATFORM_MARGIN_M
        self._standing: Odometry | None = None
        """Last odometry before the takeoff; None for a vehicle that was not seen to take off."""
        self._standing_barometers_m: list[float] = []
        self._altimeter: Altimeter | None = None
        self._barometers_m: list[float] = []
        self._since_ns: int | None = None

    def update(self, status: Status, altimeters: Sequence[Altimeter], barometers: Sequence[Barometer]) -> None:
        """Update with the newest status, and with the readings since the one before, oldest first."""
        odometry = status.odometry
        self._altimeter = altimeters[-1] if altimeters else self._altimeter
        self._barometers_m = [*self._barometers_m, *(m.altitude_pressure_m for m in barometers)][-BAROMETERS:]
        if odometry is None or not status.armed:
            self.listens, self._standing, self._altimeter = False, None, None
            self._barometers_m.clear()
        elif status.landed:
            self.listens, self._standing, self._since_ns = True, odometry, None
            self._standing_barometers_m = self._barometers_m
        elif self._standing is not None and status.t_ns - self._standing.t_ns < WATCHED_NS:
            self._compare(status.t_ns, self._standing, odometry)
        else:
            self.listens, self._standing = False, None

    def _compare(self, t_ns: int, standing: Odometry, odometry: Odometry) -> None:
        """Compare the heights above the place of the takeoff."""
        steps_ned_m = subtract(odometry.reset_offset_ned_m, standing.reset_offset_ned_m)
        way_ned_m = subtract(subtract(odometry.pos_uav_ned_m, standing.pos_uav_ned_m), steps_ned_m)
        height_m = altitude_m(way_ned_m[2])
        if height_m < CLIMB_MIN_M:
            self._since_ns = None
            return
        found = self._wrong_height(height_m, hypot(*way_ned_m[:2]), odometry)
        if not found:
            self._since_ns = None
            return
        self._since_ns = t_ns if self._since_ns is None else self._since_ns
        if t_ns - self._since_ns >= LASTS_NS:
            self.problem = found

    def _wrong_height(self, height_m: float, way_m: float, odometry: Odometry) -> str:
        """Which height is wrong, or ""."""
        margin_m = SLOPE * height_m
        barometer_m = None
        if self._barometers_m and self._standing_barometers_m:
            barometer_m = median(self._barometers_m) - median(self._standing_barometers_m)
        barometer_off = barometer_m is not None and abs(barometer_m - height_m) > BAROMETER_MARGIN_M + margin_m
        says = f"since the takeoff the autopilot has climbed {height_m:.1f} m"
        says += "" if barometer_m is None else f", by the barometer {barometer_m:.1f} m"
        if way_m > HORIZONTAL_MAX_M or height_m > self._range_sure_m or self._altimeter is None:
            return f"{says}: one of the two is wrong, {ADVICE}" if barometer_off else ""
        if self._altimeter.range_m is None:
            return f"{says}, and the altimeter measures nothing: {ADVICE}"
        beam_down = quat_rotate(odometry.q_ned_from_frd, (0.0, 0.0, 1.0))[2]
        range_m = self._altimeter.range_m * beam_down
        says += f", by the altimeter {range_m:.1f} m"
        altimeter_off = abs(range_m - height_m) > self._altimeter_margin_m + margin_m
        if altimeter_off and barometer_off:
            return f"{says}: at least two of them are wrong, check all"
        if altimeter_off or barometer_off:
            return f"{says}: the {'altimeter' if altimeter_off else 'barometer'} is wrong, {ADVICE}"
        return ""
