"""Landing on a spot by the vehicle's own position, without any sensor that finds the rover."""

from math import hypot

from jezero.base.detectors import is_tilted_by_contact
from jezero.base.frames import Vec3, altitude_m, subtract
from jezero.schemas.commands import Phase
from jezero.schemas.goals import LandFeedback, LandPhase, LandResult
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.config import PlainLandingConfig
from jezero.services.actions.land_on_spot.contact import (
    CLIMB_MPS,
    DISARM_S,
    ContactWatcher,
    GoArounds,
    OnSurface,
    feet_from_uav_ned_m,
    landing_outcome,
)
from jezero.services.actions.land_on_spot.landing_watch import WindLimit
from jezero.services.actions.land_on_spot.paused_hover import PausedHover
from jezero.services.actions.motion.behaviour import Done, Move, Remaining, VehicleState
from jezero.services.actions.motion.straight_path import LEAD_M, StraightPath

SPEED_APPROACH_MPS = 2.0
SLOW_MARGIN_M = 1.0
"""Added to the slow height when only the vehicle's own altitude is known."""
GAIN_HORIZONTAL_1PS, SPEED_HORIZONTAL_MAX_MPS = 0.8, 0.5
"""Horizontal speed per metre of error during the descent, and its limit."""
CONTACT_MPS, CONTACT_S = 0.1, 0.5
"""A slower descent than this for this duration counts as contact."""
CONTACT_TIMEOUT_S = 15.0
"""The goal is aborted when the autopilot doesn't detect the ground within this time."""
DESCENT_TIMEOUT_S = 600.0
"""The goal is aborted when there is no contact within this time."""
SPEED_LEAVE_MPS, LEAVE_S = 1.0, 1.5
"""Speed and duration of the climb when the vehicle tilts over the obstacle that it touches."""
CONTACT_MARGIN_M = 0.01
"""A range this much above the least possible one counts as contact."""
SLIDE_MAX_M = 0.3
"""A vehicle that slides farther than this over the ground goes around."""
PUSH_HEIGHT_MAX_M = 0.3
"""A higher vehicle whose descent has stopped is in a gust."""


