"""What each sensor says of the state: the expected measurement, its Jacobian, its noise and its gate.

A measurement keeps what it needs of the vehicle's attitude at its own time, so that it can be fused again when an
older one comes in late.
"""

from math import cos, sin, sqrt
from typing import ClassVar, Literal, Protocol

import msgspec
import numpy as np

from jezero.frames import wrap_pi
from jezero.services.estimator.kalman import Kalman, Verdict
from jezero.services.estimator.motion import (
    ATTITUDE_ERROR,
    POS_ROVER,
    POS_UAV,
    SIZE,
    VEL_ERROR,
    VEL_ROVER,
    VEL_UAV,
    YAW,
    YAW_RATE,
    Array,
)

Kind = Literal["odometry", "rover", "altimeter", "uwb", "tag", "locate"]

STD_POS_UAV_M = 5.0
"""The autopilot's position wanders for minutes: it only keeps the world's origin where it is."""
STD_VEL_UAV_MPS = 0.01
STD_RESET_MPS = 0.5
STD_STILL_MPS = 0.002
"""Wheels that don't turn tell more than wheels that do."""
SHARE_SPEED, SHARE_LATERAL, SHARE_CLIMB = 0.03, 0.04, 0.1
"""Of the speed: wheel radius and slip forward, slip sideways, slope."""
STD_TILT_FAST_RAD = 0.003
"""The part of the vehicle's attitude error that differs from picture to picture."""
STD_CORNER_M = 0.003
"""What a detector's covariance doesn't know: lens, print and mounting."""
UWB_STD_MAX_M, UWB_STD_SHARE = 1.0, 0.3
"""Ranges are linearised only when the position is known so well: from afar it is the direction that counts."""
TAG_STD_MAX_M = 100.0
"""Above it nothing is known, and the first picture is taken as it is."""
INSIDE_SIGMAS = 3.0


class Measurement(Protocol):
    """One measurement of one sensor."""

    @property
    def t_ns(self) -> int: ...

    @property
    def kind(self) -> Kind: ...

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> Verdict:
        """Update the filter, which is at this measurement's time.

        Args:
            gate: greatest squared innovation, normalised, for one and for three degrees of freedom.
        """


def _odometry_jacobian() -> Array:
    H = np.zeros((6, SIZE))
    H[0:3, POS_UAV] = H[3:6, VEL_UAV] = H[3:6, VEL_ERROR] = np.eye(3)
    return H


ODOMETRY_H = _odometry_jacobian()
ODOMETRY_R = np.diag([STD_POS_UAV_M**2] * 3 + [STD_VEL_UAV_MPS**2] * 3)


def is_linear(kalman: Kalman) -> bool:
    """Whether the position is known well enough for ranges to be linearised around it."""
    std_m = kalman.std_pos_rel_m
    return std_m <= UWB_STD_MAX_M or std_m <= UWB_STD_SHARE * float(np.linalg.norm(kalman.pos_rel_m))


class OdometryFix(msgspec.Struct, frozen=True, gc=False):
    """The autopilot's position, without its resets, and velocity, (6,) together. Source: thesis eq. 4.14.

    Attributes:
        reset: the first one after the autopilot moved its estimate in a step, velocity included.
    """

    kind: ClassVar[Kind] = "odometry"
    t_ns: int
    pos_vel: Array
    reset: bool = False

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> Verdict:
        if self.reset:
            kalman.loosen(VEL_ERROR, STD_RESET_MPS)
        kalman.update(self.pos_vel - ODOMETRY_H @ kalman.x, ODOMETRY_H, ODOMETRY_R)
        return Verdict(6, 6)


