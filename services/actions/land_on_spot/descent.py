"""Descent onto the platform: when and how fast the vehicle goes down, and detection of the contact."""

from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import RoverLandingConfig
from jezero.services.actions.land_on_spot.platform_control import PlatformState
from jezero.vehicle_config import VehicleConfig

BEGIN_MARGIN_M = 0.5
"""The descent begins when the vehicle is at most this much above the height of the approach."""
STALLED_SPEED_RATIO = 0.5
"""The vehicle is stalled while it descends at less than this ratio of the commanded speed."""
STALLED_HEIGHT_MAX_M = 0.3
"""Stalls higher than this are gusts, not contact."""
STEP_MAX_S = 0.1
STD_M, STD_PER_M = 0.1, 0.15
"""The vehicle descends only while the position's standard deviation is below STD_M + STD_PER_M * height."""
PREDICTION_S = 0.3
"""The error is predicted for this time ahead."""
SPEED_GATE_MPS = 0.5
"""The vehicle descends only while its horizontal speed relative to the platform is below this."""
GAIN_DESCENT_1PS = 0.6
"""Rate of descent per metre of height."""
COMMIT_M = 0.1
"""Below this height the vehicle descends without waiting, as long as the place below it is on the platform: in gusts,
waiting so close to the platform is worse than a larger error."""
FASTER_DOWN_MPS2, SLOWER_DOWN_MPS2 = 2.0, 8.0
"""The vertical velocity setpoint changes at most this fast: a gust may end and begin the descent in turn."""
AT_ONCE_BELOW_M = 0.6
"""Below this height over the platform the setpoint changes at once. The speeds are low there, and a vehicle that
descends later than it wants to touches down away from the platform's middle."""
STRAYED_CONES = 4.0
"""The vehicle climbs when the error is larger than this number of cone radii."""
CONTACT_M, CONTACT_S = 0.03, 0.4
"""A lower foot than this counts as contact, and so does a stop of this duration during the descent."""
FORCE_S = 3.0
"""Duration for which the conditions of a forced disarm must hold. Source: spec §8, which wants 2 s at least; PX4 takes
about as long to detect the ground."""
FORCE_BELOW_M, FORCE_MPS = 0.1, 0.2
"""A forced disarm needs a height that is surely below this, and a relative speed below this although the vehicle is
pushed down."""
FORCE_FEET_MAX_M = 0.1
"""A forced disarm needs an altimeter range, tilt-corrected, of feet lower than this, or none."""
HEIGHT_SIGMAS = 2.0
"""The height plus this many standard deviations must be below the limit of a forced disarm."""


class Descent:
    """Descent inside a cone that narrows towards the middle of the platform.

    Args:
        room_m: distance from the middle of the platform up to which the vehicle may stand.
    """

    def __init__(self, config: RoverLandingConfig, room_m: float) -> None:
        self._config = config
        self._room_m = room_m
        self._waited_s = 0.0
        self._t_ns: int | None = None
        self._moving_ns: int | None = None

    def may_begin(self, platform: PlatformState) -> bool:
        """Whether the vehicle is over the platform, at the height of the approach, and slow."""
        config = self._config
        low = platform.height_m < config.height_approach_m + BEGIN_MARGIN_M
        slow = platform.speed_mps < SPEED_GATE_MPS
        return low and slow and platform.error_m < self.cone_m(platform)

    def down_mps(self, t_ns: int, platform: PlatformState) -> float:
        """Speed downwards relative to the platform: none outside the cone, upwards far outside."""
        config = self._config
        passed_s = 0.0 if self._t_ns is None else min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        proportional_mps = GAIN_DESCENT_1PS * platform.height_m
        wanted_mps = min(max(proportional_mps, config.descent_min_mps), config.descent_max_mps)
        if platform.height_m < COMMIT_M and platform.error_in_m(PREDICTION_S) < self._room_m:
            return wanted_mps
        cone_m = self.cone_m(platform)
        certain = platform.std_m < STD_M + STD_PER_M * platform.height_m
        inside = platform.error_in_m(PREDICTION_S) < cone_m
        if certain and inside and platform.speed_mps < SPEED_GATE_MPS:
            self._waited_s = max(0.0, self._waited_s - passed_s)
            return wanted_mps
        self._waited_s += passed_s
        strayed = platform.error_m > STRAYED_CONES * cone_m and platform.height_m < config.height_approach_m
        return -config.descent_min_mps if strayed else 0.0

    def cone_m(self, platform: PlatformState) -> float:
        """Permitted error at this height; it widens with the time spent waiting, and narrows again.

        Its foot stays on the platform: a vehicle that lands beside the room there would tip over the edge.
        """
        config = self._config
        cone_m = config.cone_m + config.cone_per_m * platform.height_m
        widest_m = self._room_m + config.cone_per_m * platform.height_m
        return max(cone_m, min(cone_m * (1.0 + self._waited_s / config.cone_widening_s), widest_m))

    def has_contact(self, t_ns: int, platform: PlatformState, feet_m: float, down_mps: float) -> bool:
        """Whether the vehicle is as low as it can be, or is stalled low over the platform although it descends.

        Args:
            feet_m: height of the lowest foot over the platform; a vehicle that is tilted by the wind touches with one.
        """
        slow = platform.vel_ned_mps[2] < STALLED_SPEED_RATIO * down_mps
        stalled = down_mps > 0.0 and platform.height_m < STALLED_HEIGHT_MAX_M and slow
        if not stalled or self._moving_ns is None:
            self._moving_ns = t_ns
        return feet_m < CONTACT_M or t_ns - self._moving_ns > CONTACT_S * NS_PER_S


