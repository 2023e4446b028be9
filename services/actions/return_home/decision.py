"""Decides to which place a return leads: the best that the vehicle reaches with the battery's reserve.

What each place needs is calculated anew at each decision, from where the vehicle is: with the wind that blows, to where
a driving rover will be, as high as the fence lets the vehicle fly, and with the charge that is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

from jezero.base.fence import HOLD_OFF_M, way_refusal
from jezero.base.frames import Vec3, add, altitude_m, distance, horizontal, norm, scale, subtract, z_ned_m
from jezero.base.vehicle_config import BatteryConfig, FlightCost, VehicleConfig, VehicleLimitsConfig, flight_cost
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.goals import HomePlace, ReturnHomeGoal
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.plain_landing import plain_descent_remaining
from jezero.services.actions.land_on_spot.rover_landing import rover_landing_remaining
from jezero.services.actions.motion.behaviour import Refusal, VehicleState
from jezero.services.actions.motion.config import MoveConfig
from jezero.services.actions.motion.straight_path import SpeedProfile, straight_speed_mps

NO_TAKEOFF = Refusal("nobody knows where the vehicle took off")
NO_RALLY_POINT = Refusal("there is no rally point")
STILL: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Place:
    """A place to land.

    Attributes:
        kind: the rover, or what the place on the ground is.
        pos_ned_m: its position; z of a rally point is that of the world's origin.
        note: what is known of it, for people.
        vel_ned_mps: its velocity.
    """

    kind: HomePlace
    pos_ned_m: Vec3
    note: str = ""
    vel_ned_mps: Vec3 = STILL

    @property
    def words(self) -> str:
        """What the place is, for people."""
        return self.kind.replace("_", " ")

    def is_same(self, other: "Place") -> bool:
        """Whether both are one place; a rover stays the same while it drives."""
        return self.kind == other.kind and (self.kind != "rally_point" or self.pos_ned_m == other.pos_ned_m)


def rover_place(rover: RoverEstimate | None, std_max_m: float, limits: VehicleLimitsConfig) -> Place | Refusal:
    """The rover, or the reason why nobody knows where it is.

    Args:
        std_max_m: greatest standard deviation of a position that is good enough to fly there.
        limits: a rover beyond them is none: its estimate is wrong, or the vehicle may not follow it.
    """
    if rover is None:
        return Refusal("the estimator is silent")
    away_m, height_m = horizontal(rover.pos_rover_ned_m), altitude_m(rover.pos_rover_ned_m[2])
    if away_m > limits.distance_max_m or height_m > limits.altitude_max_m:
        beyond = f"beyond the limits of {limits.distance_max_m:g} m and {limits.altitude_max_m:g} m"
        return Refusal(f"its estimated position is {away_m:.0f} m away and {height_m:.0f} m up, {beyond}")
    north_mps, east_mps, _ = rover.vel_rover_ned_mps
    if rover.valid:
        note = "the rover is in sight"
    elif rover.std_pos_m <= std_max_m:
        note = f"the rover is out of sight; by its odometry its position is known to {rover.std_pos_m:.1f} m"
    else:
        return Refusal(rover.reason or f"its position is known to {rover.std_pos_m:.0f} m")
    return Place("rover", rover.pos_rover_ned_m, note, (north_mps, east_mps, 0.0))


def ground_places(
    pos_uav_ned_m: Vec3, takeoff_ned_m: Vec3 | None, rally_points_ned_m: Sequence[tuple[float, float]]
) -> list[Place | Refusal]:
    """Places on the ground but for the one below the vehicle, best first; in place of one that is missing, why it is.

    Args:
        takeoff_ned_m: where the vehicle took off; None when nobody knows.
    """
    north_m, east_m, _ = pos_uav_ned_m
    nearest_first = sorted(rally_points_ned_m, key=lambda point: hypot(point[0] - north_m, point[1] - east_m))
    return [
        NO_TAKEOFF if takeoff_ned_m is None else Place("takeoff_point", takeoff_ned_m),
        *(Place("rally_point", (*point, 0.0)) for point in nearest_first),
        *(() if nearest_first else (NO_RALLY_POINT,)),
    ]


def here(pos_uav_ned_m: Vec3) -> Place:
    """The ground below the vehicle."""
    north_m, east_m, _ = pos_uav_ned_m
    return Place("here", (north_m, east_m, 0.0))


SWITCH_MARGIN = 1.3
"""A return turns to a better place where the battery would hold this many times the charge that the place needs, so
that it does not turn back at the next gust."""
RESOLUTION = 0.005
"""The autopilot reports whole percents, so that half of one may be missing: for this alone no place is given up."""
SLACK = 0.01
"""Where no place leaves the reserve, a place is still better than the ground below the vehicle, if it takes no more
than this fraction of the capacity more."""
DOUBT_MIN = 0.02
"""A gauge that reports more than the goal by this fraction is wrong."""
SPEED_MIN_MPS = 0.3
"""A vehicle that comes forward more slowly against the wind may just as well be blown away."""
MEETING_TRIES = 12
MEETING_M = 1.0
"""The place to meet a driving rover is calculated again until it changes by less than this."""
MEETING_MAX_S = 300.0
"""A rover that is not met within this time is left alone."""


@dataclass(frozen=True)
class Way:
    """A way to a place.

    Attributes:
        place: the place.
        end_ned_m: where the place will be when the vehicle arrives.
        corners_ned_m: ends of the straight legs: of the climb, above the place, and where the landing begins.
        cost: of the legs and the landing.
        reason: why the vehicle returns to this place, for people.
    """

    place: Place
    end_ned_m: Vec3
    corners_ned_m: tuple[Vec3, ...]
    cost: FlightCost
    reason: str = ""


class Charge:
    """The charge that is left, and what a way takes from it.

    Args:
        goal: has the charge and its use as its sender knows them, for a gauge that is wrong.
    """

    def __init__(self, goal: ReturnHomeGoal, battery: BatteryConfig, t_ns: int, state: VehicleState) -> None:
        self._battery = battery
        self._start_ns = t_ns
        reported = None if state.battery is None else state.battery.remaining
        self._start = reported if goal.charge is None else min(goal.charge, 1.0 if reported is None else reported)
        doubted = self._start is not None and reported is not None and reported - self._start > DOUBT_MIN
        declared_per_s = self._battery.used(1.0)
        self._fall_per_s = declared_per_s if doubted else self._battery.least_used(1.0)
        self._per_s = declared_per_s if goal.charge_per_s is None else goal.charge_per_s

    def needed(self, cost: FlightCost) -> float:
        """Fraction of the capacity that a way takes: by what is known of the vehicle, or by what the flight used so
        far, whichever is more."""
        return max(self._battery.used(cost.hover_s), self._per_s * cost.time_s)

    def left(self, t_ns: int, state: VehicleState) -> float | None:
        """Fraction of the capacity that is left now; None where nobody knows."""
        reported = None if state.battery is None else state.battery.remaining
        if self._start is None:
            return reported
        known = max(self._start - self._fall_per_s * (t_ns - self._start_ns) / NS_PER_S, 0.0)
        return known if reported is None else min(reported, known)

    def reserve(self, state: VehicleState) -> float:
        """Fraction of the capacity that must be left after the landing."""
        return self._battery.kept(None if state.battery is None else state.battery.critical)


class Decision:
    """The choice of one return.

    Args:
        goal: of the return.
        config: settings of all actions.
    """

    def __init__(self, goal: ReturnHomeGoal, config: ActionsConfig, t_ns: int, state: VehicleState) -> None:
        settings = config.return_home
        self.speed_mps = goal.speed_mps or settings.speed_mps
        self._safe_height_m = settings.safe_height_m if goal.safe_height_m is None else goal.safe_height_m
        self._config = config
        self._charge = Charge(goal, config.vehicle.battery, t_ns, state)

    def best(self, t_ns: int, state: VehicleState, places: Sequence[Place | Refusal], present: Way | None) -> Way:
        """The way to the best place that leaves the reserve; its reason says why better ones are left out.

        Args:
            places: best first; in place of one that can't be flown to, the reason, for people.
            present: the way that is being flown; None at first. It is left for a better one only with a margin.
        """
        left, reserve = self._charge.left(t_ns, state), self._charge.reserve(state)
        left_out: list[str] = []
        short: list[Way] = []
        for place in (*places, here(state.pos_uav_ned_m)):  # landing below the vehicle is possible at any time
            way = place if isinstance(place, Refusal) else self._way(place, state)
            if isinstance(way, Refusal):
                left_out.append(way.reason)
                continue
            is_present = present is not None and way.place.is_same(present.place)
            margin = SWITCH_MARGIN if present is not None and not is_present else 1.0
            keeps = left is None or left - margin * self._charge.needed(way.cost) >= reserve - RESOLUTION * is_present
            if keeps:
                return _with_left_out(way, left_out)
            short.append(way)
            rest = max((left or 0.0) - self._charge.needed(way.cost), 0.0)
            if way.place.kind != "here":
                left_out.append(
                    f"the {way.place.words} is left out: the battery would have {rest:.0%} there, and {reserve:.0%} is "
                    "its reserve"
                )
        here_needs = self._charge.needed(short[-1].cost)
        best = next(way for way in short if self._charge.needed(way.cost) <= here_needs + SLACK)
        return _with_left_out(best, [text for text in left_out if not text.startswith(f"the {best.place.words} is ")])

    def leaves_reserve(self, t_ns: int, state: VehicleState, way: Way, waiting_s: float) -> bool:
        """Whether a way would still leave the reserve after some more seconds of hovering."""
        left = self._charge.left(t_ns, state)
        wait = flight_cost(waiting_s, STILL, state.wind_ned_mps or STILL, self._config.vehicle)
        return left is None or left - self._charge.needed(way.cost.plus(wait)) >= self._charge.reserve(state)

    def cost(self, state: VehicleState, place: Place, corners_ned_m: Sequence[Vec3]) -> FlightCost | None:
        """Cost of the legs and of the landing at their end; None where the wind doesn't let the vehicle come there."""
        legs = self._legs_cost(state, corners_ned_m)
        return None if legs is None else legs.plus(self._landing_cost(state, place, corners_ned_m))

    def _legs_cost(self, state: VehicleState, corners_ned_m: Sequence[Vec3]) -> FlightCost | None:
        wind_ned_mps = state.wind_ned_mps or STILL
        cost, start_ned_m = FlightCost(0.0, 0.0), state.pos_uav_ned_m
        for end_ned_m in corners_ned_m:
            move, vehicle = self._config.move, self._config.vehicle
            leg = _leg_cost(start_ned_m, end_ned_m, self.speed_mps, move, wind_ned_mps, vehicle)
            if leg is None:
                return None
            cost, start_ned_m = cost.plus(leg), end_ned_m
        return cost

    def _landing_cost(self, state: VehicleState, place: Place, corners_ned_m: Sequence[Vec3]) -> FlightCost:
        _, _, z_start_ned_m = corners_ned_m[-1] if corners_ned_m else state.pos_uav_ned_m
        height_m = altitude_m(z_start_ned_m - place.pos_ned_m[2])
        land = self._config.land_on_spot
        if place.kind == "rover":
            landing = rover_landing_remaining((0.0, 0.0, z_ned_m(height_m)), land.rover)
        else:
            landing = plain_descent_remaining(height_m, land.plain)
        return flight_cost(landing.time_s, place.vel_ned_mps, state.wind_ned_mps or STILL, self._config.vehicle)

    def _way(self, place: Place, state: VehicleState) -> Way | Refusal:
        """The way to a place, or the reason why it is left out."""
        left_out = f"the {place.words} is left out: "
        end_ned_m, legs = place.pos_ned_m, FlightCost(0.0, 0.0)
        for _ in range(MEETING_TRIES):
            corners_ned_m = self._corners(state, end_ned_m)
            now = self._legs_cost(state, corners_ned_m)
            if now is None:
                wind_mps = horizontal(state.wind_ned_mps or STILL)
                return Refusal(f"{left_out}the wind of {wind_mps:.0f} m/s does not let the vehicle come there")
            legs = now
            if legs.time_s > MEETING_MAX_S and horizontal(place.vel_ned_mps) > 0.0:
                speed_mps = horizontal(place.vel_ned_mps)
                return Refusal(f"{left_out}it drives at {speed_mps:.1f} m/s, too fast to be caught up with")
            then_ned_m = add(place.pos_ned_m, scale(place.vel_ned_mps, legs.time_s))
            moved_m = subtract(then_ned_m, end_ned_m)
            if norm(moved_m) < MEETING_M:
                break
            # Half of the way towards it: the time jumps where the vehicle need not climb, and would never settle.
            end_ned_m = add(end_ned_m, scale(moved_m, 0.5))
        limit_m = self._config.vehicle.limits.distance_max_m
        if horizontal(end_ned_m) > limit_m and place.kind == "rover":
            return Refusal(f"{left_out}it drives beyond the limit of {limit_m:g} m")
        if state.fence is not None and place.kind != "here":
            way_ned_m = [state.pos_uav_ned_m, *corners_ned_m, end_ned_m]
            shifted_ned_m = [add(point_ned_m, state.shift_ned_m) for point_ned_m in way_ned_m]
            if refusal := way_refusal(state.fence, shifted_ned_m, from_ground=False, to_ground=True):
                return Refusal(left_out + refusal)
        cost = legs.plus(self._landing_cost(state, place, corners_ned_m))
        return Way(place, end_ned_m, corners_ned_m, cost)

    def _corners(self, state: VehicleState, place_ned_m: Vec3) -> tuple[Vec3, ...]:
        """The end of the climb, the point above the place, and the end of the descent, where the landing begins."""
        north_m, east_m, z_place_ned_m = place_ned_m
        x, y, z = start_ned_m = state.pos_uav_ned_m
        z_top_ned_m = z_ned_m(self._config.vehicle.limits.altitude_max_m)
        if state.fence is not None and state.fence.ceiling_m is not None:
            z_ceiling_ned_m = z_ned_m(state.fence.ceiling_m - HOLD_OFF_M) - state.shift_ned_m[2]
            z_top_ned_m = max(z_top_ned_m, min(z_ceiling_ned_m, z_place_ned_m))
        z_arrival_ned_m = max(z_place_ned_m + z_ned_m(self._config.return_home.height_arrival_m), z_top_ned_m)
        if hypot(north_m - x, east_m - y) < self._config.return_home.near_m:
            return ((north_m, east_m, z_arrival_ned_m),) if z < z_arrival_ned_m else ()
        z_way_ned_m = max(min(z, z_arrival_ned_m, z_ned_m(self._safe_height_m)), z_top_ned_m)
        corners = [(x, y, z_way_ned_m), (north_m, east_m, z_way_ned_m), (north_m, east_m, z_arrival_ned_m)]
        before = [start_ned_m, *corners]
        reached_m = self._config.move.reached_m
        return tuple(end for start, end in zip(before, corners, strict=False) if _far(start, end) > reached_m)


