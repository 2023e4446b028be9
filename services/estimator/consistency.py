"""Contradictions between the inputs, the altimeter and the vehicle's own motion, and what is left out for them."""

from collections.abc import Sequence
from math import atan2, cos, degrees, dist, hypot, inf, sin, sqrt
from statistics import median

from jezero.base.arrays import Array
from jezero.base.frames import Vec3, rotate_yaw
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
from jezero.services.estimator.motion import VEL_ROVER, VEL_UAV, YAW
from jezero.services.estimator.motion_check import MotionCheck, PathSample
from jezero.services.estimator.trilateration import ANCHORS_MIN
from jezero.services.estimator.uwb_initialization import UwbWindow

STEP_MAX_S = 0.5
CONTRADICTED_NS = NS_PER_S
"""The altimeter contradicts the estimate when it does so for this time."""
HEIGHT_MARGIN_M, SLOPE, SIGMAS = 1.0, 0.3, 4.0
"""Ground beside the rover may be higher or lower than below it by this margin and this slope times the distance."""
ANCHOR_ERROR_M = 0.1
"""An anchor whose ranges differ by more from the others is wrong."""
UWB_BIAS_MAX_M = 0.4
"""Ranges that are all longer or shorter than the tag's distances by less than this agree with it: the filter estimates
a bias that all anchors share."""
STD_TAG_M, STD_TAG_TILT_RAD = 0.05, 0.03
"""Standard deviation of a position by the tags: a constant part, and the attitude's error times the height."""
Place = Vec3
"""Position of an anchor in rover_body."""
HEADING_ERROR_MIN_RAD = 0.25
HEADINGS_MIN = 6
"""The rover's compass counts as wrong when this number of headings by the tag in a row differ from it by more than
HEADING_ERROR_MIN_RAD."""


class DeadReckoning:
    """Horizontal motion of the vehicle relative to the rover by the odometry of both."""

    def __init__(self) -> None:
        self._pos_vel_uav: tuple[float, float, float, float] | None = None
        self._rover_m = (0.0, 0.0)
        self._heading_way_m = (0.0, 0.0)
        self._speed_mps = 0.0
        self._heading = (1.0, 0.0)
        self._t_ns = 0

    def add(self, measurements: Sequence[Measurement], yaw_rover_rad: float) -> None:
        """Add odometry; the rover drives along its heading."""
        self._heading = cos(yaw_rover_rad), sin(yaw_rover_rad)
        for measurement in measurements:
            if isinstance(measurement, RoverOdometryMeasurement):
                self._speed_mps = measurement.speed_mps
            elif isinstance(measurement, OdometryMeasurement) and measurement.t_ns > self._t_ns:
                dt_s = min((measurement.t_ns - self._t_ns) / NS_PER_S, STEP_MAX_S)
                self._t_ns = measurement.t_ns
                self._rover_m = self._moved(self._rover_m, self._speed_mps * dt_s)
                self._heading_way_m = self._moved(self._heading_way_m, dt_s)
                north_m, east_m, _, north_mps, east_mps, _ = measurement.pos_vel.tolist()
                self._pos_vel_uav = north_m, east_m, north_mps, east_mps

    def _moved(self, place_m: tuple[float, float], way_m: float) -> tuple[float, float]:
        return place_m[0] + way_m * self._heading[0], place_m[1] + way_m * self._heading[1]

    def sample(self, t_ns: int, measured_m: tuple[float, float], std_m: float) -> PathSample | None:
        """The measured place beside the dead-reckoned ones of its time; None before the first odometry.

        Args:
            t_ns: at most some tenths of a second from the newest odometry.
            measured_m: (2,) north and east of the rover.
            std_m: standard deviation of the measured place on an axis.
        """
        if self._pos_vel_uav is None:
            return None
        later_s = (t_ns - self._t_ns) / NS_PER_S
        north_m, east_m, north_mps, east_mps = self._pos_vel_uav
        rover_m = self._moved(self._rover_m, self._speed_mps * later_s)
        reckoned_m = (north_m + later_s * north_mps - rover_m[0], east_m + later_s * east_mps - rover_m[1])
        return PathSample(t_ns, reckoned_m, self._moved(self._heading_way_m, later_s), measured_m, std_m)


