"""Landing on the rover by the estimate of the relative pose. Source: spec §8, cases 1 to 3; thesis §4.4, Fig. 4.7.

Approach, descent, contact. The vehicle descends only while the estimate is valid and fresh: when the rover is out of
sight for half a second it holds its height, then it climbs and searches, and when it finds nothing it hovers.
"""

from math import cos, hypot, pi, sin

from msgspec.structs import replace

from jezero.base.frames import Vec3, add, altitude_m, norm, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.commands import Phase
from jezero.schemas.goals import LandFeedback, LandPhase, LandResult
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig, RoverLandingConfig, SearchConfig
from jezero.services.actions.land_on_spot.contact import (
    CLIMB_MPS,
    DISARM_S,
    ContactWatcher,
    GoArounds,
    OnSurface,
    TouchdownDetector,
    feet_from_uav_ned_m,
    foot_drop_m,
    is_below,
    landing_outcome,
)
from jezero.services.actions.land_on_spot.landing_watch import LandingWatch, WindLimit
from jezero.services.actions.land_on_spot.paused_hover import PausedHover, towards
from jezero.services.actions.land_on_spot.platform import (
    AT_ONCE_BELOW_M,
    BEGIN_MARGIN_M,
    COMMIT_M,
    CONTACT_S,
    GAIN_DESCENT_1PS,
    Descent,
    PlatformControl,
    PlatformState,
    PlatformTracking,
    VerticalSpeed,
    deck_refusal,
)
from jezero.services.actions.motion.behaviour import Done, Move, MovingFrame, Remaining, Selection, VehicleState

CLEAR_M = 1.0
"""A vehicle lower than this and beside the platform climbs before it comes near."""
VIEW_PER_M = 1.6
"""Least height on the way per metre of distance with the tag alone, to keep the tag in view."""
GAIN_HEIGHT_1PS, SPEED_UP_MPS, SPEED_DOWN_MAX_MPS = 0.8, 1.0, 1.2
"""Vertical speed on the way per metre of height, and its limits."""
PUSH_MPS = 0.5
"""Downward speed after contact. Source: spec §8."""
CONTACT_TIMEOUT_S = 10.0
"""The goal is aborted when the vehicle isn't disarmed within this time after contact."""
BLIND_M = 0.25
"""Below this height the platform need not be in sight any more."""
KNOWN_STD_MAX_M = 10.0
"""Standard deviation up to which a rover out of sight, whose odometry goes on, is worth a flight to it and a search."""
ACQUIRE_S = 3.0
"""Time for the first estimate, before the search begins."""
SEARCH_SPEED_MPS, SEARCH_SPEED_DOWN_MAX_MPS = 1.5, 0.15
"""Speeds of the search; it descends slowly, because only the autopilot's height is known, which its barometer may have
wrong."""
STEP_MAX_S = 0.1
BOUNCE_M = 0.4
"""A vehicle that is higher than this over the platform after contact descends again."""
LOST = "TARGET_LOST"
BESIDE_MARGIN_M = 0.3
"""A vehicle that is farther than this beyond the platform's edge is beside the platform: no rotor is above it."""