class VerticalSpeed:
    """Vertical velocity setpoint, which makes no jumps however often the descent waits and goes on."""

    def __init__(self) -> None:
        self._t_ns: int | None = None
        self._down_mps = 0.0

    def changed(self, t_ns: int, wanted_mps: float, vel_down_mps: float, *, gradually: bool) -> float:
        """The next setpoint, positive down.

        Args:
            wanted_mps: the descent's, positive down.
            vel_down_mps: of the vehicle: the setpoint begins there when something else has moved the vehicle.
            gradually: whether it changes by the limits, or at once.
        """
        passed_ns = None if self._t_ns is None else t_ns - self._t_ns
        if passed_ns is None or passed_ns > STEP_MAX_S * NS_PER_S:
            self._down_mps, passed_ns = vel_down_mps, 0
        change_mps = wanted_mps - self._down_mps
        if gradually:
            passed_s = passed_ns / NS_PER_S
            change_mps = min(max(change_mps, -SLOWER_DOWN_MPS2 * passed_s), FASTER_DOWN_MPS2 * passed_s)
        self._down_mps += change_mps
        self._t_ns = t_ns
        return self._down_mps


class TouchdownDetector:
    """Detects that the vehicle stands on the platform, independently of the autopilot. Source: spec §8.

    Two signs must hold: the height over the platform is low, and the vehicle rests there although it is pushed down.
    They count only while the platform is measured, and the altimeter may not contradict them.
    """

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._on_platform_m = 0.5 * vehicle.platform.side_m
        self._range_max_m = vehicle.height_altimeter_m + FORCE_FEET_MAX_M
        self._since_ns: int | None = None

    def reset(self) -> None:
        """Start again, because the signs so far were no touchdown."""
        self._since_ns = None

    def update(self, t_ns: int, platform: PlatformState | None, range_m: float | None) -> bool:
        """Add the newest state; returns whether both signs have held for long enough without a break.

        To be called in every step in which the vehicle is pushed down.

        Args:
            platform: None while the platform isn't measured.
            range_m: of the altimeter, tilt-corrected; None when it measures nothing, as on the ground.
        """
        if platform is None or not self._has_signs(platform, range_m):
            self.reset()
            return False
        if self._since_ns is None:
            self._since_ns = t_ns
        return t_ns - self._since_ns >= FORCE_S * NS_PER_S

    def _has_signs(self, platform: PlatformState, range_m: float | None) -> bool:
        low = platform.height_m + HEIGHT_SIGMAS * platform.std_height_m < FORCE_BELOW_M
        rests = platform.speed_mps < FORCE_MPS and abs(platform.vel_ned_mps[2]) < FORCE_MPS
        on_platform = platform.error_m < self._on_platform_m
        return low and rests and on_platform and (range_m is None or range_m < self._range_max_m)
