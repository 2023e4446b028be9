"""The platform under a landing: where it is, how the vehicle stays over it, and when and how fast it goes down to it.

Source: spec §8; thesis §4.4.2.
"""

from math import degrees, exp, hypot, sqrt
from typing import NamedTuple

from jezero.base.frames import Vec3, add, altitude_m, scale, subtract
from jezero.schemas.estimate import DeckMotion, Relative
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import DeckConfig, PlatformControlConfig, RoverLandingConfig
from jezero.services.actions.motion.behaviour import VehicleState
from jezero.services.actions.motion.rover_frame import turn_acceleration
from jezero.services.actions.motion.tracking import ZERO

AGE_MAX_NS = 500_000_000
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
        deck: motion of a platform that heaves; None for a still one.
    """

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    vel_rover_ned_mps: Vec3
    yaw_rate_rover_rps: float
    std_m: float = 0.0
    std_height_m: float = 0.0
    deck: DeckMotion | None = None

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
    def acc_rover_ned_mps2(self) -> Vec3:
        """(3,) acceleration of the platform in its turn and in its heave."""
        acc_down_mps2 = 0.0 if self.deck is None else self.deck.acc_down_mps2
        return (*turn_acceleration(self.vel_rover_ned_mps, self.yaw_rate_rover_rps), acc_down_mps2)


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
        relative.deck,
    )


STD_ROUGH_PER_M = 0.4
"""Far away, the vehicle comes nearer at its height by an invalid estimate, like that of UWB from afar, whose standard
deviation is below this per metre of distance."""
FEET_BELOW_M, TILT_TIME_CONSTANT_S = 0.22, 1.0
"""Offset of the touchdown per radian of filtered tilt: the feet are below the centre of mass, and the vehicle slides
downwind while it turns upright and the thrust goes."""
DRIVE_TIME_CONSTANT_S = 10.0
"""The rover's supposed speed decays with this time constant."""


