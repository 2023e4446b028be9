"""The platform as a landing sees it: by the estimate while it is good enough, then by the rover's supposed motion."""

from math import exp

from jezero.frames import Vec3, add, scale, subtract
from jezero.schemas.estimate import Relative
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.platform_control import PlatformState, platform_state_at
from jezero.services.actions.motion.behaviour import VehicleState

STD_ROUGH_PER_M = 0.4
"""Far away, the vehicle comes nearer at its height by an invalid estimate, like that of UWB from afar, whose standard
deviation is below this per metre of distance."""
FEET_BELOW_M, TILT_TIME_CONSTANT_S = 0.22, 1.0
"""Offset of the touchdown per radian of filtered tilt: the feet are below the centre of mass, and the vehicle slides
downwind while it turns upright and the thrust goes."""
DRIVE_TIME_CONSTANT_S = 10.0
"""The rover's supposed speed decays with this time constant."""
STILL: Vec3 = (0.0, 0.0, 0.0)


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
        self.vel_rover_ned_mps = STILL
        self.loss_reason = ""
        self.measured_ns = t_ns
        self.feet_ned_m = STILL
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
