"""Land on the rover by the estimate of the relative pose. Source: spec §8, cases 1 to 3; thesis §4.4, Fig. 4.7.

Approach, descent, contact. The vehicle goes down only while the estimate is valid and fresh: out of sight for half a
second it holds its height, then it climbs and searches, and when it finds nothing it hovers.
"""

from math import exp

from jezero.frames import Vec3, add, altitude_m, scale, subtract
from jezero.schemas.actions import LandFeedback, LandPhase, LandResult
from jezero.schemas.commands import Phase
from jezero.schemas.estimate import Relative
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.config import RoverLandingConfig
from jezero.services.actions.land_on_spot.descent import Descent, Standing
from jezero.services.actions.land_on_spot.platform_control import Pad, PadControl, pad_at
from jezero.services.actions.land_on_spot.search import Search, towards
from jezero.services.actions.land_on_spot.tilt_contact_detector import standing
from jezero.services.actions.lifecycle.behaviour import Done, Move, Selection, VehicleState

STEP_MAX_S = 0.1
BOUNCE_M = 0.4
"""So high over the platform after contact, it was none."""
LOST = "TARGET_LOST"
STILL: Vec3 = (0.0, 0.0, 0.0)


class RoverLanding:
    """One landing on the rover.

    Args:
        selection: of the estimator's inputs for this landing.
    """

    def __init__(self, selection: Selection, settings: RoverLandingConfig, t_ns: int, state: VehicleState) -> None:
        self._tag_alone = not selection.use_uwb
        self._land = settings
        self._search_config = settings.search
        self._control = PadControl(settings.platform_control)
        self._descent = Descent(settings)
        self._standing = Standing(settings)
        self._phase: LandPhase = "approach"
        self._search: Search | None = None
        self._pad: Pad | None = None
        self._rough: Pad | None = None
        self._pos_believed_ned_m = selection.pos_rover_ned_m
        """Of the platform, in the world; from the goal, then from what was seen."""
        self._vel_believed_ned_mps = STILL
        self._why_unseen = ""
        self._start_ns = self._t_ns = self._seen_ns = self._wait_from_ns = t_ns
        self._contact_ns = 0
        self._yaw_rad = state.yaw_rad
        self._hold_ned_m = state.pos_uav_ned_m
        self._feet_ned_m = STILL
        """Their middle, from the point that the vehicle's position is of."""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        dt_s = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        seen = self._look(t_ns, dt_s, state)
        if state.landed and self._phase in ("descent", "contact"):
            return self._landed(state)
        if (t_ns - self._start_ns) / NS_PER_S > self._land.timeout_s:
            return Done("aborted", f"not landed after {self._land.timeout_s:g} s")
        if self._phase == "contact" and self._pad is not None:
            return self._press_down(t_ns, seen, self._pad, state)
        if seen is not None:
            return self._over_platform(t_ns, dt_s, seen, state)
        if self._rough is not None and self._phase == "approach":
            self._wait_from_ns = t_ns
            self._hold_ned_m = state.pos_uav_ned_m
            return self._keep_height_over(state, self._rough, dt_s)
        return self._unseen(t_ns, dt_s, state)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> LandResult:
        return LandResult(completed=completed, touchdown_ned_m=pos_uav_ned_m if completed else None)

    # -- what is known --

    def _look(self, t_ns: int, dt_s: float, state: VehicleState) -> Pad | None:
        """Take in the newest estimate; returns it when it is fit to descend by."""
        relative = state.relative
        self._lean(dt_s, state)
        if relative is None or not relative.valid:
            self._why_unseen = "the estimator is silent" if relative is None else relative.reason
            self._believe(dt_s, state)
            self._rough = None if relative is None else self._rough_pad(t_ns, relative)
            return None
        self._rough = None
        self._pad = pad = pad_at(t_ns, relative, self._feet_ned_m)
        self._pos_believed_ned_m = add(subtract(state.pos_uav_ned_m, pad.pos_ned_m), self._feet_ned_m)
        self._vel_believed_ned_mps = pad.vel_rover_ned_mps
        age_s = (t_ns - relative.fused_t_ns) / NS_PER_S
        if relative.fused_t_ns <= self._start_ns or age_s > self._land.coast_s:
            self._why_unseen = f"nothing of it measured for {age_s:.1f} s"
            return None
        self._seen_ns = t_ns
        self._hold_ned_m = state.pos_uav_ned_m
        return pad

    def _rough_pad(self, t_ns: int, relative: Relative) -> Pad | None:
        """An estimate that says where the rover is, but not well enough to go down by."""
        pad = pad_at(t_ns, relative, self._feet_ned_m)
        fresh = (t_ns - relative.fused_t_ns) / NS_PER_S < self._land.coast_s
        return pad if fresh and pad.std_m < self._land.std_rough_per_m * pad.error_m else None

    def _lean(self, dt_s: float, state: VehicleState) -> None:
        """A vehicle that leans against the wind puts its feet downwind of its centre of mass, and ends above them."""
        share = min(1.0, dt_s / self._land.tilt_time_constant_s)
        north_m, east_m, _ = self._feet_ned_m
        wanted_north_m, wanted_east_m = (self._land.feet_below_m * lean for lean in state.down_ned)
        self._feet_ned_m = (
            north_m + share * (wanted_north_m - north_m),
            east_m + share * (wanted_east_m - east_m),
            0.0,
        )

    def _believe(self, dt_s: float, state: VehicleState) -> None:
        """Where the rover must be without a valid estimate: what it says of itself, or on as it was seen driving.

        While it is searched for it slows down: what it did long ago tells ever less, and may have been wrong.
        """
        if state.rover is not None and state.rover.valid:
            self._pos_believed_ned_m = state.rover.pos_rover_ned_m
            self._vel_believed_ned_mps = state.rover.vel_rover_ned_mps
        elif self._pos_believed_ned_m is not None:
            if self._phase == "search":
                share = exp(-dt_s / self._search_config.drive_time_constant_s)
                self._vel_believed_ned_mps = scale(self._vel_believed_ned_mps, share)
            self._pos_believed_ned_m = add(self._pos_believed_ned_m, scale(self._vel_believed_ned_mps, dt_s))
        if self._pad is not None and self._pos_believed_ned_m is not None:
            pos_ned_m = add(subtract(state.pos_uav_ned_m, self._pos_believed_ned_m), self._feet_ned_m)
            vel_ned_mps = subtract(state.vel_uav_ned_mps, self._vel_believed_ned_mps)
            self._pad = Pad(pos_ned_m, vel_ned_mps, self._vel_believed_ned_mps, self._pad.yaw_rate_rover_rps)

    # -- in sight --

    def _over_platform(self, t_ns: int, dt_s: float, pad: Pad, state: VehicleState) -> Move | Done:
        if self._phase in ("hold", "search"):
            self._control.reset()
            self._phase = "approach"
        self._search = None
        if self._phase == "approach" and self._descent.may_begin(pad):
            self._phase = "descent"
        if self._phase == "approach" and pad.height_m < self._land.clear_m and pad.error_m > self._land.beside_m:
            return self._fly(state, (0.0, 0.0, -self._land.speed_up_mps), None)  # not into the rover's side
        if self._phase == "approach":
            return self._follow(state, pad, dt_s, self._approach_mps(pad))
        return self._go_down(t_ns, dt_s, pad, state)

    def _approach_mps(self, pad: Pad) -> float:
        """Down, on the way: to the height of the approach, but not so low that the tag gets out of view."""
        land = self._land
        in_view_m = min(land.view_per_m * pad.error_m, pad.height_m) if self._tag_alone else 0.0
        above_m = pad.height_m - max(land.height_approach_m, in_view_m)
        return min(max(land.gain_height_1ps * above_m, -land.speed_up_mps), land.speed_down_max_mps)

    def _go_down(self, t_ns: int, dt_s: float, pad: Pad, state: VehicleState) -> Move | Done:
        down_mps = self._descent.down_mps(t_ns, pad)
        if self._descent.touches(t_ns, pad, down_mps):
            self._phase = "contact"
            self._contact_ns = t_ns
            self._standing.reset()
            return self._press_down(t_ns, None, pad, state)
        return self._follow(state, pad, dt_s, down_mps)

    def _press_down(self, t_ns: int, seen: Pad | None, pad: Pad, state: VehicleState) -> Move | Done:
        """With the platform, and down, until the autopilot sees the ground, or the vehicle's own signs are sure."""
        land = self._land
        if self._standing.is_sure(t_ns, seen, state.height_m):
            return Done("succeeded", then="force_disarm")
        waited_s = (t_ns - self._contact_ns) / NS_PER_S
        if waited_s > land.contact_timeout_s:
            return Done("aborted", f"the autopilot doesn't see the ground {waited_s:.0f} s after contact")
        if pad.height_m > BOUNCE_M:
            self._phase = "descent"
        north_mps, east_mps, down_mps = pad.vel_rover_ned_mps
        return self._fly(state, (north_mps, east_mps, down_mps + land.push_mps), pad.acc_rover_ned_mps2)

    def _landed(self, state: VehicleState) -> Done:
        beside_m = 0.0 if self._pad is None else self._pad.error_m
        if beside_m > self._land.on_platform_m:
            return Done("aborted", f"touched down {beside_m:.2f} m from the middle of the platform", then="disarm")
        return standing(state)

    # -- out of sight --

    def _unseen(self, t_ns: int, dt_s: float, state: VehicleState) -> Move | Done:
        land, pad = self._land, self._pad
        unseen_s = (t_ns - self._seen_ns) / NS_PER_S
        was_seen = self._seen_ns > self._start_ns
        if self._phase == "descent" and pad is not None and pad.height_m < land.blind_m:
            return self._go_down(t_ns, dt_s, pad, state)
        if was_seen and pad is not None and self._phase != "search" and unseen_s < land.hold_s:
            self._phase = "hold"
            return self._keep_height_over(state, pad, dt_s)
        waited_s = (t_ns - self._wait_from_ns) / NS_PER_S
        if not was_seen and not self._tag_alone and waited_s < land.acquire_s:
            return self._wait(state)
        if self._pos_believed_ned_m is None:
            return Done("aborted", f"{LOST}: the rover can't be found: {self._why_unseen}")
        return self._look_for(t_ns, self._pos_believed_ned_m, state)

    def _wait(self, state: VehicleState) -> Move:
        return Move(Phase.LANDING, self._feedback(state), pos_ned_m=self._hold_ned_m, yaw_rad=self._yaw_rad)

    def _look_for(self, t_ns: int, believed_ned_m: Vec3, state: VehicleState) -> Move | Done:
        """Fly to where the rover is believed, then around, higher and wider."""
        north_m, east_m, down_m = subtract(state.pos_uav_ned_m, believed_ned_m)
        height_m = altitude_m(down_m)
        if self._search is None:
            self._phase = "search"
            low_m = self._land.height_approach_m
            self._search = Search(t_ns, max(low_m, height_m), self._search_config)
        search = self._search
        search.step(t_ns, (north_m, east_m), height_m)
        if search.over:
            tries = self._search_config.tries
            return Done("aborted", f"{LOST}: not found in {tries} rounds of search: {self._why_unseen}")
        to_north_m, to_east_m = search.offset_m
        offset_m = (to_north_m - north_m, to_east_m - east_m, height_m - search.height_m)
        rover_north_mps, rover_east_mps, _ = self._vel_believed_ned_mps
        north_mps, east_mps, down_mps = towards(offset_m, self._search_config.speed_mps)
        low = state.height_m is not None and state.height_m < self._land.height_approach_m
        down_mps = min(down_mps, 0.0 if low else self._search_config.speed_down_max_mps)
        return self._fly(state, (rover_north_mps + north_mps, rover_east_mps + east_mps, down_mps), None)

    # -- out --

    def _follow(self, state: VehicleState, pad: Pad, dt_s: float, down_mps: float) -> Move:
        (north_mps, east_mps), acc_mps2 = self._control.command(dt_s, pad)
        return self._fly(state, (north_mps, east_mps, pad.vel_rover_ned_mps[2] + down_mps), acc_mps2)

    def _keep_height_over(self, state: VehicleState, pad: Pad, dt_s: float) -> Move:
        """As far as the rover is known: by an estimate that isn't valid the vehicle doesn't move vertically."""
        (north_mps, east_mps), acc_mps2 = self._control.command(dt_s, pad)
        return self._fly(state, (north_mps, east_mps, 0.0), acc_mps2)

    def _fly(self, state: VehicleState, vel_ned_mps: Vec3, acc_mps2: tuple[float, float] | None) -> Move:
        acc_ned_mps2 = None if acc_mps2 is None else (*acc_mps2, 0.0)
        feedback = self._feedback(state)
        return Move(Phase.LANDING, feedback, vel_ned_mps=vel_ned_mps, acc_ned_mps2=acc_ned_mps2, yaw_rad=self._yaw_rad)

    def _feedback(self, state: VehicleState) -> LandFeedback:
        pos_rel_ned_m = None if self._pad is None else self._pad.pos_ned_m
        return LandFeedback(pos_uav_ned_m=state.pos_uav_ned_m, pos_rel_ned_m=pos_rel_ned_m, phase=self._phase)
