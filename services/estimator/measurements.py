"""Measurement models: expected measurement, Jacobian, covariance and innovation gate of each sensor.

A measurement stores the vehicle's attitude at its own time, so that it can be fused again when an older one arrives
late.
"""

from math import cos, sin, sqrt
from typing import ClassVar, Literal, Protocol, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.base.frames import wrap_pi
from jezero.services.estimator.innovations import Sensor
from jezero.services.estimator.kalman import Kalman, UpdateResult
from jezero.services.estimator.motion import (
    ATTITUDE_ERROR,
    COMPASS_BIAS,
    HEADING_ERROR,
    PITCH_ERROR,
    POS_ROVER,
    POS_UAV,
    ROLL_ERROR,
    SIZE,
    TAG_SCALE,
    UWB_BIAS,
    VEL_ERROR,
    VEL_ROVER,
    VEL_UAV,
    YAW,
    YAW_RATE,
)
from jezero.services.estimator.rover_tilt import LEVEL, ned_from_level

Kind = Literal["odometry", "rover", "altimeter", "uwb", "tag", "locate"]
"""Kinds of measurements, in the order in which those with equal time stamps are fused."""
INPUT_KINDS: tuple[Kind, ...] = tuple(kind for kind in get_args(Kind) if kind != "locate")
"""Kinds of sensor measurements; the remaining kind is the filter's own reset."""

STD_POS_UAV_M = 5.0
"""Large, because the autopilot's position drifts slowly: it only keeps the origin of the state observable."""
STD_VEL_UAV_MPS = 0.01
STD_RESET_MPS = 0.5
SPEED_STILL_MPS, STD_ZERO_VELOCITY_MPS = 1e-3, 0.002
"""Below this speed the rover's wheels stand still; standard deviation of its velocity then (zero-velocity update)."""
STD_FORWARD_PER_SPEED, STD_LATERAL_PER_SPEED, STD_VERTICAL_PER_SPEED = 0.03, 0.04, 0.1
"""Standard deviations in proportion to the speed, for wheel radius and slip, sideslip, and slope of the ground."""
STDS_SPEED_UNKNOWN_MPS = (10.0, 0.1, 0.3)
"""Along the heading, across it and down, for a rover whose speed is not measured."""
STDS_HEAVE_MPS = (0.1, 0.1, 10.0)
"""Speeds along the heading, across it and down that a heaving deck has besides; the last says that it isn't known."""
STD_TILT_FAST_RAD = 0.003
"""Part of the vehicle's attitude error that is independent from image to image."""
STD_CORNER_M = 0.003
"""Error of lens calibration, print and mounting, which the detector's covariance does not contain."""
LINEARIZATION_STD_MAX_M, LINEARIZATION_STD_FRACTION_MAX = 1.0, 0.3
"""Ranges are linearised only when the relative position's standard deviation is below the first, in metres, or below
the second as a fraction of the distance: far away the direction matters, not the position."""
TAG_UPDATE_STD_MAX_M = 100.0
"""Above this standard deviation the position is unknown, and the filter is reset to the tag instead of updated."""
PLATFORM_EDGE_SIGMAS = 3.0


NOTHING = np.zeros(3)


class Measurement(Protocol):
    """One measurement of one sensor."""

    @property
    def t_ns(self) -> int: ...

    @property
    def kind(self) -> Kind: ...

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        """Measurement update of the filter, which has been predicted to this measurement's time.

        Args:
            gate: greatest normalised squared innovation for one and for three degrees of freedom.
        """


def _odometry_jacobian() -> Array:
    H = np.zeros((6, SIZE))
    H[0:3, POS_UAV] = H[3:6, VEL_UAV] = H[3:6, VEL_ERROR] = np.eye(3)
    return H


ODOMETRY_H = _odometry_jacobian()
ODOMETRY_R = np.diag([STD_POS_UAV_M**2] * 3 + [STD_VEL_UAV_MPS**2] * 3)
ODOMETRY_PARTS: tuple[tuple[Sensor, slice], ...] = (
    ("autopilot_position", slice(0, 3)),
    ("autopilot_velocity", slice(3, 6)),
)


