"""The way home: up to a safe height, straight to above the place, down, and a landing there.

When the landing fails while the vehicle still flies, or the way would leave the fence, it goes on to the next place.
"""

from collections.abc import Sequence
from math import dist, hypot

from msgspec.structs import replace

from jezero.fence_geometry import way_refusal
from jezero.frames import Vec3, add, altitude_m, horizontal, subtract, z_ned_m
from jezero.schemas.commands import Phase
from jezero.schemas.goals import LandFeedback, ReturnFeedback, ReturnHomeGoal, ReturnPhase, ReturnResult
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.plain_landing import PlainLanding
from jezero.services.actions.land_on_spot.remaining import plain_descent_remaining, rover_landing_remaining
from jezero.services.actions.land_on_spot.rover_landing import RoverLanding
from jezero.services.actions.motion.behaviour import Done, Move, Remaining, Selection, VehicleState
from jezero.services.actions.motion.straight_path import StraightPath
from jezero.services.actions.return_home.config import ReturnHomeConfig
from jezero.services.actions.return_home.places import Place, ground_places, here, rover_place

ROVER_MOVED_M = 5.0
"""A rover that is farther than this from the end of the way has driven on: the vehicle follows it."""
ROVER_JUMPED_M = 10.0
"""If the rover's position changes by this much at once, the earlier one was wrong: the way begins anew."""
SEARCH_TRIES = 1
"""Rounds of search for a rover that is out of sight; the battery must also last to the next place."""


