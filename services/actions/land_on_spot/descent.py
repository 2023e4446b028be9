"""When and how fast the vehicle may go down onto the platform, and how it knows that it has touched it."""

from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import RoverLandingConfig
from jezero.services.actions.land_on_spot.platform_control import Pad

BEGIN_WITHIN_M = 0.5
"""The descent begins when the vehicle is at most this much above the height of the approach."""
STALLED = 0.5
"""Descending at less than this share of what is asked for is being held up."""
STALLED_BELOW_M = 0.3
STEP_MAX_S = 0.1
LOW_SIGMAS = 2.0
"""By so many standard deviations the height must be below what a forced disarm allows."""


class Descent:
    """The way down in a cone that narrows towards the middle of the platform."""

    def __init__(self, config: RoverLandingConfig) -> None:
        self._config = config
        self._waited_s = 0.0
        self._t_ns: int | None = None
        self._moving_ns: int | None = None

    def may_begin(self, pad: Pad) -> bool:
        """Whether the vehicle is over the platform, at the height of the approach, and slow."""
        config = self._config
        low = pad.height_m < config.height_approach_m + BEGIN_WITHIN_M
        return low and pad.speed_mps < config.speed_gate_mps and pad.error_m < self._cone_m(pad)

    def down_mps(self, t_ns: int, pad: Pad) -> float:
        """Speed downwards relative to the platform: none outside the cone, upwards far outside."""
        config = self._config
        passed_s = 0.0 if self._t_ns is None else min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        wanted_mps = min(max(config.gain_descent_1ps * pad.height_m, config.descent_min_mps), config.descent_max_mps)
        if pad.height_m < config.commit_m:
            return wanted_mps
        cone_m = self._cone_m(pad)
        known = pad.std_m < config.std_m + config.std_per_m * pad.height_m
        if known and pad.error_in_m(config.prediction_s) < cone_m and pad.speed_mps < config.speed_gate_mps:
            self._waited_s = max(0.0, self._waited_s - passed_s)
            return wanted_mps
        self._waited_s += passed_s
        strayed = pad.error_m > config.strayed_cones * cone_m and pad.height_m < config.height_approach_m
        return -config.descent_min_mps if strayed else 0.0

    def touches(self, t_ns: int, pad: Pad, down_mps: float) -> bool:
        """Whether the vehicle is as low as it can be, or is held up although it shall descend."""
        config = self._config
        held_up = down_mps > 0.0 and pad.height_m < STALLED_BELOW_M and pad.vel_ned_mps[2] < STALLED * down_mps
        if not held_up or self._moving_ns is None:
            self._moving_ns = t_ns
        return pad.height_m < config.contact_m or t_ns - self._moving_ns > config.contact_s * NS_PER_S

    def _cone_m(self, pad: Pad) -> float:
        """Permitted error at this height; it widens with the time spent waiting, and narrows again."""
        config = self._config
        return (config.cone_m + config.cone_per_m * pad.height_m) * (1.0 + self._waited_s / config.cone_widening_s)


class Standing:
    """Signs of the vehicle's own that it stands on the platform, whatever the autopilot says. Source: spec §8.

    One is its height over the platform, the other that it rests there although it is pushed down. They count only while
    the platform is measured, and the altimeter may not contradict.
    """

    def __init__(self, config: RoverLandingConfig) -> None:
        self._config = config
        self._since_ns: int | None = None

    def reset(self) -> None:
        """What was seen so far was no touchdown."""
        self._since_ns = None

    def is_sure(self, t_ns: int, pad: Pad | None, range_m: float | None) -> bool:
        """Whether both signs have held for long enough without a break; to be asked all the time of pushing down.

        Args:
            pad: None while the platform isn't measured.
            range_m: of the altimeter, tilt-corrected; None when it measures nothing, as on the ground.
        """
        if pad is None or not self._holds(pad, range_m):
            self.reset()
            return False
        if self._since_ns is None:
            self._since_ns = t_ns
        return t_ns - self._since_ns >= self._config.force_s * NS_PER_S

    def _holds(self, pad: Pad, range_m: float | None) -> bool:
        config = self._config
        low = pad.height_m + LOW_SIGMAS * pad.std_height_m < config.force_below_m
        rests = pad.speed_mps < config.force_mps and abs(pad.vel_ned_mps[2]) < config.force_mps
        on_platform = pad.error_m < config.on_platform_m
        return low and rests and on_platform and (range_m is None or range_m < config.range_force_max_m)