def can_linearize_ranges(kalman: Kalman) -> bool:
    """Whether the position is known well enough for ranges to be linearised around it."""
    std_m = kalman.std_pos_rel_m
    return std_m <= LINEARIZATION_STD_MAX_M or std_m <= LINEARIZATION_STD_FRACTION_MAX * float(
        np.linalg.norm(kalman.pos_rel_m)
    )


class OdometryMeasurement(msgspec.Struct, frozen=True, gc=False):
    """Position and velocity estimate of the autopilot. Source: thesis eq. 4.14.

    Attributes:
        pos_vel: (6,) position without the autopilot's resets, and velocity, both in NED.
        reset: true for the first message after the autopilot reset its estimate.
    """

    kind: ClassVar[Kind] = "odometry"
    t_ns: int
    pos_vel: Array
    reset: bool = False

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        if self.reset:
            kalman.inflate_covariance(VEL_ERROR, STD_RESET_MPS)
        innovation = self.pos_vel - ODOMETRY_H @ kalman.x
        for sensor, part in ODOMETRY_PARTS:
            kalman.announce(sensor, innovation[part], ODOMETRY_H[part], ODOMETRY_R[part, part], True)
        kalman.update(innovation, ODOMETRY_H, ODOMETRY_R)
        return UpdateResult(6, 6)


class RoverOdometryMeasurement(msgspec.Struct, frozen=True, gc=False):
    """Speed, yaw and yaw rate of the rover, which drives along its heading. Source: thesis eq. 4.15.

    Measurements beyond the gate are not discarded, but their covariance is increased; they count as rejected.

    Attributes:
        speed_known: false when the speed is not to be used: then yaw and yaw rate are measured, and that the rover does
            not slide.
        heaves: whether the platform heaves and tilts: then its vertical speed isn't near 0, and its middle moves
            sideways too.
    """

    kind: ClassVar[Kind] = "rover"
    t_ns: int
    speed_mps: float
    yaw_rad: float
    yaw_rate_rps: float
    std_speed_mps: float
    std_yaw_rad: float
    std_yaw_rate_rps: float
    speed_known: bool = True
    heaves: bool = False

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        x = kalman.x
        yaw = float(x[YAW])
        c, s = cos(yaw), sin(yaw)
        north, east, down = x[VEL_ROVER].tolist()
        forward, left_behind = c * north + s * east, c * east - s * north
        H = np.zeros((5, SIZE))
        H[0, VEL_ROVER], H[0, YAW] = (c, s, 0.0), left_behind
        H[1, VEL_ROVER], H[1, YAW] = (-s, c, 0.0), -forward
        H[2, VEL_ROVER] = (0.0, 0.0, 1.0)
        H[3, YAW] = H[3, COMPASS_BIAS] = H[4, YAW_RATE] = 1.0
        innovation = np.array(
            (
                self.speed_mps - forward,
                -left_behind,
                -down,
                wrap_pi(self.yaw_rad - yaw - float(x[COMPASS_BIAS])),
                self.yaw_rate_rps - float(x[YAW_RATE]),
            )
        )
        stds = self._stds()
        if self.heaves:
            stds[0:3] = np.hypot(stds[0:3], STDS_HEAVE_MPS)
        R = np.diag(np.square(stds))
        S = kalman.innovation_covariance(H, R)
        excess = np.square(innovation) / S.diagonal() / gate[0]
        fits = float(excess.max()) <= 1.0
        self._announce(kalman, innovation, H, R, excess <= 1.0)
        if not fits:
            R = R * np.maximum(excess, 1.0)
        kalman.update(innovation, H, R)
        return UpdateResult(int(fits), 1)

    def _announce(self, kalman: Kalman, innovation: Array, H: Array, R: Array, accepted: NDArray[np.bool_]) -> None:
        """Announce the measured components; those of sliding and climbing are assumptions, not measurements."""
        if kalman.observer is None:
            return
        measured: list[tuple[Sensor, int, float | None]] = [
            ("rover_yaw", 3, self.std_yaw_rad),
            ("rover_yaw_rate", 4, self.std_yaw_rate_rps),
        ]
        if self.speed_known and abs(self.speed_mps) >= SPEED_STILL_MPS:
            measured.append(("rover_speed", 0, None))  # its noise depends on the speed too
        for sensor, i, setting in measured:
            part = slice(i, i + 1)
            kalman.announce(sensor, innovation[part], H[part], R[part, part], accepted[part], setting)

    def _stds(self) -> Array:
        if not self.speed_known:
            return np.array((*STDS_SPEED_UNKNOWN_MPS, self.std_yaw_rad, self.std_yaw_rate_rps))
        speed = abs(self.speed_mps)
        if speed < SPEED_STILL_MPS:
            still = STD_ZERO_VELOCITY_MPS
            return np.array((still, still, still, self.std_yaw_rad, self.std_yaw_rate_rps))
        along = self.std_speed_mps + STD_FORWARD_PER_SPEED * speed
        across = self.std_speed_mps + STD_LATERAL_PER_SPEED * speed
        return np.array((along, across, STD_VERTICAL_PER_SPEED * speed, self.std_yaw_rad, self.std_yaw_rate_rps))