class PlainLanding:
    """Approach at height, descent over the spot, contact until the autopilot detects the ground.

    A vehicle that tilts over an edge climbs again, and the goal is aborted. Source: spec §8, case 4.
    """

    def __init__(
        self,
        spot_ned_m: Vec3,
        config: ActionsConfig,
        force: bool,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        settings, move, altimeter = config.land_on_spot, config.move, config.vehicle.altimeter
        self._settings = settings.plain
        self._wind_limit = WindLimit(settings.wind_max_mps, force)
        self._go_arounds = GoArounds(settings.go_arounds_max)
        self._contact = ContactWatcher(SLIDE_MAX_M, config.vehicle.planet)
        self._airframe = config.vehicle.airframe
        self._contact_ned_m = (spot_ned_m[0], spot_ned_m[1])
        """Middle of the feet at the first contact."""
        self._contact_range_m = max(altimeter.range_min_m, config.vehicle.height_altimeter_m) + CONTACT_MARGIN_M
        self._phase: LandPhase = "approach"
        self._spot_ned_m = spot_ned_m
        self._speed_down_mps = settings.plain.speed_high_mps
        self._phase_since_ns = t_ns
        self._still_since_ns: int | None = None
        self._tilt_contact = TiltContactDetector()
        self._leaves_ns: int | None = None
        self._paused = PausedHover(settings.plain.approach_height_min_m)
        x, y, z = state.pos_uav_ned_m
        height_m = altitude_m(z) if state.height_m is None else state.height_m
        up_m = max(0.0, settings.plain.approach_height_min_m - height_m)
        start_ned_m = (x, y, z - up_m)
        self._path = StraightPath(
            t_ns,
            start_ned_m,
            (spot_ned_m[0], spot_ned_m[1], z - up_m),
            speed_mps=SPEED_APPROACH_MPS,
            config=move,
            yaw_start_rad=state.yaw_rad,
        )
        self._lift: StraightPath | None = None
        """Climb to the height of the approach, if the vehicle is lower."""
        if up_m > move.reached_m:
            self._lift = StraightPath(
                t_ns,
                (x, y, z),
                start_ned_m,
                speed_mps=move.speed_up_mps,
                lead_max_m=LEAD_M,
                config=move,
                yaw_start_rad=state.yaw_rad,
            )

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if self._phase == "approach":
            return self._approach(t_ns, state)
        if self._leaves_ns is not None:
            return self._leave(t_ns, self._leaves_ns, state)
        if self._go_arounds.climbing:
            return self._go_around(t_ns, state)
        return self._descend(t_ns, state)

    @property
    def approaches(self) -> bool:
        """Whether the vehicle is still on its way to the spot."""
        return self._phase == "approach"

    def pause_refusal(self, state: VehicleState) -> str:
        """Reason why the landing can't be paused now, or ""."""
        if self._phase == "contact" or self._leaves_ns is not None:
            return "the vehicle touches the ground: the landing ends in a moment, or goes around"
        return ""

    def hold(self, t_ns: int, dt_s: float, state: VehicleState) -> Move | None:
        """Hover in the descent, where a low vehicle climbs first; None in the approach, whose path stands still."""
        if self._phase == "approach":
            return None
        if self._phase_since_ns != t_ns:
            self._enter("descent", t_ns)  # what was measured of a contact so far counts no more
            self._paused = PausedHover(self._settings.approach_height_min_m)
        return self._move(state, self._paused.velocity(dt_s, state.pos_uav_ned_m, state.height_m))

    def _descend(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Descend and press down until the autopilot detects the ground."""
        if state.landed:
            return landing_outcome(state)
        if problem := self._advance(t_ns, state):
            return Done("aborted", problem)
        push = self._phase == "contact"
        vel_ned_mps = (0.0, 0.0, self._settings.push_mps) if push else self._descent_velocity(state)
        if self._tilt_contact.update(t_ns, state, vel_ned_mps[2]):
            self._leaves_ns = t_ns
            return self._leave(t_ns, t_ns, state)
        return self._press_down(t_ns, vel_ned_mps, state) if push else self._move(state, vel_ned_mps)

    def _press_down(self, t_ns: int, vel_ned_mps: Vec3, state: VehicleState) -> Move | Done:
        """Push down, unless the vehicle slides over the ground."""
        (north_m, east_m), (begin_north_m, begin_east_m) = self._feet_ned_m(state), self._contact_ned_m
        surface = OnSurface((north_m - begin_north_m, east_m - begin_east_m))
        if problem := self._contact.update(t_ns, surface, state):
            self._go_arounds.begin(t_ns, problem, state)
            return self._go_around(t_ns, state)
        low = state.height_m is None or state.height_m < PUSH_HEIGHT_MAX_M
        acc_ned_mps2 = self._contact.push_acc_ned_mps2(state.vel_uav_ned_mps[2]) if low else None
        return self._move(state, vel_ned_mps, acc_ned_mps2)

    def _feet_ned_m(self, state: VehicleState) -> tuple[float, float]:
        """(2,) north and east of the middle of the feet."""
        (north_m, east_m, _), (feet_north_m, feet_east_m) = (
            state.pos_uav_ned_m,
            feet_from_uav_ned_m(state, self._airframe),
        )
        return north_m + feet_north_m, east_m + feet_east_m

    def _go_around(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Climb, then descend again, or end the landing."""
        if self._go_arounds.is_high(t_ns, state.height_m):
            if reason := self._go_arounds.abort_reason(state):
                return Done("aborted", reason)
            self._enter("descent", t_ns)
        return self._move(state, (0.0, 0.0, -CLIMB_MPS))

    def _advance(self, t_ns: int, state: VehicleState) -> str:
        """Begin the next phase when it is time for it; returns the reason why the landing is aborted, or ""."""
        since_s = (t_ns - self._phase_since_ns) / NS_PER_S
        if self._phase == "descent":
            if since_s > DESCENT_TIMEOUT_S:
                return f"no contact after {since_s:.0f} s of descent"
            if self._has_contact(t_ns, state):
                self._enter("contact", t_ns)
                self._contact.begin(t_ns, self._tilt_contact.free_down_ned)
                self._contact_ned_m = self._feet_ned_m(state)
        elif since_s > CONTACT_TIMEOUT_S:
            return f"the autopilot doesn't detect the ground {since_s:.0f} s after contact"
        elif state.vel_uav_ned_mps[2] > 0.5 * self._settings.push_mps:
            self._enter("descent", t_ns)
        return ""

    def _leave(self, t_ns: int, since_ns: int, state: VehicleState) -> Move | Done:
        """Climb, then end the goal: another place to land is the client's choice."""
        if t_ns - since_ns > LEAVE_S * NS_PER_S:
            return Done("aborted", "the vehicle tilted over an edge or a rock at the landing spot: land somewhere else")
        return self._move(state, (0.0, 0.0, -SPEED_LEAVE_MPS))

    def remaining(self, state: VehicleState) -> Remaining:
        height_m = altitude_m(state.pos_uav_ned_m[2]) if state.height_m is None else state.height_m
        if self._phase != "approach":
            return plain_descent_remaining(max(height_m, 0.0), self._settings)
        way = self._path.remaining() if self._lift is None else self._lift.remaining() + self._path.remaining()
        up_m = 0.0 if self._lift is None else self._lift.left_m
        return way + plain_descent_remaining(max(height_m, 0.0) + up_m, self._settings)

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The way to the place above the spot, and down to the height of the world's origin."""
        north_m, east_m, _ = self._spot_ned_m
        return state.pos_uav_ned_m, self._path.end_ned_m, (north_m, east_m, 0.0)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> LandResult:
        return LandResult(completed=completed, touchdown_ned_m=pos_uav_ned_m if completed else None)

    def _approach(self, t_ns: int, state: VehicleState) -> Move | Done:
        self._wind_limit.update(t_ns, state)
        if self._wind_limit.reason:
            return Done("aborted", self._wind_limit.reason)
        path = self._lift if self._lift is not None else self._path
        path.step(t_ns, state)
        if problem := path.stuck(t_ns):
            return Done("aborted", f"approach: {problem}")
        if path.reached and self._lift is not None:
            self._lift = None
            self._path.wait(t_ns, state)
        elif path.reached:
            self._enter("descent", t_ns)
        return path.move(Phase.LANDING, self._feedback(state))

    def _descent_velocity(self, state: VehicleState) -> Vec3:
        """Velocity towards the spot and down: slower near the ground, and never faster again."""
        slow_m = self._settings.slow_height_m
        height_m = state.height_m
        if height_m is None:
            height_m, slow_m = altitude_m(state.pos_uav_ned_m[2]), slow_m + SLOW_MARGIN_M
        if height_m < slow_m:
            self._speed_down_mps = self._settings.speed_low_mps
        north = GAIN_HORIZONTAL_1PS * (self._spot_ned_m[0] - state.pos_uav_ned_m[0])
        east = GAIN_HORIZONTAL_1PS * (self._spot_ned_m[1] - state.pos_uav_ned_m[1])
        shrink = min(1.0, SPEED_HORIZONTAL_MAX_MPS / max(hypot(north, east), 1e-9))
        return (north * shrink, east * shrink, self._speed_down_mps)

    def _has_contact(self, t_ns: int, state: VehicleState) -> bool:
        """Whether the range is shorter than the altimeter can measure in the air, or the descent has stopped."""
        if state.height_m is not None and state.height_m < self._contact_range_m:
            return True
        if state.vel_uav_ned_mps[2] > CONTACT_MPS:
            self._still_since_ns = None
        elif self._still_since_ns is None:
            self._still_since_ns = t_ns
        started_s = (t_ns - self._phase_since_ns) / NS_PER_S
        return (
            started_s > 2.0 * CONTACT_S
            and self._still_since_ns is not None
            and t_ns - self._still_since_ns >= CONTACT_S * NS_PER_S
        )

    def _enter(self, phase: LandPhase, t_ns: int) -> None:
        self._phase = phase
        self._phase_since_ns = t_ns
        self._still_since_ns = None

    def _move(self, state: VehicleState, vel_ned_mps: Vec3, acc_ned_mps2: Vec3 | None = None) -> Move:
        feedback, yaw_rad = self._feedback(state), self._path.yaw_rad
        return Move(Phase.LANDING, feedback, vel_ned_mps=vel_ned_mps, acc_ned_mps2=acc_ned_mps2, yaw_rad=yaw_rad)

    def _feedback(self, state: VehicleState) -> LandFeedback:
        spot_x, spot_y, _ = self._spot_ned_m
        z_spot = state.pos_uav_ned_m[2] + state.height_m if state.height_m is not None else 0.0
        return LandFeedback(
            pos_uav_ned_m=state.pos_uav_ned_m,
            pos_rel_ned_m=subtract(state.pos_uav_ned_m, (spot_x, spot_y, z_spot)),
            phase="go_around" if self._go_arounds.climbing else self._phase,
        )


STALLED_SPEED_RATIO = 0.5
"""A vehicle is stalled while it descends at less than this ratio of the commanded speed."""
RISING_MPS = 0.2
"""A vehicle that rises faster than this, as at the end of a go-around, touches nothing."""
STALLED_MIN_S = 0.2
"""A shorter stall may be a gust, and doesn't count as contact."""
CONTACT_MEMORY_S = 0.2
"""Contact lasts for this time after the stall, because a vehicle that falls over an edge descends again."""
TILT_FILTER_TIME_CONSTANT_S = 0.5
STEP_MAX_S = 0.1


class TiltContactDetector:
    """Detects that a descending vehicle tilts over something, by comparing its tilt with that in free flight."""

    def __init__(self) -> None:
        self._free_tilt_ned: tuple[float, float] | None = None
        self._t_ns = self._moved_ns = 0
        self._contact_ns: int | None = None
        self._tilted = False

    @property
    def free_down_ned(self) -> tuple[float, float]:
        """(2,) the tilt in free flight, see `VehicleState.down_ned`."""
        return self._free_tilt_ned or (0.0, 0.0)

    def update(self, t_ns: int, state: VehicleState, down_commanded_mps: float) -> bool:
        """Add the state of a vehicle that is commanded to descend; returns whether it tilts over an obstacle."""
        passed_s = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        down_mps = state.vel_uav_ned_mps[2]
        moves = down_mps >= STALLED_SPEED_RATIO * down_commanded_mps or down_mps < -RISING_MPS
        if self._free_tilt_ned is None or moves:
            self._moved_ns, self._tilted = t_ns, False
        if self._free_tilt_ned is not None and is_tilted_by_contact(state.down_ned, self._free_tilt_ned):
            self._tilted = True
        if t_ns - self._moved_ns >= STALLED_MIN_S * NS_PER_S:
            self._contact_ns = t_ns
        if self._contact_ns is not None and t_ns - self._contact_ns <= CONTACT_MEMORY_S * NS_PER_S:
            return self._tilted
        self._contact_ns = None
        north, east = self._free_tilt_ned or state.down_ned
        weight = passed_s / TILT_FILTER_TIME_CONSTANT_S
        self._free_tilt_ned = (
            north + weight * (state.down_ned[0] - north),
            east + weight * (state.down_ned[1] - east),
        )
        return False


def plain_descent_remaining(height_m: float, config: PlainLandingConfig) -> Remaining:
    """Rest of the descent onto a spot.

    Args:
        height_m: over ground.
    """
    slow_m = min(height_m, config.slow_height_m)
    down_s = (height_m - slow_m) / config.speed_high_mps + slow_m / config.speed_low_mps
    return Remaining(down_s + DISARM_S, height_m)
