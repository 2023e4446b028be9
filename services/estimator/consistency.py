"""Contradictions between the inputs, the altimeter and the vehicle's own motion, and what is left out for them."""

from math import atan2, cos, degrees, dist, hypot, sin, sqrt
from statistics import median

from jezero.frames import Vec3, rotate_yaw
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.kalman import Kalman
from jezero.services.estimator.measurements import (
    AltimeterMeasurement,
    Measurement,
    OdometryMeasurement,
    RoverOdometryMeasurement,
    TagMeasurement,
    UwbMeasurement,
)
from jezero.services.estimator.motion import VEL_ROVER, VEL_UAV, YAW, Array
from jezero.services.estimator.motion_check import MotionCheck
from jezero.services.estimator.trilateration import ANCHORS_MIN
from jezero.services.estimator.uwb_initialization import UwbWindow

STEP_MAX_S = 0.5
CONTRADICTED_NS = NS_PER_S
"""The altimeter contradicts the estimate when it does so for this time."""
HEIGHT_MARGIN_M, SLOPE, SIGMAS = 1.0, 0.3, 4.0
"""Ground beside the rover may be higher or lower than below it by this margin and this slope times the distance."""
ANCHOR_ERROR_M = 0.1
"""An anchor whose ranges differ by more from the others is wrong."""
Place = Vec3
"""Position of an anchor in rover_body."""
HEADING_ERROR_MIN_RAD = 0.25
HEADINGS_MIN = 6
"""The rover's compass counts as wrong when this number of headings by the tag in a row differ from it by more than
HEADING_ERROR_MIN_RAD."""


class DeadReckoning:
    """Horizontal motion of the vehicle relative to the rover by the odometry of both."""

    def __init__(self) -> None:
        self._pos_uav_m: tuple[float, float] | None = None
        self._rover_m = (0.0, 0.0)
        self._speed_mps = 0.0
        self._t_ns = 0

    def add(self, measurements: list[Measurement], yaw_rover_rad: float) -> None:
        """Add odometry; the rover drives along its heading."""
        for measurement in measurements:
            if isinstance(measurement, RoverOdometryMeasurement):
                self._speed_mps = measurement.speed_mps
            elif isinstance(measurement, OdometryMeasurement) and measurement.t_ns > self._t_ns:
                dt_s = min((measurement.t_ns - self._t_ns) / NS_PER_S, STEP_MAX_S)
                self._t_ns = measurement.t_ns
                north_m, east_m = self._rover_m
                step_m = self._speed_mps * dt_s
                self._rover_m = (north_m + step_m * cos(yaw_rover_rad), east_m + step_m * sin(yaw_rover_rad))
                self._pos_uav_m = (float(measurement.pos_vel[0]), float(measurement.pos_vel[1]))

    @property
    def pos_rel_m(self) -> tuple[float, float] | None:
        """(2,) north and east from an origin that stays; None before the first odometry."""
        if self._pos_uav_m is None:
            return None
        return (self._pos_uav_m[0] - self._rover_m[0], self._pos_uav_m[1] - self._rover_m[1])


