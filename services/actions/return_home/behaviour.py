"""The action `return_home`: up to a safe height, straight to above the place, down, and a landing there.

Twice a second the return decides again to which place the vehicle flies. When the landing fails while the vehicle still
flies, it goes on to the next place.
"""

from functools import partial
from itertools import pairwise
from math import hypot

from msgspec.structs import replace

from jezero.base.frames import Vec3, distance, dot, horizontal, norm, subtract
from jezero.schemas.commands import Phase
from jezero.schemas.goals import LandFeedback, ReturnFeedback, ReturnHomeGoal, ReturnPhase, ReturnResult
from jezero.schemas.state import Status
from jezero.schemas.topics import ALTIMETER, RELATIVE, ROVER_ESTIMATE
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.plain_landing import PlainLanding
from jezero.services.actions.land_on_spot.rover_landing import RoverLanding
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Refusal, Remaining, Selection, VehicleState
from jezero.services.actions.motion.limits import speed_refusal
from jezero.services.actions.motion.straight_path import StraightPath
from jezero.services.actions.return_home.decision import Decision, Place, ground_places, rover_place

DECISION_PERIOD_NS = NS_PER_S // 2
ROVER_MOVED_M = 5.0
"""A rover that is farther than this from the end of the way has driven on: the vehicle follows it."""
ROVER_DRIVES_MPS, ROVER_NEAR_M = 0.3, 10.0
"""The landing begins as soon as a rover that drives is in sight and nearer than this: it follows the rover."""
ROVER_JUMPED_M = 10.0
"""If the rover's position changes by this much at once, the earlier one was wrong: the way begins anew."""
ROVER_KEPT_NS = 3 * NS_PER_S
"""A rover that nobody knows of for a shorter time is still where it was."""
REDIRECT_M = 1.0
"""The way is led to another end when the end has moved by more than this."""
SEARCH_TRIES = 1
"""Rounds of search for a rover that is out of sight; the battery must also last to the next place."""
SEARCH_MARGIN_S = 5.0
"""The search ends when the way to the next place would not leave the reserve after this time."""


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
        config: ActionsConfig,
        t_ns: int,
        state: VehicleState,
    ) -> None:
        self._config = config
        self._selection = selection
        self._decision = Decision(goal, config, t_ns, state)
        rally_points_ned_m = [
            point
            for point in (*config.return_home.rally_points_ned_m, *goal.rally_points_ned_m)
            if hypot(*point) <= config.vehicle.limits.distance_max_m
        ]
        self._ground = ground_places(state.pos_uav_ned_m, takeoff_ned_m, rally_points_ned_m)
        self._failures: dict[Place, str] = {}
        """Why the landing failed at each place that was tried."""
        self._rover: Place | Refusal = rover_place(
            state.rover, config.return_home.rover_std_max_m, config.vehicle.limits
        )
        self._rover_ns = t_ns
        """Time at which the rover was last known."""
        self._paths: list[StraightPath] = []
        """Paths to above the place that are not flown yet."""
        self._landing: RoverLanding | PlainLanding | None = None
        self._decided_ns = t_ns
        self._way = self._decision.best(t_ns, state, self._places(), None)
        self._fly(t_ns, state)

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        self._update_rover(t_ns, state)
        if self._landing is not None:
            return self._land(t_ns, state, self._landing)
        if t_ns - self._decided_ns >= DECISION_PERIOD_NS:
            self._decide(t_ns, state)
        if not self._paths or self._is_over_driving_rover(state):
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
            elif self._way.place.kind == "rover" and self._away_m(path.end_ned_m) > ROVER_MOVED_M:
                self._way = self._decision.best(t_ns, state, self._places(), self._way)
                self._fly(t_ns, state)
        climbs = path.end_ned_m[2] < path.pos_ned_m[2] - self._config.move.reached_m
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
        cost = self._decision.cost(state, self._way.place, [path.end_ned_m for path in self._paths]) or self._way.cost
        length_m = sum(distance(begin, end) for begin, end in pairwise(self.path(state)))
        return Remaining(cost.time_s, length_m, cost.hover_s)

    def path(self, state: VehicleState) -> tuple[Vec3, ...]:
        """The corners of the way, and the place."""
        return state.pos_uav_ned_m, *(path.end_ned_m for path in self._paths), self._place_ned_m

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> ReturnResult:
        return ReturnResult(
            completed=completed,
            touchdown_ned_m=pos_uav_ned_m if completed else None,
            place=self._way.place.kind,
            reason=self._way.reason,
        )

    # -- the decision --

    def _places(self) -> list[Place | Refusal]:
        """All places, best first; in place of one that can't be flown to, the reason."""
        rover = self._rover
        if isinstance(rover, Refusal):
            rover = Refusal(f"the rover can't be found: {rover.reason}")
        return [place if isinstance(place, Refusal) else self._judged(place) for place in (rover, *self._ground)]

    def _judged(self, place: Place) -> Place | Refusal:
        """The place, or why the landing there has failed."""
        where = "on the rover" if place.kind == "rover" else f"at the {place.words}"
        problems = (problem for failed, problem in self._failures.items() if failed.is_same(place))
        return next((Refusal(f"no landing {where}: {problem}") for problem in problems), place)

    def _decide(self, t_ns: int, state: VehicleState) -> None:
        """Decide again, and turn to another place, or to where the rover will be."""
        self._decided_ns = t_ns
        before, self._way = self._way, self._decision.best(t_ns, state, self._places(), self._way)
        if not self._way.place.is_same(before.place):
            self._fly(t_ns, state)
        elif self._way.place.kind == "rover" and self._paths:
            self._lead(t_ns, state)

    def _fly(self, t_ns: int, state: VehicleState) -> None:
        """Begin the present way from where the vehicle is."""
        self._landing = None
        start_ned_m, self._paths = state.pos_uav_ned_m, []
        for end_ned_m in self._way.corners_ned_m:
            self._paths.append(self._path(t_ns, start_ned_m, end_ned_m, state.yaw_rad))
            start_ned_m = end_ned_m

    def _path(self, t_ns: int, start_ned_m: Vec3, end_ned_m: Vec3, yaw_rad: float) -> StraightPath:
        speed_mps, move = self._decision.speed_mps, self._config.move
        return StraightPath(t_ns, start_ned_m, end_ned_m, speed_mps=speed_mps, config=move, yaw_start_rad=yaw_rad)

    def _lead(self, t_ns: int, state: VehicleState) -> None:
        """Lead what is left of the way to where a driving rover will be; the vehicle keeps its speed."""
        count = min(len(self._paths), len(self._way.corners_ned_m))
        ends_ned_m = [path.end_ned_m for path in self._paths]
        ends_ned_m[len(ends_ned_m) - count :] = self._way.corners_ned_m[len(self._way.corners_ned_m) - count :]
        if distance(ends_ned_m[-1], self._paths[-1].end_ned_m) < REDIRECT_M:
            return
        path = self._paths[0]
        turned = dot(subtract(ends_ned_m[0], state.pos_uav_ned_m), subtract(path.end_ned_m, state.pos_uav_ned_m)) < 0.0
        if turned:
            self._fly(t_ns, state)
            return
        if distance(ends_ned_m[0], path.end_ned_m) > 0.0:
            path.redirect(ends_ned_m[0])
        starts_and_ends = pairwise(ends_ned_m)
        self._paths[1:] = [self._path(t_ns, begin, end, state.yaw_rad) for begin, end in starts_and_ends]

    def _update_rover(self, t_ns: int, state: VehicleState) -> None:
        """Follow what is known of the rover: it may drive on, and come into sight on the way to another place."""
        known = rover_place(state.rover, self._config.return_home.rover_std_max_m, self._config.vehicle.limits)
        before = self._rover
        if isinstance(known, Place):
            self._rover, self._rover_ns = known, t_ns
        elif t_ns - self._rover_ns > ROVER_KEPT_NS:
            self._rover = known
        if self._landing is not None or not (isinstance(before, Place) and isinstance(known, Place)):
            return
        if distance(known.pos_ned_m, before.pos_ned_m) > ROVER_JUMPED_M:
            self._decide(t_ns, state)
            self._fly(t_ns, state)

    def _go_on_elsewhere(self, t_ns: int, state: VehicleState, problem: str) -> Move | Done:
        """Turn to the next place after a failure, or end the goal where there is none."""
        self._failures[self._way.place] = problem
        if self._way.place.kind == "here":
            texts = [f"{place.words}: {problem}" for place, problem in self._failures.items()]
            return Done("aborted", f"{'; '.join(texts)}: land somewhere else by hand")
        self._decided_ns = t_ns
        self._way = self._decision.best(t_ns, state, self._places(), None)
        self._fly(t_ns, state)
        return self.step(t_ns, state)

    @property
    def _place_ned_m(self) -> Vec3:
        """The place, as it is known now; a rover drives."""
        is_rover = self._way.place.kind == "rover" and isinstance(self._rover, Place)
        return self._rover.pos_ned_m if is_rover and isinstance(self._rover, Place) else self._way.place.pos_ned_m

    def _away_m(self, point_ned_m: Vec3) -> float:
        """Horizontal distance of a point from the place."""
        return horizontal(subtract(point_ned_m, self._place_ned_m))

    # -- the landing --

    def _is_over_driving_rover(self, state: VehicleState) -> bool:
        """Whether the landing follows a rover that is in sight better than a way to one point does."""
        rover = state.rover
        if self._way.place.kind != "rover" or rover is None or not rover.valid:
            return False
        return norm(rover.vel_rover_ned_mps) > ROVER_DRIVES_MPS and self._away_m(state.pos_uav_ned_m) < ROVER_NEAR_M

    def _start_landing(self, t_ns: int, state: VehicleState) -> RoverLanding | PlainLanding:
        """Start the landing; neither is ended by the wind, because a hover would only empty the battery."""
        if self._way.place.kind != "rover":
            return PlainLanding(self._place_ned_m, self._config, True, t_ns, state)
        land = self._config.land_on_spot
        search = replace(land.rover.search, tries=SEARCH_TRIES)
        land = replace(land, rover=replace(land.rover, search=search))
        selection = replace(self._selection, pos_rover_ned_m=self._place_ned_m)
        return RoverLanding(selection, land, self._config.vehicle, True, t_ns, state)

    def _land(self, t_ns: int, state: VehicleState, landing: RoverLanding | PlainLanding) -> Move | Done:
        move = landing.step(t_ns, state)
        if isinstance(move, Move):
            searches = isinstance(move.feedback, LandFeedback) and move.feedback.phase == "search"
            if searches and t_ns - self._decided_ns >= DECISION_PERIOD_NS:
                self._decided_ns = t_ns
                others = [place for place in self._places() if isinstance(place, Refusal) or place.kind != "rover"]
                if not self._lasts_for_others(t_ns, state, others):
                    return self._go_on_elsewhere(t_ns, state, "the battery does not last for a longer search")
            return self._with_feedback(move, state)
        if move.outcome == "aborted" and move.then == "hover" and not state.landed:
            return self._go_on_elsewhere(t_ns, state, move.reason)
        return move

    def _lasts_for_others(self, t_ns: int, state: VehicleState, others: list[Place | Refusal]) -> bool:
        """Whether the best of the other places may still be reached a little later."""
        way = self._decision.best(t_ns, state, others, None)
        return self._decision.leaves_reserve(t_ns, state, way, SEARCH_MARGIN_S)

    def _with_feedback(self, move: Move, state: VehicleState) -> Move:
        return replace(move, feedback=self._feedback(state, "landing", move.feedback))

    def _feedback(self, state: VehicleState, phase: ReturnPhase, landing: LandFeedback | None = None) -> ReturnFeedback:
        return ReturnFeedback(
            pos_uav_ned_m=state.pos_uav_ned_m,
            phase=phase,
            place=self._way.place.kind,
            place_ned_m=self._place_ned_m,
            reason=self._way.reason,
            landing=landing,
        )


SELECTION = Selection(use_uwb=True, use_tag=True)


class ReturnHomePlanner:
    """Plans the way home; the place follows from what is known of the rover when the flight begins."""

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config

    def plan(self, goal: ReturnHomeGoal, status: Status) -> Plan | Refusal:
        """Plan a return; neither the battery nor the wind refuses it."""
        limits = self._config.vehicle.limits
        if reason := speed_refusal(goal.speed_mps, limits):
            return Refusal(reason)
        if goal.safe_height_m is not None and goal.safe_height_m > limits.altitude_max_m:
            return Refusal(f"safe_height_m {goal.safe_height_m:g} is above the limit of {limits.altitude_max_m:g} m")
        return Plan(
            partial(ReturnHome, goal, status.takeoff_ned_m, SELECTION, self._config),
            lands=True,
            inputs=(ALTIMETER, RELATIVE, ROVER_ESTIMATE),
            selection=SELECTION,
            check_inputs=_wait_for_inputs,
        )


def _wait_for_inputs(state: VehicleState) -> str:
    """Refuse nothing: the vehicle returns with whatever inputs have come."""
    return ""
