"""The places to which a vehicle may return, best first."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from jezero.frames import Vec3, altitude_m, horizontal
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.goals import HomePlace
from jezero.vehicle_config import VehicleLimitsConfig


@dataclass(frozen=True)
class Place:
    """A place to land.

    Attributes:
        kind: the rover, or what the place on the ground is.
        pos_ned_m: its position; z of a rally point is that of the world's origin.
        reason: why the vehicle returns to this place, for people.
    """

    kind: HomePlace
    pos_ned_m: Vec3
    reason: str

    @property
    def words(self) -> str:
        """What the place is, for people."""
        return self.kind.replace("_", " ")


def rover_place(rover: RoverEstimate | None, std_max_m: float, limits: VehicleLimitsConfig) -> Place | str:
    """The rover, or the reason why nobody knows where it is.

    Args:
        std_max_m: greatest standard deviation of a position that is good enough to fly there.
        limits: a rover beyond them is none: its estimate is wrong, or the vehicle may not follow it.
    """
    if rover is None:
        return "the estimator is silent"
    away_m, height_m = horizontal(rover.pos_rover_ned_m), altitude_m(rover.pos_rover_ned_m[2])
    if away_m > limits.distance_max_m or height_m > limits.altitude_max_m:
        beyond = f"beyond the limits of {limits.distance_max_m:g} m and {limits.altitude_max_m:g} m"
        return f"its estimated position is {away_m:.0f} m away and {height_m:.0f} m up, {beyond}"
    if rover.valid:
        return Place("rover", rover.pos_rover_ned_m, "the rover is in sight")
    if rover.std_pos_m <= std_max_m:
        known = f"the rover is out of sight; by its odometry its position is known to {rover.std_pos_m:.1f} m"
        return Place("rover", rover.pos_rover_ned_m, known)
    return rover.reason or f"its position is known to {rover.std_pos_m:.0f} m"


def ground_places(
    because: str, pos_uav_ned_m: Vec3, takeoff_ned_m: Vec3 | None, rally_points_ned_m: Sequence[tuple[float, float]]
) -> list[Place]:
    """Places on the ground, in the order in which they are tried: never none.

    Args:
        because: why the vehicle doesn't land on the rover.
        takeoff_ned_m: where the vehicle took off; None when nobody knows.
    """
    north_m, east_m, _ = pos_uav_ned_m
    places = []
    if takeoff_ned_m is not None:
        places.append(Place("takeoff_point", takeoff_ned_m, because))
    if rally_points_ned_m:
        nearest_m = min(rally_points_ned_m, key=lambda point: hypot(point[0] - north_m, point[1] - east_m))
        also = "" if takeoff_ned_m is not None else "; nobody knows where the vehicle took off"
        places.append(Place("rally_point", (*nearest_m, 0.0), because + also))
    if not places:
        unknown = f"{because}; nobody knows where the vehicle took off, and there is no rally point"
        places.append(here(unknown, pos_uav_ned_m))
    return places


def here(reason: str, pos_uav_ned_m: Vec3) -> Place:
    """The ground below the vehicle."""
    north_m, east_m, _ = pos_uav_ned_m
    return Place("here", (north_m, east_m, 0.0), reason)