class RoverMotion(msgspec.Struct, frozen=True, gc=False):
    """Speed along the heading, none across it and little upwards, yaw and yaw rate. Source: thesis eq. 4.15.

    What exceeds its gate weighs the less the more it does; it counts as not used, although it is never shut out.
    """

    kind: ClassVar[Kind] = "rover"
    t_ns: int
    speed_mps: float
    yaw_rad: float
    yaw_rate_rps: float
    std_speed_mps: float
    std_yaw_rad: float
    std_yaw_rate_rps: float

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> Verdict:
        x = kalman.x
        yaw = float(x[YAW])
        c, s = cos(yaw), sin(yaw)
        north, east, down = x[VEL_ROVER].tolist()
        forward, left_behind = c * north + s * east, c * east - s * north
        H = np.zeros((5, SIZE))
        H[0, 9:11], H[0, YAW] = (c, s), left_behind
        H[1, 9:11], H[1, YAW] = (-s, c), -forward
        H[2, 11] = H[3, YAW] = H[4, YAW_RATE] = 1.0
        innovation = np.array(
            (
                self.speed_mps - forward,
                -left_behind,
                -down,
                wrap_pi(self.yaw_rad - yaw),
                self.yaw_rate_rps - float(x[YAW_RATE]),
            )
        )
        R = np.diag(np.square(self._stds()))
        S = kalman.innovation_covariance(H, R)
        excess = np.square(innovation) / S.diagonal() / gate[0]
        fits = float(excess.max()) <= 1.0
        if not fits:
            R = R * np.maximum(excess, 1.0)
        kalman.update(innovation, H, R)
        return Verdict(int(fits), 1)

    def _stds(self) -> Array:
        speed = abs(self.speed_mps)
        if speed < 1e-3:
            still = STD_STILL_MPS
            return np.array((still, still, still, self.std_yaw_rad, self.std_yaw_rate_rps))
        along = self.std_speed_mps + SHARE_SPEED * speed
        across = self.std_speed_mps + SHARE_LATERAL * speed
        return np.array((along, across, SHARE_CLIMB * speed, self.std_yaw_rad, self.std_yaw_rate_rps))


class UwbRound(msgspec.Struct, frozen=True, gc=False):
    """Ranges to the anchors of the platform, fused as they are.

    Attributes:
        lever_ned_m: (3,) from the vehicle's position to its UWB tag.
        anchors_m: (m, 3) in rover_body.
        ranges_m: (m,).
        delays_s: (m,) of each range's time after `t_ns`.
    """

    kind: ClassVar[Kind] = "uwb"
    t_ns: int
    lever_ned_m: Array
    anchors_m: Array
    ranges_m: Array
    delays_s: Array
    std_m: float

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> Verdict:
        offered = len(self.ranges_m)
        if not is_linear(kalman):
            return Verdict(0, 0)
        expected_m, H = self._expect(kalman.x)
        innovation = self.ranges_m - expected_m
        variance = self.std_m * self.std_m
        S = ((H @ kalman.P) * H).sum(axis=1) + variance
        good = np.square(innovation) <= gate[0] * S
        used = int(np.count_nonzero(good))
        if not used:
            return Verdict(0, offered)
        kalman.update(innovation[good], H[good], variance * np.eye(used))
        return Verdict(used, offered)

    def _expect(self, x: Array) -> tuple[Array, Array]:
        """Expected ranges (m,) and their Jacobian (m, n)."""
        yaw = float(x[YAW])
        c, s = cos(yaw), sin(yaw)
        to_body = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
        delays = self.delays_s[:, None]
        tag_ned_m = x[POS_UAV] - x[POS_ROVER] + self.lever_ned_m + delays * (x[VEL_UAV] - x[VEL_ROVER])
        tag_m = tag_ned_m @ to_body.T
        away = tag_m - self.anchors_m
        lengths = np.maximum(np.sqrt((away * away).sum(axis=1)), 1e-3)
        unit = away / lengths[:, None]
        unit_ned = unit @ to_body
        H = np.zeros((len(lengths), SIZE))
        H[:, POS_UAV], H[:, POS_ROVER] = unit_ned, -unit_ned
        H[:, VEL_UAV], H[:, VEL_ROVER] = unit_ned * delays, -unit_ned * delays
        H[:, YAW] = unit[:, 0] * tag_m[:, 1] - unit[:, 1] * tag_m[:, 0]
        return lengths, H