class UwbMeasurement(msgspec.Struct, frozen=True, gc=False):
    """Ranges to the anchors of the platform (tightly coupled).

    Attributes:
        lever_ned_m: (3,) lever arm from the vehicle's position to its UWB tag.
        anchors_m: (m, 3) positions of the anchors in rover_body.
        ranges_m: (m,) measured ranges.
        delays_s: (m,) time of each range relative to `t_ns`.
        std_m: standard deviation of a range.
        R_level_from_rover_body: (3, 3) rotation from rover_body to level axes with the rover's heading.
        std_time_s: standard deviation of the time.
    """

    kind: ClassVar[Kind] = "uwb"
    t_ns: int
    lever_ned_m: Array
    anchors_m: Array
    ranges_m: Array
    delays_s: Array
    std_m: float
    R_level_from_rover_body: Array = LEVEL
    std_time_s: float = 0.0

    @property
    def anchors_level_m(self) -> Array:
        """(m, 3) positions of the anchors relative to the platform, in level axes with the rover's heading."""
        return self.anchors_m @ self.R_level_from_rover_body.T

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        offered = len(self.ranges_m)
        if not can_linearize_ranges(kalman):
            return UpdateResult(0, 0)
        expected_m, H = self._predict_ranges(kalman.x)
        innovation = self.ranges_m - expected_m
        rates_mps = H[:, POS_UAV] @ (kalman.x[VEL_UAV] - kalman.x[VEL_ROVER])
        variances = self.std_m * self.std_m + np.square(self.std_time_s * rates_mps)
        S = ((H @ kalman.P) * H).sum(axis=1) + variances
        good = np.square(innovation) <= gate[0] * S
        used = int(np.count_nonzero(good))
        kalman.announce("uwb", innovation, H, np.diag(variances), good, self.std_m)
        if not used:
            return UpdateResult(0, offered)
        kalman.update(innovation[good], H[good], np.diag(variances[good]))
        return UpdateResult(used, offered)

    def without(self, anchor_m: tuple[float, float, float]) -> "UwbMeasurement":
        """The same without the ranges to one anchor."""
        kept = np.abs(self.anchors_m - np.array(anchor_m)).max(axis=1) > 1e-6
        return msgspec.structs.replace(
            self, anchors_m=self.anchors_m[kept], ranges_m=self.ranges_m[kept], delays_s=self.delays_s[kept]
        )

    def _predict_ranges(self, x: Array) -> tuple[Array, Array]:
        """Expected ranges (m,) and their Jacobian (m, n)."""
        to_level = ned_from_level(float(x[YAW])).T
        delays = self.delays_s[:, None]
        tag_ned_m = x[POS_UAV] - x[POS_ROVER] + self.lever_ned_m + delays * (x[VEL_UAV] - x[VEL_ROVER])
        tag_m = tag_ned_m @ to_level.T
        away = tag_m - self.anchors_level_m
        lengths = np.maximum(np.sqrt((away * away).sum(axis=1)), 1e-3)
        unit = away / lengths[:, None]
        unit_ned = unit @ to_level
        H = np.zeros((len(lengths), SIZE))
        H[:, POS_UAV], H[:, POS_ROVER] = unit_ned, -unit_ned
        H[:, VEL_UAV], H[:, VEL_ROVER] = unit_ned * delays, -unit_ned * delays
        H[:, YAW] = unit[:, 0] * tag_m[:, 1] - unit[:, 1] * tag_m[:, 0]
        H[:, UWB_BIAS] = 1.0
        return lengths + float(x[UWB_BIAS]), H


