"""Gain-scheduled horizontal control over the platform, and the vehicle's state relative to it.

Source: spec §8; thesis §4.4.2.
"""

from math import hypot, sqrt
from typing import NamedTuple

from jezero.frames import Vec3, add, altitude_m, scale
from jezero.schemas.estimate import Relative
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import PlatformControlConfig
from jezero.services.actions.motion.rover_frame import turn_acceleration

AGE_MAX_NS = 500_000_000
FAR_M, NEAR_M = 3.5, 0.5
"""Between these errors the gain is interpolated; the integral is reset beyond FAR_M and grows only within NEAR_M."""
INTEGRAL_MAX_MPS = 0.3
"""Limit of the integral's part."""
ACC_MAX_MPS2 = 1.5
"""Deceleration before the platform."""
NORTH, EAST, DOWN = 0, 6, 11
"""Indices of the position's variances in the upper triangle of the covariance."""


class PlatformState(NamedTuple):
    """State of the vehicle relative to the platform at one time.

    Attributes:
        pos_ned_m: middle of the vehicle's feet relative to that of the platform.
        vel_ned_mps: velocity relative to the platform.
        vel_rover_ned_mps: velocity of the platform over ground.
        yaw_rate_rover_rps: of the platform.
        std_m: standard deviation of the horizontal position.
        std_height_m: standard deviation of the height.
    """

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    vel_rover_ned_mps: Vec3
    yaw_rate_rover_rps: float
    std_m: float = 0.0
    std_height_m: float = 0.0

    @property
    def height_m(self) -> float:
        return altitude_m(self.pos_ned_m[2])

    @property
    def error_m(self) -> float:
        """Horizontal distance from the middle."""
        return hypot(self.pos_ned_m[0], self.pos_ned_m[1])

    def error_in_m(self, seconds: float) -> float:
        """`error_m` after some seconds at the present velocity."""
        north_m, east_m, _ = self.pos_ned_m
        north_mps, east_mps, _ = self.vel_ned_mps
        return hypot(north_m + seconds * north_mps, east_m + seconds * east_mps)

    @property
    def speed_mps(self) -> float:
        """Horizontal speed relative to the platform."""
        return hypot(self.vel_ned_mps[0], self.vel_ned_mps[1])

    @property
    def acc_rover_ned_mps2(self) -> tuple[float, float]:
        """Acceleration of the platform in its turn, north and east."""
        return turn_acceleration(self.vel_rover_ned_mps, self.yaw_rate_rover_rps)


def platform_state_at(t_ns: int, relative: Relative, feet_ned_m: Vec3) -> PlatformState:
    """State by the estimate, extrapolated from its own time to `t_ns`, by half a second at most.

    Args:
        feet_ned_m: (3,) from the vehicle's reference point to the middle of its feet.
    """
    age_s = min(max(t_ns - relative.t_ns, 0), AGE_MAX_NS) / NS_PER_S
    vel_ned_mps = relative.vel_uav_rel_rover_ned_mps
    return PlatformState(
        add(add(relative.pos_uav_rel_rover_ned_m, scale(vel_ned_mps, age_s)), feet_ned_m),
        vel_ned_mps,
        relative.vel_rover_ned_mps,
        relative.yaw_rate_rover_rps,
        sqrt(max(relative.cov[NORTH], 0.0) + max(relative.cov[EAST], 0.0)),
        sqrt(max(relative.cov[DOWN], 0.0)),
    )


class PlatformControl:
    """Horizontal velocity over ground that brings the vehicle over the middle of the platform and keeps it there."""

    def __init__(self, config: PlatformControlConfig) -> None:
        self._config = config
        self._integral_mps = (0.0, 0.0)

    def reset(self) -> None:
        """Set the integral to 0; it holds the effects of the wind and of the velocity's error."""
        self._integral_mps = (0.0, 0.0)

    def command(self, dt_s: float, platform: PlatformState) -> tuple[tuple[float, float], tuple[float, float]]:
        """Velocity and its derivative, north and east; without the derivative a fast loop would overshoot."""
        error_m = platform.error_m
        self._integrate(dt_s, platform, error_m)
        pull_1ps = self._speed_mps(error_m) / error_m if error_m > 1e-9 else self._config.gain_near_1ps
        (north_m, east_m, _), (north_mps, east_mps, _) = platform.pos_ned_m, platform.vel_ned_mps
        acc_north_mps2, acc_east_mps2 = platform.acc_rover_ned_mps2
        velocity = (
            platform.vel_rover_ned_mps[0] - pull_1ps * north_m + self._integral_mps[0],
            platform.vel_rover_ned_mps[1] - pull_1ps * east_m + self._integral_mps[1],
        )
        return velocity, (acc_north_mps2 - pull_1ps * north_mps, acc_east_mps2 - pull_1ps * east_mps)

    def _speed_mps(self, error_m: float) -> float:
        """Speed towards the middle: proportional to the error, and not faster than the vehicle can brake."""
        config = self._config
        weight = min(max((error_m - NEAR_M) / (FAR_M - NEAR_M), 0.0), 1.0)
        gain_1ps = config.gain_near_1ps + weight * (config.gain_far_1ps - config.gain_near_1ps)
        braking_mps = sqrt(2.0 * ACC_MAX_MPS2 * error_m)
        return min(gain_1ps * error_m, braking_mps, config.speed_max_mps)

    def _integrate(self, dt_s: float, platform: PlatformState, error_m: float) -> None:
        config = self._config
        if error_m > FAR_M:
            self.reset()
        if error_m > NEAR_M:
            return
        north_mps, east_mps = self._integral_mps
        north_mps -= config.gain_integral_1ps2 * platform.pos_ned_m[0] * dt_s
        east_mps -= config.gain_integral_1ps2 * platform.pos_ned_m[1] * dt_s
        shrink = min(1.0, INTEGRAL_MAX_MPS / max(hypot(north_mps, east_mps), 1e-9))
        self._integral_mps = (shrink * north_mps, shrink * east_mps)
