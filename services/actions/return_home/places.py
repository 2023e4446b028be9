"""The places to which a vehicle may return, best first."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from jezero.frames import Vec3, altitude_m, horizontal
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.goals import HomePlace
from jezero.vehicle_config import VehicleLimitsConfig

NO_TAKEOFF = "nobody knows where the vehicle took off"
NO_RALLY_POINT = "there is no rally point"
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
    north_mps, east_mps, _ = rover.vel_rover_ned_mps
    if rover.valid:
        note = "the rover is in sight"
    elif rover.std_pos_m <= std_max_m:
        note = f"the rover is out of sight; by its odometry its position is known to {rover.std_pos_m:.1f} m"
    else:
        return rover.reason or f"its position is known to {rover.std_pos_m:.0f} m"
    return Place("rover", rover.pos_rover_ned_m, note, (north_mps, east_mps, 0.0))


def ground_places(
    pos_uav_ned_m: Vec3, takeoff_ned_m: Vec3 | None, rally_points_ned_m: Sequence[tuple[float, float]]
) -> list[Place | str]:
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