class PlatformTracking:
    """Follows the platform during one landing.

    Args:
        pos_rover_ned_m: rough position of the platform in the world; None when it is not known.
        coast_s: age of the estimate's newest measurement from which on the estimate is not descended by.

    Attributes:
        platform: newest state by a valid estimate, carried on by the rover's supposed motion without one; None before.
        rough: state by an invalid estimate that is good enough to come nearer; None without one.
        pos_rover_ned_m: position of the platform in the world: of the goal, then by the estimates.
        vel_rover_ned_mps: supposed velocity of the rover.
        loss_reason: why the estimate was not good enough to descend by, the last time; "" before.
        measured_ns: time of the last estimate that was good enough to descend by; that of the start before.
        feet_ned_m: vector from the vehicle's reference point to the middle of its feet.
    """

    def __init__(self, t_ns: int, pos_rover_ned_m: Vec3 | None, coast_s: float) -> None:
        self.platform: PlatformState | None = None
        self.rough: PlatformState | None = None
        self.pos_rover_ned_m = pos_rover_ned_m
        self.vel_rover_ned_mps = ZERO
        self.loss_reason = ""
        self.measured_ns = t_ns
        self.feet_ned_m = ZERO
        self._coast_s = coast_s
        self._start_ns = t_ns

    @property
    def was_measured(self) -> bool:
        """Whether the platform has been in sight since the start."""
        return self.measured_ns > self._start_ns

    @property
    def tilt_ned(self) -> tuple[float, float]:
        """(2,) filtered tilt: north and east of the unit vector that points down through the vehicle's feet."""
        north_m, east_m, _ = self.feet_ned_m
        return north_m / FEET_BELOW_M, east_m / FEET_BELOW_M

    def update(self, t_ns: int, dt_s: float, state: VehicleState, *, searches: bool) -> PlatformState | None:
        """Use the newest estimate; returns the state by it when it is good enough to descend by.

        Args:
            searches: the landing searches for the platform.
        """
        relative = state.relative
        self._update_feet(dt_s, state)
        if relative is None or not relative.valid:
            self.loss_reason = "the estimator is silent" if relative is None else relative.reason
            self._predict_rover(dt_s, state, searches=searches)
            self.rough = None if relative is None else self._rough_state(t_ns, relative)
            return None
        self.rough = None
        self.platform = platform = platform_state_at(t_ns, relative, self.feet_ned_m)
        self.pos_rover_ned_m = add(subtract(state.pos_uav_ned_m, platform.pos_ned_m), self.feet_ned_m)
        self.vel_rover_ned_mps = platform.vel_rover_ned_mps
        age_s = (t_ns - relative.fused_t_ns) / NS_PER_S
        if relative.fused_t_ns <= self._start_ns or age_s > self._coast_s:
            self.loss_reason = f"no measurement of the rover for {age_s:.1f} s"
            return None
        self.measured_ns = t_ns
        return platform

    def _rough_state(self, t_ns: int, relative: Relative) -> PlatformState | None:
        """State by an estimate that is good enough to come nearer, but not to descend; None: by no such estimate."""
        platform = platform_state_at(t_ns, relative, self.feet_ned_m)
        fresh = (t_ns - relative.fused_t_ns) / NS_PER_S < self._coast_s and not relative.contradicted
        return platform if fresh and platform.std_m < STD_ROUGH_PER_M * platform.error_m else None

    def _update_feet(self, dt_s: float, state: VehicleState) -> None:
        """Filter the offset of the feet.

        The feet of a vehicle that tilts against the wind are downwind of its centre of mass; on the ground it turns
        upright above them.
        """
        weight = min(1.0, dt_s / TILT_TIME_CONSTANT_S)
        north_m, east_m, _ = self.feet_ned_m
        wanted_north_m, wanted_east_m = (FEET_BELOW_M * tilt for tilt in state.down_ned)
        self.feet_ned_m = (
            north_m + weight * (wanted_north_m - north_m),
            east_m + weight * (wanted_east_m - east_m),
            0.0,
        )

    def _predict_rover(self, dt_s: float, state: VehicleState, *, searches: bool) -> None:
        """Predict the rover's motion without a valid estimate, by its own estimate or its last velocity.

        During a search the supposed velocity decays, because the last one becomes worthless, and may have been wrong.
        """
        if state.rover is not None and state.rover.valid:
            self.pos_rover_ned_m = state.rover.pos_rover_ned_m
            self.vel_rover_ned_mps = state.rover.vel_rover_ned_mps
        elif self.pos_rover_ned_m is not None:
            if searches:
                decay = exp(-dt_s / DRIVE_TIME_CONSTANT_S)
                self.vel_rover_ned_mps = scale(self.vel_rover_ned_mps, decay)
            self.pos_rover_ned_m = add(self.pos_rover_ned_m, scale(self.vel_rover_ned_mps, dt_s))
        if self.platform is not None and self.pos_rover_ned_m is not None:
            pos_ned_m = add(subtract(state.pos_uav_ned_m, self.pos_rover_ned_m), self.feet_ned_m)
            vel_ned_mps = subtract(state.vel_uav_ned_mps, self.vel_rover_ned_mps)
            yaw_rate_rps = self.platform.yaw_rate_rover_rps
            self.platform = PlatformState(pos_ned_m, vel_ned_mps, self.vel_rover_ned_mps, yaw_rate_rps)


FAR_M, NEAR_M = 3.5, 0.5
"""Between these errors the gain is interpolated; the integral is reset beyond FAR_M and grows only within NEAR_M."""
INTEGRAL_MAX_MPS = 0.3
"""Limit of the integral's part."""


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
        acc_north_mps2, acc_east_mps2, _ = platform.acc_rover_ned_mps2
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
        braking_mps = sqrt(2.0 * config.deceleration_mps2 * error_m)
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


CALM_PREDICTION_S = 1.0
"""The motion of a platform that heaves is predicted for this time at most."""
STEP_MAX_S = 0.1
BEGIN_MARGIN_M = 0.5
"""The vehicle is at the height of the approach when it is at most this much above or below it."""
STALLED_SPEED_RATIO = 0.5
"""The vehicle is stalled while it descends at less than this ratio of the commanded speed."""
STALLED_HEIGHT_MAX_M = 0.3
"""Stalls higher than this are gusts, not contact."""
STD_M, STD_PER_M = 0.1, 0.15
"""The vehicle descends only while the position's standard deviation is below STD_M + STD_PER_M * height."""
PREDICTION_S = 0.3
"""The error is predicted for this time ahead."""
SPEED_GATE_MPS = 0.5
"""The vehicle descends only while its horizontal speed relative to the platform is below this."""
GAIN_DESCENT_1PS = 0.6
"""Rate of descent per metre of height."""
COMMIT_M = 0.1
"""Height over the platform below which the vehicle descends without waiting, if the platform is below it: in gusts, a
wait so close to the platform is worse than a larger error."""
STRAYED_CONES = 4.0
"""The vehicle climbs when the error is larger than this number of cone radii."""
CONTACT_M, CONTACT_S = 0.03, 0.4
"""A lower foot than this counts as contact, and so does a stop of this duration during the descent."""