class RoverLanding:
    """One landing on the rover.

    Args:
        selection: of the estimator's inputs for this landing.
        vehicle: the vehicle and the platform.
        force: land in more wind, and on a deck that moves more, than the settings allow, too.
    """

    def __init__(
        self,
        selection: Selection,
        settings: LandOnSpotConfig,
        vehicle: VehicleConfig,
        force: bool,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._tag_alone = not selection.use_uwb
        self._land = land = settings.rover
        self._airframe = vehicle.airframe
        self._uwb_range_m = vehicle.uwb.range_max_m
        self._on_platform_m = 0.5 * vehicle.platform.side_m
        room_m = max(self._on_platform_m - hypot(*vehicle.airframe.feet_frd_m), 0.0)
        self._force = force
        self._wind_limit = WindLimit(settings.wind_max_mps, force)
        self._control = PlatformControl(land.platform_control)
        self._descent = Descent(land, room_m)
        self._vertical = VerticalSpeed()
        self._contact = ContactWatcher(room_m, vehicle.planet)
        self._go_arounds = GoArounds(settings.go_arounds_max)
        self._watch = LandingWatch(land, t_ns, state)
        self._touchdown = TouchdownDetector(vehicle)
        self._phase: LandPhase = "approach"
        self._search: Search | None = None
        self._tracking = PlatformTracking(t_ns, selection.pos_rover_ned_m, land.coast_s)
        self._t_ns = self._wait_from_ns = t_ns
        self._contact_ns = 0
        self._t_paused_ns = -1
        self._paused = PausedHover(land.height_approach_m)
        self._yaw_rad = state.yaw_rad
        self._hold_ned_m = state.pos_uav_ned_m

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        dt_s = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        measured = self._tracking.update(t_ns, dt_s, state, searches=self._phase == "search")
        if measured is not None:
            self._hold_ned_m = state.pos_uav_ned_m
        self._wind_limit.update(t_ns, state)
        if state.landed and self._phase in ("descent", "contact"):
            return self._landed(state)
        if (end := self._watch.update(t_ns, state, self._phase, self._tracking.loss_reason)) is not None:
            return end
        if self._phase == "go_around":
            return self._go_around(t_ns, dt_s, measured, state)
        return self._go_on(t_ns, dt_s, measured, state)

    def pause_refusal(self, state: VehicleState) -> str:
        """Reason why the landing can't be paused now, or ""."""
        if self._phase == "contact":
            return "the vehicle touches the platform: the landing ends in a moment, or goes around"
        if self._phase == "go_around":
            return "the vehicle climbs after a bad contact: pause the goal again in some seconds"
        return ""

    def hold(self, t_ns: int, dt_s: float, state: VehicleState) -> Move | Done:
        """Hover over the rover while it is in sight, else where it is; the landing goes on with its approach.

        A vehicle lower than the approach climbs to its height first: a rover may turn or stop at any time, and the
        ground and the platform push and pull a vehicle that hovers close to them.
        """
        if self._t_paused_ns != t_ns:
            self._t_paused_ns = t_ns
            self._paused = PausedHover(self._land.height_approach_m, self._tracking.vel_rover_ned_mps)
        measured = self._tracking.update(t_ns, dt_s, state, searches=self._phase == "search")
        self._vertical = VerticalSpeed()
        self._hold_ned_m = state.pos_uav_ned_m
        if self._phase != "search":
            self._phase = "approach"
        if (end := self._watch.update(t_ns, state, self._phase, self._tracking.loss_reason)) is not None:
            return end
        if measured is None:
            return self._move(state, self._paused.velocity(dt_s, state.pos_uav_ned_m, state.height_m), None)
        vel_rover_ned_mps = measured.vel_rover_ned_mps
        return self._move(
            state, self._paused.velocity(dt_s, measured.pos_ned_m, measured.height_m, vel_rover_ned_mps), None
        )

    def _go_on(self, t_ns: int, dt_s: float, measured: PlatformState | None, state: VehicleState) -> Move | Done:
        """Go on with a landing that nothing interrupts."""
        if self._phase == "contact" and self._tracking.platform is not None:
            return self._press_down(t_ns, measured, self._tracking.platform, state)
        if measured is not None:
            return self._over_platform(t_ns, dt_s, measured, state)
        if self._tracking.rough is not None and self._phase == "approach":
            self._wait_from_ns = t_ns
            self._hold_ned_m = state.pos_uav_ned_m
            return self._keep_height_over(state, self._tracking.rough, dt_s)
        return self._out_of_sight(t_ns, dt_s, state)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> LandResult:
        return LandResult(completed=completed, touchdown_ned_m=pos_uav_ned_m if completed else None)

    def remaining(self, state: VehicleState) -> Remaining | None:
        """Rest of the landing; None while nobody knows where the rover is."""
        if self._tracking.platform is not None:
            pos_ned_m = self._tracking.platform.pos_ned_m
        elif self._tracking.pos_rover_ned_m is not None:
            pos_ned_m = subtract(state.pos_uav_ned_m, self._tracking.pos_rover_ned_m)
        else:
            return None
        # As long as UWB doesn't reach the rover, the vehicle comes nearer with the speed of a search.
        beyond_m = max(norm(pos_ned_m) - self._uwb_range_m, 0.0)
        search_s = ACQUIRE_S + beyond_m / SEARCH_SPEED_MPS if beyond_m > 0.0 else 0.0
        return rover_landing_remaining(pos_ned_m, self._land) + Remaining(search_s, 0.0)

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The way above the platform and down to the platform; empty while the position of the rover is unknown."""
        platform_ned_m = self._tracking.pos_rover_ned_m
        if self._tracking.platform is not None:
            platform_ned_m = subtract(state.pos_uav_ned_m, self._tracking.platform.pos_ned_m)
        if platform_ned_m is None:
            return ()
        above_ned_m = add(platform_ned_m, (0.0, 0.0, -self._land.height_approach_m))
        return state.pos_uav_ned_m, above_ned_m, platform_ned_m

    # -- with the platform in sight --

    def _over_platform(self, t_ns: int, dt_s: float, platform: PlatformState, state: VehicleState) -> Move | Done:
        if self._phase in ("hold", "search"):
            self._control.reset()
            self._phase = "approach"
        self._search = None
        refusal = self._deck_refusal(platform)
        if refusal and platform.height_m > COMMIT_M:
            self._phase = "approach"  # whose height it climbs to, before it ends: the deck heaves towards the vehicle
        elif self._phase == "approach" and self._descent.may_begin(platform):
            self._phase = "descent"
        if self._phase == "approach":
            high = platform.height_m > self._land.height_approach_m - BEGIN_MARGIN_M
            if reason := self._wind_limit.reason or (refusal if high else ""):
                return Done("aborted", reason)
            if platform.height_m < CLEAR_M and platform.error_m > self._on_platform_m + BESIDE_MARGIN_M:
                # Climb first, because the straight way would lead into the rover's side.
                return self._fly(state, (0.0, 0.0, -SPEED_UP_MPS), None)
            return self._follow(state, platform, dt_s, self._approach_mps(platform, state.height_m))
        return self._go_down(t_ns, dt_s, platform, state)

    def _deck_refusal(self, platform: PlatformState) -> str:
        return "" if self._force else deck_refusal(platform.deck, self._land.deck)

    def _approach_mps(self, platform: PlatformState, height_m: float | None) -> float:
        """Speed downwards during the approach: to its height, but not so low that the tag gets out of view.

        Args:
            height_m: by the altimeter, which is believed when the estimate says that the vehicle is higher.
        """
        land = self._land
        in_view_m = min(VIEW_PER_M * platform.error_m, platform.height_m) if self._tag_alone else 0.0
        above_m = platform.height_m - max(land.height_approach_m, in_view_m)
        if height_m is not None:
            above_m = min(above_m, max(height_m - CLEAR_M, 0.0))
        return min(max(GAIN_HEIGHT_1PS * above_m, -SPEED_UP_MPS), SPEED_DOWN_MAX_MPS)

    def _go_down(self, t_ns: int, dt_s: float, platform: PlatformState, state: VehicleState) -> Move | Done:
        feet_m = platform.height_m - foot_drop_m(state.q_ned_from_frd, self._airframe)
        down_mps = self._descent.down_mps(t_ns, platform)
        if self._descent.has_contact(t_ns, platform, feet_m, down_mps):
            self._phase = "contact"
            self._contact_ns = t_ns
            self._touchdown.reset()
            self._contact.begin(t_ns, self._tracking.tilt_ned)
            return self._press_down(t_ns, None, platform, state)
        return self._follow(state, platform, dt_s, down_mps)

    def _press_down(
        self, t_ns: int, measured: PlatformState | None, platform: PlatformState, state: VehicleState
    ) -> Move | Done:
        """Push down and move with the platform until the autopilot or the touchdown detector detects the landing.

        Args:
            measured: None while the platform isn't measured.
        """
        if self._touchdown.update(t_ns, measured, state.height_m, platform.deck, state.pos_uav_ned_m[2]):
            return Done("succeeded", then="force_disarm")
        if problem := self._contact.update(t_ns, self._on_surface(measured, state), state, measured):
            self._phase = "go_around"
            self._go_arounds.begin(t_ns, problem, state)
            return self._go_around(t_ns, 0.0, measured, state)
        waited_s = (t_ns - self._contact_ns) / NS_PER_S
        if waited_s > CONTACT_TIMEOUT_S:
            return Done("aborted", f"the autopilot doesn't detect the ground {waited_s:.0f} s after contact")
        if platform.height_m > BOUNCE_M:
            self._phase = "descent"
        push_acc_ned_mps2 = self._contact.push_acc_ned_mps2(platform.vel_ned_mps[2])
        acc_ned_mps2 = add(push_acc_ned_mps2, platform.acc_rover_ned_mps2)
        vel_ned_mps = add(platform.vel_rover_ned_mps, (0.0, 0.0, PUSH_MPS))
        return self._move(state, vel_ned_mps, acc_ned_mps2)

    def _on_surface(self, measured: PlatformState | None, state: VehicleState) -> OnSurface | None:
        """Where the feet are now: in contact the tilt changes faster than the filtered offset of the feet."""
        if measured is None:
            return None
        (north_m, east_m, _), (filtered_north_m, filtered_east_m, _) = measured.pos_ned_m, self._tracking.feet_ned_m
        feet_north_m, feet_east_m = feet_from_uav_ned_m(state, self._airframe)
        offset_ned_m = (north_m - filtered_north_m + feet_north_m, east_m - filtered_east_m + feet_east_m)
        return OnSurface(offset_ned_m, measured.std_m)

    def _go_around(self, t_ns: int, dt_s: float, measured: PlatformState | None, state: VehicleState) -> Move | Done:
        """Climb after a contact in which the vehicle slides or leans, then try again, or end the landing."""
        platform = measured or self._tracking.platform
        if self._go_arounds.is_high(t_ns, None if platform is None else platform.height_m):
            if reason := self._go_arounds.abort_reason(state):
                return Done("aborted", reason)
            self._phase = "approach"
        if measured is not None:
            return self._follow(state, measured, dt_s, -CLIMB_MPS)
        return self._fly(state, add(self._tracking.vel_rover_ned_mps, (0.0, 0.0, -CLIMB_MPS)), None)

    def _landed(self, state: VehicleState) -> Done:
        beside_m = 0.0 if self._tracking.platform is None else self._tracking.platform.error_m
        if beside_m > self._on_platform_m:
            return Done("aborted", f"touched down {beside_m:.2f} m from the middle of the platform", then="disarm")
        if is_below(self._tracking.platform):
            reason = "touched down below the platform's surface by the estimate: the vehicle stands beside the platform"
            return Done("aborted", reason, then="disarm")
        return landing_outcome(state)

    # -- with the platform out of sight --

    def _out_of_sight(self, t_ns: int, dt_s: float, state: VehicleState) -> Move | Done:
        if state.relative is not None and state.relative.contradicted:
            self._phase = "hold"
            return self._wait(state)
        land, platform = self._land, self._tracking.platform
        lost_s = (t_ns - self._tracking.measured_ns) / NS_PER_S
        was_measured = self._tracking.was_measured
        if self._phase == "descent" and platform is not None and platform.height_m < BLIND_M:
            return self._go_down(t_ns, dt_s, platform, state)
        if was_measured and platform is not None and self._phase != "search" and lost_s < land.hold_s:
            self._phase = "hold"
            return self._keep_height_over(state, platform, dt_s)
        waited_s = (t_ns - self._wait_from_ns) / NS_PER_S
        if not was_measured and not self._tag_alone and waited_s < ACQUIRE_S:
            return self._wait(state)
        rover = state.rover
        if self._tracking.pos_rover_ned_m is None and rover is not None and rover.std_pos_m <= KNOWN_STD_MAX_M:
            self._tracking.pos_rover_ned_m = rover.pos_rover_ned_m  # as its odometry has it
        if self._tracking.pos_rover_ned_m is None:
            return Done("aborted", f"{LOST}: the rover can't be found: {self._tracking.loss_reason}")
        return self._fly_search(t_ns, self._tracking.pos_rover_ned_m, state)

    def _wait(self, state: VehicleState) -> Move:
        return Move(Phase.LANDING, self._feedback(state), pos_ned_m=self._hold_ned_m, yaw_rad=self._yaw_rad)

    def _fly_search(self, t_ns: int, supposed_ned_m: Vec3, state: VehicleState) -> Move | Done:
        """Fly to the rover's supposed position, then around it, higher and wider."""
        north_m, east_m, down_m = subtract(state.pos_uav_ned_m, supposed_ned_m)
        height_m = altitude_m(down_m)
        self._phase = "search"
        if self._search is None:
            low_m = self._land.height_approach_m
            self._search = Search(t_ns, max(low_m, height_m), self._land.search)
        search = self._search
        search.step(t_ns, (north_m, east_m), height_m)
        if search.over:
            tries = self._land.search.tries
            return Done("aborted", f"{LOST}: not found in {tries} rounds of search: {self._tracking.loss_reason}")
        to_north_m, to_east_m = search.offset_m
        offset_m = (to_north_m - north_m, to_east_m - east_m, height_m - search.height_m)
        rover_north_mps, rover_east_mps, _ = self._tracking.vel_rover_ned_mps
        north_mps, east_mps, down_mps = towards(offset_m, SEARCH_SPEED_MPS)
        low = state.height_m is not None and state.height_m < self._land.height_approach_m
        down_mps = min(down_mps, 0.0 if low else SEARCH_SPEED_DOWN_MAX_MPS)
        return self._fly(state, (rover_north_mps + north_mps, rover_east_mps + east_mps, down_mps), None)

    # -- moves --

    def _follow(self, state: VehicleState, platform: PlatformState, dt_s: float, down_mps: float) -> Move:
        (north_mps, east_mps), acc_mps2 = self._control.command(dt_s, platform)
        down_mps += platform.vel_rover_ned_mps[2]
        gradually = platform.height_m > AT_ONCE_BELOW_M
        acc_ned_mps2 = (*acc_mps2, platform.acc_rover_ned_mps2[2])
        vel_ned_mps = (north_mps, east_mps, down_mps)
        return self._fly(state, vel_ned_mps, acc_ned_mps2, platform.pos_ned_m[:2], gradually=gradually)

    def _keep_height_over(self, state: VehicleState, platform: PlatformState, dt_s: float) -> Move:
        """Follow the platform horizontally; by an estimate that isn't valid the vehicle doesn't move vertically."""
        (north_mps, east_mps), acc_mps2 = self._control.command(dt_s, platform)
        return self._fly(state, (north_mps, east_mps, 0.0), (*acc_mps2, 0.0), platform.pos_ned_m[:2])

    def _fly(
        self,
        state: VehicleState,
        vel_ned_mps: Vec3,
        acc_ned_mps2: Vec3 | None,
        offset_m: tuple[float, float] | None = None,
        *,
        gradually: bool = False,
    ) -> Move:
        """Move at a velocity.

        Args:
            offset_m: (2,) north and east of the vehicle from the point that the velocity leads to; None: to no point.
            gradually: change the vertical velocity without a jump, which only a valid estimate permits.
        """
        north_mps, east_mps, down_mps = vel_ned_mps
        down_mps = self._vertical.changed(self._t_ns, down_mps, state.vel_uav_ned_mps[2], gradually=gradually)
        move = self._move(state, (north_mps, east_mps, down_mps), acc_ned_mps2)
        if offset_m is None:
            return move
        return replace(move, target_ned_m=subtract(state.pos_uav_ned_m, (*offset_m, 0.0)))

    def _move(self, state: VehicleState, vel_ned_mps: Vec3, acc_ned_mps2: Vec3 | None) -> Move:
        return Move(
            Phase.LANDING,
            self._feedback(state),
            vel_ned_mps=vel_ned_mps,
            acc_ned_mps2=acc_ned_mps2,
            yaw_rad=self._yaw_rad,
            frame=MovingFrame(vel_ned_mps=self._tracking.vel_rover_ned_mps),
        )

    def _feedback(self, state: VehicleState) -> LandFeedback:
        pos_m = state.pos_uav_ned_m
        if self._tracking.platform is None:
            return LandFeedback(pos_uav_ned_m=pos_m, phase=self._phase)
        rel_m, cone_m = self._tracking.platform.pos_ned_m, max(self._descent.cone_m(self._tracking.platform), 0.0)
        return LandFeedback(pos_uav_ned_m=pos_m, pos_rel_ned_m=rel_m, phase=self._phase, cone_m=cone_m)


SEARCH_CORNERS = 6
SEARCH_CLIMB_M = 1.5
"""Height between two rounds."""
SEARCH_REACHED_M = 0.5
"""Distance at which a corner counts as reached."""
SEARCH_CORNER_TIMEOUT_S = 10.0


class Search:
    """Flies from corner to corner of the rounds.

    Args:
        height_m: over the platform, or over the ground at the rover's supposed position, when the search begins.

    Attributes:
        offset_m: (2,) north and east of the present corner from the rover's supposed position.
        height_m: height of the present corner.
        over: whether all rounds are flown.
    """

    def __init__(self, t_ns: int, height_m: float, config: SearchConfig) -> None:
        self._config = config
        self._height_start_m = height_m
        self._number = 0
        self._since_ns = t_ns
        self.over = False
        self._aim()

    def step(self, t_ns: int, offset_m: tuple[float, float], height_m: float) -> None:
        """Go on to the next corner when this one is reached, or its time is over.

        Args:
            offset_m: (2,) of the vehicle from the rover's supposed position.
            height_m: of the vehicle.
        """
        away_m = hypot(offset_m[0] - self.offset_m[0], offset_m[1] - self.offset_m[1], height_m - self.height_m)
        waited_s = (t_ns - self._since_ns) / NS_PER_S
        if away_m < SEARCH_REACHED_M or waited_s > SEARCH_CORNER_TIMEOUT_S:
            self._number += 1
            self._since_ns = t_ns
            self._aim()

    def _aim(self) -> None:
        """Set the next corner; each round begins over the middle, and goes around it higher than the one before."""
        config = self._config
        turn, corner = divmod(self._number, SEARCH_CORNERS + 1)
        self.over = turn >= config.tries
        up_m = SEARCH_CLIMB_M * (turn + (corner > 0))
        self.height_m = max(self._height_start_m, min(self._height_start_m + up_m, config.height_max_m))
        radius_m = 0.0 if corner == 0 else config.radius_m * (turn + 1)
        angle_rad = 2.0 * pi * (corner - 1) / SEARCH_CORNERS
        self.offset_m = (radius_m * cos(angle_rad), radius_m * sin(angle_rad))


APPROACH_DOWN_MPS = 1.2
"""Speed downwards on the way to the rover."""
DESCENT_STEP_M = 0.05
"""Step of height with which the time of the descent is summed up."""


def rover_landing_remaining(pos_rel_ned_m: Vec3, config: RoverLandingConfig) -> Remaining:
    """Rest of a landing on the rover: the approach, and the descent that slows down with the height.

    Args:
        pos_rel_ned_m: (3,) position of the vehicle minus that of the platform.
    """
    north_m, east_m, down_m = pos_rel_ned_m
    away_m, height_m = hypot(north_m, east_m), max(altitude_m(down_m), 0.0)
    descent_m = min(height_m, config.height_approach_m)
    control = config.platform_control
    braking_s = 1.0 / control.gain_near_1ps if away_m > 0.0 else 0.0
    approach_s = max(away_m / control.speed_max_mps + braking_s, (height_m - descent_m) / APPROACH_DOWN_MPS)
    return Remaining(approach_s + _descent_s(descent_m, config) + CONTACT_S + DISARM_S, away_m + height_m)


def _descent_s(height_m: float, config: RoverLandingConfig) -> float:
    """Time of the descent from a height."""
    steps = int(height_m / DESCENT_STEP_M) + 1
    step_m = height_m / steps
    heights_m = (step_m * (number + 0.5) for number in range(steps))
    return sum(
        step_m / min(max(GAIN_DESCENT_1PS * h, config.descent_min_mps), config.descent_max_mps) for h in heights_m
    )