class ConsistencyMonitor:
    """Finds what contradicts what.

    Attributes:
        height: contradiction of estimate and altimeter, or "".
        uwb_left_out: why the UWB ranges aren't used, or "".
        anchor_left_out: place of an anchor whose ranges aren't used; None for none.
        anchor_reason: why they aren't, or "".
        heading_turned: why the rover's heading was corrected, or "".
    """

    def __init__(self, platform_height_m: float) -> None:
        self.height = ""
        self.uwb_left_out = ""
        self.anchor_left_out: Place | None = None
        self.anchor_reason = ""
        self.heading_turned = ""
        self._platform_height_m = platform_height_m
        self._reckoning = DeadReckoning()
        self._motion = MotionCheck()
        self._height_since_ns: int | None = None
        self._headings_rad: list[float] = []

    def restart(self) -> None:
        """Start again with a filter that starts again; an input that was left out stays so."""
        self.height = ""
        self._height_since_ns = None
        self._headings_rad.clear()
        self._motion.clear()

    @property
    def left_out(self) -> str:
        """What is left out or corrected, and why; "" for nothing."""
        return "; ".join(text for text in (self.uwb_left_out, self.anchor_reason, self.heading_turned) if text)

    def readmit(self) -> None:
        """Use all inputs again."""
        self.uwb_left_out = self.anchor_reason = self.heading_turned = ""
        self.anchor_left_out = None
        self.restart()

    def leave_out_uwb(self, reason: str) -> None:
        """Use UWB no more."""
        self.uwb_left_out = (
            f"UWB is left out, {reason}: check the order and the positions of the anchors in vehicle.toml"
        )

    def check_motion(self, measurements: list[Measurement], kalman: Kalman, window: UwbWindow) -> float | None:
        """Compare the ranges with the vehicle's own motion; returns the error of the rover's heading that it shows."""
        yaw_rad = float(kalman.x[YAW])
        self._reckoning.add(measurements, yaw_rad)
        reckoned_m = self._reckoning.pos_rel_m
        if reckoned_m is None or self.uwb_left_out or not self._motion.is_due(kalman.t_ns):
            return None
        found = window.position(kalman.t_ns, kalman.x[VEL_UAV] - kalman.x[VEL_ROVER], yaw_rad)
        if found is None:
            return None
        pos_m, cov_m2 = found
        std_m = sqrt(max(float(cov_m2[0, 0]), float(cov_m2[1, 1])))
        self._motion.add(kalman.t_ns, reckoned_m, (float(pos_m[0]), float(pos_m[1])), std_m)
        if self._motion.contradiction:
            turn_rad, found_text = self._motion.turn_rad, self._motion.contradiction
            self._motion.clear()
            if turn_rad and not self.heading_turned:
                self.turn_heading(turn_rad)
                return turn_rad
            self.leave_out_uwb(f"its path is {found_text}")
        return None

    def turn_heading(self, error_rad: float) -> None:
        """Note that the rover's heading is corrected."""
        self.heading_turned = (
            f"the rover's heading was corrected by {degrees(-error_rad):.0f} degrees: check its compass, the turn of "
            "the camera, and the order of the anchors in vehicle.toml"
        )

    def judge_uwb(self, pairs: list[tuple[TagMeasurement, UwbMeasurement]], yaw_rad: float) -> None:
        """Leave out the anchor, or else all of UWB, that contradicts the tag.

        Positions by the tag hardly change the differences between the anchors' ranges, so one wrong anchor stands out.

        Args:
            pairs: measurements of the same time.
            yaw_rad: yaw of the rover.
        """
        errors_m: dict[Place, list[float]] = {}
        for tag, uwb in pairs:
            tag_m = rotate_yaw(_vec3(tag.pos_rel_m + uwb.lever_ned_m), -yaw_rad)
            anchors = zip(uwb.anchors_m.tolist(), uwb.anchors_level_m.tolist(), uwb.ranges_m.tolist(), strict=True)
            for anchor, anchor_level_m, range_m in anchors:
                place = (anchor[0], anchor[1], anchor[2])
                errors_m.setdefault(place, []).append(range_m - dist(tag_m, anchor_level_m))
        medians_m = {place: median(errors) for place, errors in errors_m.items()}
        if len(medians_m) <= ANCHORS_MIN:
            self.leave_out_uwb("as it contradicts the tag")
            return
        middle_m = median(medians_m.values())
        wrong = [place for place, error_m in medians_m.items() if abs(error_m - middle_m) > ANCHOR_ERROR_M]
        if len(wrong) != 1:
            self.leave_out_uwb("as it contradicts the tag")
            return
        self.anchor_left_out = wrong[0]
        north_m, east_m, down_m = wrong[0]
        self.anchor_reason = (
            f"the anchor at ({north_m:g}, {east_m:g}, {down_m:g}) is left out, its ranges are "
            f"{medians_m[wrong[0]] - middle_m:+.2f} m off the others: check its position and its antenna"
        )

    def check_height(self, altimeter: AltimeterMeasurement, kalman: Kalman) -> None:
        """Compare the estimated height with the altimeter, which measures to the platform or to the ground."""
        measured_m = altimeter.range_m * float(altimeter.beam_ned[2])
        north_m, east_m, down_m = (kalman.pos_rel_m + altimeter.lever_ned_m).tolist()
        margin_m = HEIGHT_MARGIN_M + SLOPE * hypot(north_m, east_m) + SIGMAS * sqrt(max(kalman.var_pos_rel_m2[2], 0.0))
        if -down_m - margin_m < measured_m < -down_m + self._platform_height_m + margin_m:
            self.height, self._height_since_ns = "", None
            return
        self._height_since_ns = altimeter.t_ns if self._height_since_ns is None else self._height_since_ns
        if altimeter.t_ns - self._height_since_ns >= CONTRADICTED_NS:
            self.height = (
                f"the estimate says {-down_m:.1f} m above the platform, the altimeter {measured_m:.1f} m above what is "
                "below: check the altimeter, the anchors and their positions in vehicle.toml"
            )

    def heading_error_rad(self, tag: TagMeasurement, kalman: Kalman) -> float | None:
        """Error of the rover's heading in the filter when the tags show one again and again; else None."""
        if tag.yaw_rad is None or tag.std_yaw_rad > HEADING_ERROR_MIN_RAD / 4.0:
            return None
        turn_rad = float(kalman.x[YAW]) - tag.yaw_rad
        error_rad = atan2(sin(turn_rad), cos(turn_rad))
        if abs(error_rad) < HEADING_ERROR_MIN_RAD:
            self._headings_rad.clear()
            return None
        self._headings_rad.append(error_rad)
        if len(self._headings_rad) < HEADINGS_MIN:
            return None
        self._headings_rad.clear()
        self._motion.clear()
        self.turn_heading(error_rad)
        return error_rad


def _vec3(v: Array) -> Vec3:
    x, y, z = v.tolist()
    return (x, y, z)