class ConsistencyMonitor:
    """Finds what contradicts what.

    Attributes:
        height: contradiction of estimate and altimeter, or "".
        uwb_left_out: why the UWB ranges aren't used, or "".
        tag_left_out: why the tags aren't used, or "".
        speed_left_out: why the rover's speed isn't used, or "".
        anchor_left_out: place of an anchor whose ranges aren't used; None for none.
        anchor_reason: why they aren't, or "".
        heading_turned: why the rover's heading was corrected, or "".
    """

    def __init__(self, platform_height_m: float) -> None:
        self.height = ""
        self.uwb_left_out = self.tag_left_out = self.speed_left_out = ""
        self.anchor_left_out: Place | None = None
        self.anchor_reason = ""
        self.heading_turned = ""
        self._platform_height_m = platform_height_m
        self._reckoning = DeadReckoning()
        self._uwb_motion, self._tag_motion = MotionCheck(), MotionCheck()
        self._height_since_ns: int | None = None
        self._headings_rad: list[float] = []

    def restart(self) -> None:
        """Start again with a filter that starts again; an input that was left out stays so."""
        self.height = ""
        self._height_since_ns = None
        self._headings_rad.clear()
        self._uwb_motion.clear()

    @property
    def left_out(self) -> str:
        """What is left out or corrected, and why; "" for nothing."""
        reasons = (self.uwb_left_out, self.tag_left_out, self.speed_left_out, self.anchor_reason, self.heading_turned)
        return "; ".join(reason for reason in reasons if reason)

    def readmit(self) -> None:
        """Use all inputs again."""
        self._readmit_uwb()
        self.tag_left_out = self.speed_left_out = self.heading_turned = ""
        self._tag_motion.clear()
        self.restart()

    def _leave_out_uwb(self, reason: str) -> None:
        self.uwb_left_out = (
            f"UWB is left out, {reason}: check the order and the positions of the anchors in vehicle.toml"
        )

    def _leave_out_tag(self, reason: str) -> None:
        """Leave out the tags, and use again what was left out or corrected because it contradicts them."""
        self._readmit_uwb()
        self.heading_turned = ""
        self.tag_left_out = (
            f"the tags are left out, {reason}: check the turn of the camera and the size of the tags in vehicle.toml, "
            "and the vehicle's compass"
        )
        self._tag_motion.clear()

    def _leave_out_speed(self, reason: str) -> None:
        """Leave out the rover's speed, and use again what was left out because it contradicts it."""
        self._readmit_uwb()
        self.speed_left_out = (
            f"the rover's speed is left out, {reason}: check its odometry, and whether its wheels slip"
        )
        self._tag_motion.clear()

    def _readmit_uwb(self) -> None:
        self.uwb_left_out = self.anchor_reason = ""
        self.anchor_left_out = None

    def follow_motion(self, measurements: Sequence[Measurement], kalman: Kalman) -> None:
        """Follow the motion of vehicle and rover, also while the rover's position is unknown."""
        self._reckoning.add(measurements, float(kalman.x[YAW]))

    def check_motion(self, measurements: Sequence[Measurement], kalman: Kalman, window: UwbWindow) -> float | None:
        """Compare UWB and tags with the motion of vehicle and rover.

        Returns:
            The error of the rover's heading that the path by UWB shows, to be corrected; None for none.
        """
        if self.speed_left_out:
            return None
        self._check_tag_motion(measurements)
        return self._check_uwb_motion(kalman, window)

    def _check_tag_motion(self, measurements: Sequence[Measurement]) -> None:
        motion = self._tag_motion
        for measurement in measurements:
            if not isinstance(measurement, TagMeasurement) or not motion.is_due(measurement.t_ns):
                continue
            north_m, east_m, down_m = measurement.pos_rel_m.tolist()
            std_m = STD_TAG_M + STD_TAG_TILT_RAD * abs(down_m)
            sample = self._reckoning.sample(measurement.t_ns, (north_m, east_m), std_m)
            if sample is not None:
                motion.add(sample)
        found = motion.contradiction
        if found.speed_error_mps:
            self._leave_out_speed(f"as the path of the tags is {found.text}")
        elif found.text:
            self._leave_out_tag(f"as their path is {found.text}")

    def _check_uwb_motion(self, kalman: Kalman, window: UwbWindow) -> float | None:
        motion = self._uwb_motion
        if self.uwb_left_out or self.speed_left_out or not motion.is_due(kalman.t_ns):
            return None
        yaw_rad = float(kalman.x[YAW])
        found = window.position(kalman.t_ns, kalman.x[VEL_UAV] - kalman.x[VEL_ROVER], yaw_rad)
        if found is None:
            return None
        pos_m, cov_m2 = found
        std_m = sqrt(max(float(cov_m2[0, 0]), float(cov_m2[1, 1])))
        sample = self._reckoning.sample(kalman.t_ns, (float(pos_m[0]), float(pos_m[1])), std_m)
        if sample is None:
            return None
        motion.add(sample)
        contradiction = motion.contradiction
        if not contradiction.text:
            return None
        motion.clear()
        if contradiction.speed_error_mps:
            self._leave_out_speed(f"as the path by UWB is {contradiction.text}")
        elif contradiction.turn_rad and not self.heading_turned:
            self._turn_heading(contradiction.turn_rad)
            return contradiction.turn_rad
        elif self._tag_motion.difference.turn_rad:
            self._leave_out_tag(f"as their path is {self._tag_motion.difference.text}")
        else:
            self._leave_out_uwb(f"its path is {contradiction.text}")
        return None

    def _turn_heading(self, error_rad: float) -> None:
        """Note that the rover's heading is corrected."""
        self.heading_turned = (
            f"the rover's heading was corrected by {degrees(-error_rad):.0f} degrees: check its compass, the turn of "
            "the camera, and the order of the anchors in vehicle.toml"
        )
        self._uwb_motion.clear()

    def judge_uwb(self, pairs: list[tuple[TagMeasurement, UwbMeasurement]], yaw_rad: float) -> None:
        """Leave out what contradicts the others when UWB or the tag contradicts the estimate.

        When UWB and the tag agree with each other on the rover, the motion contradicts both. Else an anchor or all of
        UWB is wrong: positions by the tag hardly change the differences between the anchors' ranges, so one wrong
        anchor stands out.

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
        middle_m = median(medians_m.values()) if medians_m else 0.0
        spread_m = max((abs(error_m - middle_m) for error_m in medians_m.values()), default=inf)
        if len(medians_m) >= ANCHORS_MIN and spread_m < ANCHOR_ERROR_M and abs(middle_m) < UWB_BIAS_MAX_M:
            self._judge_motion()
            return
        if len(medians_m) <= ANCHORS_MIN:
            self._leave_out_uwb("as it contradicts the tag")
            return
        wrong = [place for place, error_m in medians_m.items() if abs(error_m - middle_m) > ANCHOR_ERROR_M]
        if len(wrong) != 1:
            self._leave_out_uwb("as it contradicts the tag")
            return
        self.anchor_left_out = wrong[0]
        north_m, east_m, down_m = wrong[0]
        self.anchor_reason = (
            f"the anchor at ({north_m:g}, {east_m:g}, {down_m:g}) is left out, its ranges are "
            f"{medians_m[wrong[0]] - middle_m:+.2f} m off the others: check its position and its antenna"
        )

    def _judge_motion(self) -> None:
        """Leave out what contradicts the motion of vehicle and rover, where UWB and the tag agree with each other."""
        both = self._tag_motion.difference, self._uwb_motion.difference
        other_speed = next((difference for difference in both if difference.speed_error_mps), None)
        turned = next((difference for difference in both if difference.turn_rad), None)
        if other_speed is not None:
            self._leave_out_speed(f"as the path by UWB and the tags is {other_speed.text}")
        elif turned is not None:
            self._leave_out_tag(f"as their path is {turned.text}")
        elif self.heading_turned:
            self._leave_out_tag("as the rover's heading by them contradicts its compass and the motion")
        else:
            self._leave_out_uwb("as the estimate agrees with one of UWB and the tag only")

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
        self._turn_heading(error_rad)
        return error_rad


def _vec3(v: Array) -> Vec3:
    x, y, z = v.tolist()
    return (x, y, z)