class ReturnHome:
    """One return.

    Args:
        takeoff_ned_m: where the vehicle took off; None when nobody knows.
        selection: of the estimator's inputs.
    """

    def __init__(
        self,
        goal: ReturnHomeGoal,
        takeoff_ned_m: Vec3 | None,
        selection: Selection,
        settings: ReturnHomeConfig,
        config: ActionsConfig,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._settings = settings
        self._config = config
        self._selection = selection
        self._takeoff_ned_m = takeoff_ned_m
        self._speed_mps = goal.speed_mps or settings.speed_mps
        self._safe_height_m = settings.safe_height_m if goal.safe_height_m is None else goal.safe_height_m
        self._rally_points_ned_m = [
            point
            for point in (*settings.rally_points_ned_m, *goal.rally_points_ned_m)
            if hypot(*point) <= config.vehicle.limits.distance_max_m
        ]
        self._failures: list[str] = []
        self._rover_failed = False
        self._places: list[Place] = []
        """Places that are tried after the present one."""
        self._paths: list[StraightPath] = []
        """Paths to above the place that are not flown yet."""
        self._landing: RoverLanding | PlainLanding | None = None
        rover = self._rover_place(state)
        if isinstance(rover, Place):
            self._begin_to_rover(t_ns, state, rover)
        else:
            self._begin_on_ground(t_ns, state, f"the rover can't be found: {rover}")

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if self._landing is not None:
            return self._land(t_ns, state, self._landing)
        self._update_rover(t_ns, state)
        if not self._paths:
            self._landing = self._start_landing(t_ns, state)
            return self._land(t_ns, state, self._landing)
        path = self._paths[0]
        path.step(t_ns, state)
        if problem := path.stuck(t_ns):
            return self._go_on_elsewhere(t_ns, state, problem)
        if path.reached:
            del self._paths[0]
            if self._paths:
                self._paths[0].wait(t_ns, state)
            elif self._place.kind == "rover" and self._away_m(path.end_ned_m) > ROVER_MOVED_M:
                self._begin_to_rover(t_ns, state, self._place)
        climbs = path.end_ned_m[2] < path.pos_ned_m[2]
        feedback = self._feedback(state, "climb" if climbs else "way")
        return Move(Phase.LANDING, feedback, path.pos_ned_m, path.vel_ned_mps, path.acc_ned_mps2, path.yaw_rad)

    def pause_refusal(self, state: VehicleState) -> str:
        """Reason why the landing at the end can't be paused now, or ""."""
        return "" if self._landing is None else self._landing.pause_refusal(state)

    def hold(self, t_ns: int, dt_s: float, state: VehicleState) -> Move | Done | None:
        """Hover as the landing does; None on the way, whose path stands still."""
        move = None if self._landing is None else self._landing.hold(t_ns, dt_s, state)
        return self._with_feedback(move, state) if isinstance(move, Move) else move

    def remaining(self, state: VehicleState) -> Remaining | None:
        """Rest of the way and of the landing; the search for a rover is not part of it."""
        if self._landing is not None:
            return self._landing.remaining(state)
        height_m = altitude_m(self._end_ned_m(state)[2] - self._place.pos_ned_m[2])
        land = self._config.land_on_spot
        if self._place.kind == "rover":
            rest = rover_landing_remaining((0.0, 0.0, z_ned_m(height_m)), land.rover)
        else:
            rest = plain_descent_remaining(height_m, land.plain)
        return sum((path.remaining() for path in self._paths), rest)

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The corners of the way, and the place."""
        return state.pos_uav_ned_m, *(path.end_ned_m for path in self._paths), self._place.pos_ned_m

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> ReturnResult:
        return ReturnResult(
            completed=completed,
            touchdown_ned_m=pos_uav_ned_m if completed else None,
            place=self._place.kind,
            reason=self._place.reason,
        )

    # -- places --

    def _begin(self, t_ns: int, state: VehicleState, place: Place) -> None:
        """Turn to a place."""
        self._place = place
        self._landing = None
        start_ned_m, self._paths = state.pos_uav_ned_m, []
        for end_ned_m in self._corners(start_ned_m, place.pos_ned_m):
            self._paths.append(
                StraightPath(
                    t_ns,
                    start_ned_m,
                    end_ned_m,
                    speed_mps=self._speed_mps,
                    config=self._config.move,
                    yaw_start_rad=state.yaw_rad,
                )
            )
            start_ned_m = end_ned_m

    def _begin_on_ground(self, t_ns: int, state: VehicleState, because: str) -> None:
        """Turn to the first of the places on the ground that the fence lets the vehicle reach."""
        self._places = ground_places(because, state.pos_uav_ned_m, self._takeoff_ned_m, self._rally_points_ned_m)
        self._begin_next(t_ns, state)

    def _begin_to_rover(self, t_ns: int, state: VehicleState, rover: Place) -> None:
        """Turn to the rover, or where that way leaves the fence to a place on the ground."""
        self._begin(t_ns, state, rover)
        if refusal := self._fence_refusal(state):
            self._rover_failed = True
            self._begin_on_ground(t_ns, state, f"the rover is left out: {refusal}")

    def _begin_next(self, t_ns: int, state: VehicleState) -> None:
        """Turn to the next place whose way stays inside the fence; without one, land here."""
        left_out = ""
        while self._places:
            place = self._places.pop(0)
            self._begin(t_ns, state, Place(place.kind, place.pos_ned_m, place.reason + left_out))
            refusal = self._fence_refusal(state)
            if not refusal or place.kind == "here":
                return
            left_out += f"; the {place.words} is left out: {refusal}"
        self._begin(t_ns, state, here(place.reason + left_out, state.pos_uav_ned_m))

    def _fence_refusal(self, state: VehicleState) -> str:
        """Reason why the way to the present place leaves the fence, or ""."""
        if state.fence is None:
            return ""
        way_ned_m = [add(point_ned_m, state.shift_ned_m) for point_ned_m in self.path(state)]
        return way_refusal(state.fence, way_ned_m, from_ground=False, to_ground=True)

    def _corners(self, start_ned_m: Vec3, place_ned_m: Vec3) -> Sequence[Vec3]:
        """The end of the climb, the point above the place, and the end of the descent, where the landing begins."""
        north_m, east_m, z_place_ned_m = place_ned_m
        x, y, z = start_ned_m
        limit_m = self._config.vehicle.limits.altitude_max_m
        z_arrival_ned_m = max(z_place_ned_m + z_ned_m(self._settings.height_arrival_m), z_ned_m(limit_m))
        if hypot(north_m - x, east_m - y) < self._settings.near_m:
            return [(north_m, east_m, z_arrival_ned_m)] if z < z_arrival_ned_m else []
        z_way_ned_m = min(z, z_arrival_ned_m, z_ned_m(min(self._safe_height_m, limit_m)))
        corners = [(x, y, z_way_ned_m), (north_m, east_m, z_way_ned_m), (north_m, east_m, z_arrival_ned_m)]
        before = [start_ned_m, *corners]
        reached_m = self._config.move.reached_m
        return [end for start, end in zip(before, corners, strict=False) if _far(start, end) > reached_m]

    def _rover_place(self, state: VehicleState) -> Place | str:
        return rover_place(state.rover, self._settings.rover_std_max_m, self._config.vehicle.limits)

    def _update_rover(self, t_ns: int, state: VehicleState) -> None:
        """Follow what is known of the rover: it may drive on, and come into sight on the way to another place."""
        rover = state.rover
        if rover is None or self._rover_failed:
            return
        if self._place.kind == "rover":
            known = self._rover_place(state)
            if not isinstance(known, Place):
                return
            if dist(known.pos_ned_m, self._place.pos_ned_m) > ROVER_JUMPED_M:
                self._begin_to_rover(t_ns, state, known)
            else:
                self._place = known
        elif rover.valid:
            sighted = Place("rover", rover.pos_rover_ned_m, "the rover came into sight on the way")
            self._begin_to_rover(t_ns, state, sighted)

    def _go_on_elsewhere(self, t_ns: int, state: VehicleState, problem: str) -> Move | Done:
        """Turn to the next place after a failure, or end the goal where there is none."""
        self._failures.append(f"{self._place.words}: {problem}")
        if self._place.kind == "rover":
            self._rover_failed = True
            self._begin_on_ground(t_ns, state, f"no landing on the rover: {problem}")
        elif self._places:
            self._begin_next(t_ns, state)
        else:
            return Done("aborted", f"{'; '.join(self._failures)}: land somewhere else by hand")
        return self.step(t_ns, state)

    def _away_m(self, point_ned_m: Vec3) -> float:
        """Horizontal distance of a point from the place."""
        return horizontal(subtract(point_ned_m, self._place.pos_ned_m))

    def _end_ned_m(self, state: VehicleState) -> Vec3:
        """Where the landing begins."""
        return self._paths[-1].end_ned_m if self._paths else state.pos_uav_ned_m

    # -- the landing --

    def _start_landing(self, t_ns: int, state: VehicleState) -> RoverLanding | PlainLanding:
        """Start the landing; neither is ended by the wind, because a hover would only empty the battery."""
        land = self._config.land_on_spot
        if self._place.kind != "rover":
            return PlainLanding(self._place.pos_ned_m, land, self._config, True, t_ns, state)
        search = replace(land.rover.search, tries=SEARCH_TRIES)
        land = replace(land, rover=replace(land.rover, search=search))
        selection = replace(self._selection, pos_rover_ned_m=self._place.pos_ned_m)
        return RoverLanding(selection, land, self._config.vehicle, True, t_ns, state)

    def _land(self, t_ns: int, state: VehicleState, landing: RoverLanding | PlainLanding) -> Move | Done:
        move = landing.step(t_ns, state)
        if isinstance(move, Move):
            return self._with_feedback(move, state)
        if move.outcome == "aborted" and move.then == "hover" and not state.landed:
            return self._go_on_elsewhere(t_ns, state, move.reason)
        return move

    def _with_feedback(self, move: Move, state: VehicleState) -> Move:
        return replace(move, feedback=self._feedback(state, "landing", move.feedback))

    def _feedback(self, state: VehicleState, phase: ReturnPhase, landing: LandFeedback | None = None) -> ReturnFeedback:
        return ReturnFeedback(
            pos_uav_ned_m=state.pos_uav_ned_m,
            phase=phase,
            place=self._place.kind,
            place_ned_m=self._place.pos_ned_m,
            reason=self._place.reason,
            landing=landing,
        )


def _far(start_ned_m: Vec3, end_ned_m: Vec3) -> float:
    """Greatest difference on any axis."""
    return max(abs(difference) for difference in subtract(end_ned_m, start_ned_m))