class AltimeterMeasurement(msgspec.Struct, frozen=True, gc=False):
    """Laser range to the platform, fused only when the beam certainly hits the platform.

    Attributes:
        lever_ned_m: (3,) lever arm from the vehicle's position to the laser.
        beam_ned: (3,) unit vector along the beam.
        half_side_m: half of the platform's side.
        normal_level: (3,) unit vector down through the platform, in level axes with the rover's heading.
    """

    kind: ClassVar[Kind] = "altimeter"
    t_ns: int
    range_m: float
    lever_ned_m: Array
    beam_ned: Array
    half_side_m: float
    std_m: float
    normal_level: Array = LEVEL[:, 2]

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        normal_ned = self._normal_ned(float(kalman.x[YAW]))
        down = float(self.beam_ned @ normal_ned)
        laser_m = kalman.pos_rel_m + self.lever_ned_m
        expected_m = -float(laser_m @ normal_ned) / max(down, 0.1)
        if down < 0.7 or expected_m <= 0.0 or not self._hits_platform(kalman, laser_m, expected_m):
            return UpdateResult(0, 0)
        H = np.zeros((1, SIZE))
        H[0, POS_UAV], H[0, POS_ROVER] = -normal_ned / down, normal_ned / down
        R = np.array([[self.std_m * self.std_m]])
        innovation = np.array([self.range_m - expected_m])
        S = float(kalman.innovation_covariance(H, R)[0, 0])
        fits = float(innovation[0]) ** 2 <= gate[0] * S
        kalman.announce("altimeter", innovation, H, R, fits, self.std_m)
        if not fits:
            return UpdateResult(0, 1)
        kalman.update(innovation, H, R)
        return UpdateResult(1, 1)

    def _normal_ned(self, yaw_rad: float) -> Array:
        c, s = cos(yaw_rad), sin(yaw_rad)
        ahead, right, down = self.normal_level.tolist()
        return np.array((c * ahead - s * right, s * ahead + c * right, down))

    def _hits_platform(self, kalman: Kalman, laser_m: Array, expected_m: float) -> bool:
        """Whether the beam ends inside the platform's edge by at least three standard deviations."""
        north, east, _ = (laser_m + expected_m * self.beam_ned).tolist()
        yaw = float(kalman.x[YAW])
        c, s = cos(yaw), sin(yaw)
        ahead, right = c * north + s * east, c * east - s * north
        var_tilt = max(float(kalman.P[ROLL_ERROR, ROLL_ERROR]), float(kalman.P[PITCH_ERROR, PITCH_ERROR]))
        variance = max(kalman.var_pos_rel_m2[:2]) + var_tilt * expected_m**2
        off_m: float = max(abs(ahead), abs(right))
        return off_m + PLATFORM_EDGE_SIGMAS * sqrt(max(variance, 0.0)) < self.half_side_m