class AltimeterRange(msgspec.Struct, frozen=True, gc=False):
    """Laser range to the platform, fused only when the beam surely meets it.

    Attributes:
        lever_ned_m: (3,) from the vehicle's position to the laser.
        beam_ned: (3,) unit vector.
    """

    kind: ClassVar[Kind] = "altimeter"
    t_ns: int
    range_m: float
    lever_ned_m: Array
    beam_ned: Array
    half_side_m: float
    std_m: float

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> Verdict:
        down = float(self.beam_ned[2])
        laser_m = kalman.pos_rel_m + self.lever_ned_m
        expected_m = -float(laser_m[2]) / max(down, 0.1)
        if down < 0.7 or expected_m <= 0.0 or not self._meets_platform(kalman, laser_m, expected_m):
            return Verdict(0, 0)
        H = np.zeros((1, SIZE))
        H[0, 2], H[0, 8] = -1.0 / down, 1.0 / down
        R = np.array([[self.std_m * self.std_m]])
        innovation = np.array([self.range_m - expected_m])
        S = float(kalman.innovation_covariance(H, R)[0, 0])
        if float(innovation[0]) ** 2 > gate[0] * S:
            return Verdict(0, 1)
        kalman.update(innovation, H, R)
        return Verdict(1, 1)

    def _meets_platform(self, kalman: Kalman, laser_m: Array, expected_m: float) -> bool:
        """Whether the beam's foot is further inside the edge than three standard deviations."""
        north, east, _ = (laser_m + expected_m * self.beam_ned).tolist()
        yaw = float(kalman.x[YAW])
        c, s = cos(yaw), sin(yaw)
        ahead, right = c * north + s * east, c * east - s * north
        var_tilt = max(float(kalman.P[17, 17]), float(kalman.P[18, 18]))
        variance = max(kalman.var_pos_rel_m2[:2]) + var_tilt * expected_m**2
        off_m: float = max(abs(ahead), abs(right))
        return off_m + INSIDE_SIGMAS * sqrt(max(variance, 0.0)) < self.half_side_m


class TagFix(msgspec.Struct, frozen=True, gc=False):
    """What a picture of the landing tags says; turned by an attitude that is wrong by the state's attitude error.

    Attributes:
        pos_rel_m: (3,) vehicle minus rover.
        arm_m: (3,) from the platform to the vehicle's centre of mass, which an attitude error turns.
        cov_m2: (3, 3) by the detector.
        heading_rad: of the vehicle.
    """

    kind: ClassVar[Kind] = "tag"
    t_ns: int
    pos_rel_m: Array
    arm_m: Array
    cov_m2: Array
    heading_rad: float
    yaw_rad: float | None
    std_yaw_rad: float

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> Verdict:
        if kalman.std_pos_rel_m > TAG_STD_MAX_M:
            return Verdict(0, 0)
        H = np.zeros((3, SIZE))
        H[:, POS_UAV], H[:, POS_ROVER] = np.eye(3), -np.eye(3)
        H[:, ATTITUDE_ERROR] = self._turning()
        R = self.noise_m2()
        innovation = self.pos_rel_m - H @ kalman.x
        S = kalman.innovation_covariance(H, R)
        if float(innovation @ np.linalg.solve(S, innovation)) > gate[1]:
            return Verdict(0, 3)
        kalman.update(innovation, H, R)
        if self.yaw_rad is not None:
            self._fuse_yaw(kalman, self.yaw_rad, gate)
        return Verdict(3, 3)

    def noise_m2(self) -> Array:
        """(3, 3) of the position: the detector's, and what the attitude's fast error adds across the line of sight."""
        arm = self.arm_m
        across = float(arm @ arm) * np.eye(3) - np.outer(arm, arm)
        noise_m2: Array = self.cov_m2 + STD_CORNER_M**2 * np.eye(3) + STD_TILT_FAST_RAD**2 * across
        return noise_m2

    def _turning(self) -> Array:
        """(3, 3): error of the position per attitude error in forward, right, down."""
        x, y, z = self.arm_m.tolist()
        c, s = cos(self.heading_rad), sin(self.heading_rad)
        cross = np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))
        turning: Array = cross @ np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        return turning

    def _fuse_yaw(self, kalman: Kalman, yaw_rad: float, gate: tuple[float, float]) -> None:
        H = np.zeros((1, SIZE))
        H[0, YAW] = H[0, 19] = 1.0
        R = np.array([[self.std_yaw_rad * self.std_yaw_rad]])
        x = kalman.x
        innovation = np.array([wrap_pi(yaw_rad - float(x[YAW]) - float(x[19]))])
        if float(innovation[0]) ** 2 <= gate[0] * float(kalman.innovation_covariance(H, R)[0, 0]):
            kalman.update(innovation, H, R)


class Location(msgspec.Struct, frozen=True, gc=False):
    """Where the vehicle is from the rover, in place of everything known before."""

    kind: ClassVar[Kind] = "locate"
    t_ns: int
    pos_rel_m: Array
    cov_m2: Array

    def fuse(self, kalman: Kalman, gate: tuple[float, float]) -> Verdict:
        kalman.locate(self.pos_rel_m, self.cov_m2)
        return Verdict(3, 3)