class CalmMoment:
    """Waits for a moment in which a platform that heaves will be calm at the touchdown."""

    def __init__(self, config: DeckConfig) -> None:
        self._config = config
        self._waited_s = 0.0

    def is_calm(self, passed_s: float, deck: DeckMotion, climb_down_mps: float, touchdown_s: float) -> bool:
        """Whether the platform is calm in `touchdown_s`; the limits widen with the time spent waiting.

        Args:
            passed_s: time since the last call.
            climb_down_mps: present vertical speed of the platform, positive down.
        """
        config = self._config
        later_s = min(touchdown_s, CALM_PREDICTION_S)
        climb_mps = abs(climb_down_mps + deck.acc_down_mps2 * later_s)
        tilt_rad = hypot(
            deck.roll_rad + deck.roll_rate_rps * later_s,
            deck.pitch_rad + deck.pitch_rate_rps * later_s,
        )
        wider = 1.0 + self._waited_s / config.widening_s
        if climb_mps < wider * config.climb_calm_mps and tilt_rad < wider * config.tilt_calm_rad:
            return True
        self._waited_s += passed_s
        return False


def deck_refusal(deck: DeckMotion | None, config: DeckConfig) -> str:
    """Reason not to descend to a platform that heaves or tilts too much, or ""."""
    if deck is None or deck.observed_s < config.observe_s:
        return ""
    moves = (
        f"the platform heaves with {deck.climb_significant_mps:.2f} m/s and tilts by "
        f"{degrees(deck.tilt_significant_rad):.0f} degrees (significant values)"
    )
    if deck.climb_significant_mps > config.climb_max_mps:
        limit = f"{config.climb_max_mps:g} m/s (climb_max_mps)"
    elif deck.tilt_significant_rad > config.tilt_max_rad:
        limit = f"{degrees(config.tilt_max_rad):.0f} degrees (tilt_max_rad)"
    else:
        return ""
    return f"{moves}, and a landing is limited to {limit}: wait until it moves less, or use force"


class Descent:
    """Descent inside a cone that narrows towards the middle of the platform.

    Args:
        room_m: distance from the middle of the platform up to which the vehicle may stand.
    """

    def __init__(self, config: RoverLandingConfig, room_m: float) -> None:
        self._config = config
        self._room_m = room_m
        self._calm = CalmMoment(config.deck)
        self._waited_s = 0.0
        self._t_ns: int | None = None
        self._moving_ns: int | None = None

    def may_begin(self, platform: PlatformState) -> bool:
        """Whether the vehicle is over the platform, at the height of the approach, and slow.

        A platform that heaves must have been observed for long enough.
        """
        config = self._config
        if platform.deck is not None and platform.deck.observed_s < config.deck.observe_s:
            return False
        low = platform.height_m < config.height_approach_m + BEGIN_MARGIN_M
        slow = platform.speed_mps < SPEED_GATE_MPS
        return low and slow and platform.error_m < self.cone_m(platform)

    def down_mps(self, t_ns: int, platform: PlatformState) -> float:
        """Speed downwards relative to the platform: none outside the cone, upwards far outside."""
        config = self._config
        gap_s = 0.0 if self._t_ns is None else max((t_ns - self._t_ns) / NS_PER_S, 0.0)
        if gap_s > STEP_MAX_S:
            self._moving_ns = None  # it has hovered meanwhile, which is no stop of the descent
        passed_s = min(gap_s, STEP_MAX_S)
        self._t_ns = t_ns
        proportional_mps = GAIN_DESCENT_1PS * platform.height_m
        wanted_mps = min(max(proportional_mps, config.descent_min_mps), config.descent_max_mps)
        if platform.height_m < COMMIT_M and platform.error_in_m(PREDICTION_S) < self._room_m:
            return wanted_mps
        cone_m = self.cone_m(platform)
        certain = platform.std_m < STD_M + STD_PER_M * platform.height_m
        inside = platform.error_in_m(PREDICTION_S) < cone_m
        if platform.deck is not None and platform.height_m < config.deck.height_wait_m:
            touchdown_s = platform.height_m / wanted_mps
            if not self._calm.is_calm(passed_s, platform.deck, platform.vel_rover_ned_mps[2], touchdown_s):
                return 0.0
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


FASTER_DOWN_MPS2, SLOWER_DOWN_MPS2 = 2.0, 8.0
"""The vertical velocity setpoint changes at most this fast: a gust may end and begin the descent in turn."""
AT_ONCE_BELOW_M = 0.6
"""Below this height over the platform the setpoint changes at once. The speeds are low there, and a vehicle that
descends later than it wants to touches down away from the platform's middle."""


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
