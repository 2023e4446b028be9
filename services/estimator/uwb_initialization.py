"""Initial relative position from UWB alone, robust against ranges without line of sight."""

from collections import deque
from math import dist, hypot
from statistics import median

import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import Vec3
from jezero.base.vehicle_config import PlatformConfig
from jezero.services.estimator.measurements import UwbMeasurement
from jezero.services.estimator.rover_tilt import ned_from_level
from jezero.services.estimator.trilateration import trilaterate

WINDOW_NS = 600_000_000
ROUNDS_MIN = 8
REFINEMENTS_MAX, REFINEMENT_CONVERGED_M = 2, 1e-4
"""Position and range rates depend on each other, so they are computed by fixed-point iteration."""
STD_FLOOR_M = 0.05
STD_FACTOR = 2.0
"""Factor on the standard deviation, as ranges also have constant errors."""
BELOW_PLATFORM_MARGIN_M, BESIDE_PLATFORM_MARGIN_M, STD_HEIGHT_AMBIGUOUS_M = 0.5, 0.2, 2.0
"""The height is ambiguous: ranges cannot distinguish above from below the plane of the anchors. A vehicle beside the
platform may be as far below the anchors as the platform is high, and with a margin farther where the ground is uneven.
At such heights the height's variance is increased."""


class UwbWindow:
    """Sliding window of UWB measurements.

    The median range of each anchor, after each range is extrapolated to the present by the relative velocity, is
    robust against single outliers.
    """

    def __init__(self, platform: PlatformConfig) -> None:
        self._ambiguous_height_m = platform.height_m + BELOW_PLATFORM_MARGIN_M
        self._beside_m = 0.5 * platform.side_m + BESIDE_PLATFORM_MARGIN_M
        self._rounds: deque[UwbMeasurement] = deque()

    def add(self, uwb: UwbMeasurement) -> None:
        """Add a measurement; duplicates are skipped."""
        if any(r.t_ns == uwb.t_ns for r in self._rounds):
            return
        self._rounds.append(uwb)
        newest_ns = max(r.t_ns for r in self._rounds)
        while self._rounds[0].t_ns < newest_ns - WINDOW_NS:
            self._rounds.popleft()

    def clear(self) -> None:
        self._rounds.clear()

    def position(self, t_ns: int, vel_rel_mps: Array, yaw_rad: float) -> tuple[Array, Array] | None:
        """Relative position (3,), vehicle minus rover in NED, at `t_ns`, and its covariance; None when not solvable.

        Args:
            vel_rel_mps: (3,) relative velocity over the window.
            yaw_rad: yaw of the rover.
        """
        rounds = [r for r in self._rounds if t_ns - WINDOW_NS <= r.t_ns <= t_ns]
        if len(rounds) < ROUNDS_MIN:
            return None
        to_ned = ned_from_level(yaw_rad) @ rounds[-1].R_level_from_rover_body
        vel_body_mps = vel_rel_mps @ to_ned
        found = trilaterate(*_medians(rounds, t_ns, vel_body_mps, None))
        for _ in range(REFINEMENTS_MAX):
            if found is None:
                return None
            before_m = found[0]
            found = trilaterate(*_medians(rounds, t_ns, vel_body_mps, before_m))
            if found is not None and dist(found[0], before_m) < REFINEMENT_CONVERGED_M:
                break
        if found is None:
            return None
        pos_body_m, unit_cov = found
        variance = (STD_FACTOR * rounds[-1].std_m) ** 2 / len(rounds)
        cov_m2 = to_ned @ (unit_cov * variance) @ to_ned.T + STD_FLOOR_M**2 * np.eye(3)
        beside = hypot(pos_body_m[0], pos_body_m[1]) > self._beside_m
        if beside and -pos_body_m[2] < self._ambiguous_height_m:
            cov_m2[2, 2] += STD_HEIGHT_AMBIGUOUS_M**2
        lever_ned_m = rounds[-1].lever_ned_m
        return to_ned @ np.array(pos_body_m) - lever_ned_m, cov_m2


def _medians(
    rounds: list[UwbMeasurement], t_ns: int, vel_body_mps: Array, pos_body_m: Vec3 | None
) -> tuple[list[Vec3], list[float]]:
    """Anchors and the median range of each, extrapolated to `t_ns` when an approximate position is given."""
    by_anchor: dict[Vec3, list[float]] = {}
    range_rate_mps: dict[Vec3, float] = {}
    for uwb in rounds:
        for anchor_m, range_m, delay_s in zip(
            uwb.anchors_m.tolist(), uwb.ranges_m.tolist(), uwb.delays_s.tolist(), strict=True
        ):
            anchor = (anchor_m[0], anchor_m[1], anchor_m[2])
            if anchor not in by_anchor:
                by_anchor[anchor] = []
                range_rate_mps[anchor] = (
                    0.0 if pos_body_m is None else _range_rate_mps(pos_body_m, anchor, vel_body_mps)
                )
            age_s = (t_ns - uwb.t_ns) * 1e-9 - delay_s
            by_anchor[anchor].append(range_m + range_rate_mps[anchor] * age_s)
    return list(by_anchor), [median(ranges) for ranges in by_anchor.values()]


def _range_rate_mps(pos_body_m: Vec3, anchor_m: Vec3, vel_body_mps: Array) -> float:
    away = np.array(pos_body_m) - np.array(anchor_m)
    return float(away @ vel_body_mps) / max(float(np.linalg.norm(away)), 1e-3)