def _with_left_out(way: Way, left_out: Sequence[str]) -> Way:
    """A way with the reasons why better ones are left out; several rally points count as one."""
    rally = [text for text in left_out if text.startswith("the rally point is left out")]
    texts = [*(text for text in left_out if text not in rally), *rally[:1]]
    if len(rally) > 1:
        texts.append(f"so are {len(rally) - 1} more")
    reason = "; ".join(filter(None, (*texts, way.place.note)))
    return Way(way.place, way.end_ned_m, way.corners_ned_m, way.cost, reason)


def _far(start_ned_m: Vec3, end_ned_m: Vec3) -> float:
    """Greatest difference on any axis."""
    return max(abs(difference) for difference in subtract(end_ned_m, start_ned_m))


def _leg_cost(
    start_ned_m: Vec3, end_ned_m: Vec3, speed_mps: float, move: MoveConfig, wind_ned_mps: Vec3, vehicle: VehicleConfig
) -> FlightCost | None:
    """Cost of a straight leg from rest to rest; None where the vehicle doesn't come forward against the wind.

    Args:
        speed_mps: over ground, along the leg; it is less where the vertical limits or the wind don't allow it.
    """
    length_m = distance(start_ned_m, end_ned_m)
    if length_m < 1e-6:
        return FlightCost(0.0, 0.0)
    direction_ned = scale(subtract(end_ned_m, start_ned_m), 1.0 / length_m)
    speed_mps = straight_speed_mps(start_ned_m, end_ned_m, speed_mps, move)
    speed_mps = min(speed_mps, _speed_in_wind_mps(direction_ned, wind_ned_mps, vehicle.airspeed_max_mps))
    if speed_mps < SPEED_MIN_MPS:
        return None
    time_s = SpeedProfile(length_m, speed_mps, move.accel_mps2).duration_s + move.reached_s
    return flight_cost(time_s, scale(direction_ned, length_m / time_s), wind_ned_mps, vehicle)


def _speed_in_wind_mps(direction_ned: Vec3, wind_ned_mps: Vec3, airspeed_max_mps: float) -> float:
    """Greatest speed along a direction that an airspeed allows; 0 where the wind carries the vehicle off."""
    north, east = direction_ned[0], direction_ned[1]
    level = hypot(north, east)
    if level < 1e-3 or airspeed_max_mps == float("inf"):
        return float("inf")
    along_mps = (wind_ned_mps[0] * north + wind_ned_mps[1] * east) / level
    across_mps = (wind_ned_mps[0] * east - wind_ned_mps[1] * north) / level
    if abs(across_mps) >= airspeed_max_mps:
        return 0.0
    return max(along_mps + sqrt(airspeed_max_mps**2 - across_mps**2), 0.0) / level