class TagMeasurement(msgspec.Struct, frozen=True, gc=False):
    """Relative position from the landing tags in one image, rotated to NED by the autopilot's attitude.

    The rotation makes the measurement depend on the attitude error in the state.

    Attributes:
        pos_rel_m: (3,) vehicle minus rover, in NED.
        lever_arm_m: (3,) from the platform to the vehicle's centre of mass in NED, which an attitude error rotates.
        cov_m2: (3, 3) covariance reported by the detector.
        heading_rad: heading of the vehicle.
        yaw_rad: yaw of the rover; None when the detector does not measure it.
        std_yaw_rad: standard deviation of `yaw_rad`.
        scale_std: factor on all standard deviations of the measurement.
        std_time_s: standard deviation of the time.
        swing_mps: (3,) speed in NED at which the vehicle's rotation moves the lever arm's end.
    """

    kind: ClassVar[Kind] = "tag"
    t_ns: int
    pos_rel_m: Array
    lever_arm_m: Array
    cov_m2: Array
    heading_rad: float
    yaw_rad: float | None
    std_yaw_rad: float
    scale_std: float = 1.0
    std_time_s: float = 0.0
    swing_mps: Array = NOTHING

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> UpdateResult:
        if kalman.std_pos_rel_m > TAG_UPDATE_STD_MAX_M:
            return UpdateResult(0, 0)
        x = kalman.x
        scale = 1.0 + float(x[TAG_SCALE])
        arm_m = kalman.pos_rel_m - self.pos_rel_m + self.lever_arm_m
        H = np.zeros((3, SIZE))
        H[:, POS_UAV], H[:, POS_ROVER] = scale * np.eye(3), -scale * np.eye(3)
        H[:, ATTITUDE_ERROR] = self._attitude_error_jacobian()
        H[:, TAG_SCALE] = arm_m
        R = self.measurement_cov_m2()
        for speed_mps in (x[VEL_UAV] - x[VEL_ROVER], self.swing_mps):
            R = R + self.std_time_s**2 * np.outer(speed_mps, speed_mps)
        innovation = self.lever_arm_m - scale * arm_m - H[:, ATTITUDE_ERROR] @ x[ATTITUDE_ERROR]
        S = kalman.innovation_covariance(H, R)
        fits = float(innovation @ np.linalg.solve(S, innovation)) <= gate[1]
        kalman.announce("tag", innovation, H, R, fits, self.scale_std)
        if not fits:
            return UpdateResult(0, 3)
        kalman.update(innovation, H, R)
        if self.yaw_rad is not None:
            self._fuse_yaw(kalman, self.yaw_rad, gate)
        return UpdateResult(3, 3)

    def error_jacobian(self) -> Array:
        """(3, n) derivative of the measured position's error with respect to the state."""
        jacobian = np.zeros((3, SIZE))
        jacobian[:, ATTITUDE_ERROR] = self._attitude_error_jacobian()
        jacobian[:, TAG_SCALE] = self.lever_arm_m
        return jacobian

    def measurement_cov_m2(self) -> Array:
        """(3, 3) covariance of the position: the detector's, plus the fast attitude error across the line of sight."""
        arm = self.lever_arm_m
        across = float(arm @ arm) * np.eye(3) - np.outer(arm, arm)
        cov_m2: Array = self.cov_m2 + STD_CORNER_M**2 * np.eye(3) + STD_TILT_FAST_RAD**2 * across
        return self.scale_std**2 * cov_m2

    def _attitude_error_jacobian(self) -> Array:
        """(3, 3) derivative of the position with respect to the attitude error in forward, right, down."""
        x, y, z = self.lever_arm_m.tolist()
        cross = np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))
        jacobian: Array = cross @ ned_from_level(self.heading_rad)
        return jacobian

    def _fuse_yaw(self, kalman: Kalman, yaw_rad: float, gate: tuple[float, float]) -> None:
        H = np.zeros((1, SIZE))
        H[0, YAW] = H[0, HEADING_ERROR] = 1.0
        R = np.array([[(self.scale_std * self.std_yaw_rad) ** 2]])
        x = kalman.x
        innovation = np.array([wrap_pi(yaw_rad - float(x[YAW]) - float(x[HEADING_ERROR]))])
        fits = float(innovation[0]) ** 2 <= gate[0] * float(kalman.innovation_covariance(H, R)[0, 0])
        kalman.announce("tag_yaw", innovation, H, R, fits, self.scale_std)
        if fits:
            kalman.update(innovation, H, R)
