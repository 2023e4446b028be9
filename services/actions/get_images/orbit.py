"""Geometry of a flight around a target, and aiming of the camera. Source: thesis §3.5, eqs. 3.1 to 3.6."""

from itertools import pairwise
from math import atan2, copysign, cos, hypot, pi, sin
from typing import NamedTuple

from jezero.frames import Quat, Vec3, quat_conjugate, quat_rotate, wrap_pi
from jezero.services.actions.motion.speed_profile import SpeedProfile
from jezero.services.actions.motion.tracking import Reference


class Orbit:
    """One turn around a centre at constant height, clockwise as seen from above.

    Args:
        center_ned_m: (3,) its z is the orbit's.
        phase_rad: angle at which the turn begins, from north, positive towards east.
        turn_rad: how far it leads around the centre.
    """

    def __init__(
        self,
        center_ned_m: Vec3,
        radius_m: float,
        phase_rad: float,
        speed_mps: float,
        acceleration_mps2: float,
        turn_rad: float = 2.0 * pi,
    ) -> None:
        self.center_ned_m = center_ned_m
        self.radius_m = radius_m
        self.phase_rad = phase_rad
        self.profile = SpeedProfile(turn_rad * radius_m, speed_mps, acceleration_mps2)

    def at(self, time_s: float) -> Reference:
        """Reference at a time since the begin of the turn."""
        way_m, speed_mps, acceleration_mps2 = self.profile.at(time_s)
        angle_rad = self.phase_rad + way_m / self.radius_m
        c, s, inwards_mps2 = cos(angle_rad), sin(angle_rad), speed_mps * speed_mps / self.radius_m
        north_m, east_m, down_m = self.center_ned_m
        return Reference(
            (north_m + self.radius_m * c, east_m + self.radius_m * s, down_m),
            (-speed_mps * s, speed_mps * c, 0.0),
            (-acceleration_mps2 * s - inwards_mps2 * c, acceleration_mps2 * c - inwards_mps2 * s, 0.0),
        )


class Turn(NamedTuple):
    """Progress of a turn.

    Attributes:
        turned_rad: angle that the vehicle has flown around the centre.
        requested: number of pictures requested so far.
        points_rad: angle of each picture's point since the begin of the turn.
    """

    turned_rad: float
    requested: int
    points_rad: tuple[float, ...]

    @classmethod
    def begin(cls, num_images: int) -> "Turn":
        """The turn before its first picture, with evenly spread points."""
        return cls(0.0, 0, tuple(2.0 * pi * number / num_images for number in range(num_images)))

    def with_images(self, num_images: int) -> "Turn":
        """The same turn with another number of pictures in all: those that are missing are spread over its rest."""
        if num_images == len(self.points_rad):
            return self
        done = self.points_rad[: self.requested]
        begin_rad, missing = done[-1], num_images - self.requested
        spacing_rad = (2.0 * pi - begin_rad) / (missing + 1)
        return self._replace(points_rad=(*done, *(begin_rad + spacing_rad * (i + 1) for i in range(missing))))

    @property
    def spacing_min_rad(self) -> float:
        """Smallest angle between two points that are still to come."""
        left = (*self.points_rad[max(self.requested - 1, 0) :], 2.0 * pi)
        return min(other - one for one, other in pairwise(left))


def nearest_phase(center_ned_m: Vec3, pos_ned_m: Vec3, yaw_rad: float) -> float:
    """Angle of the nearest point of a circle; at its centre, of the point behind the vehicle."""
    north_m, east_m = pos_ned_m[0] - center_ned_m[0], pos_ned_m[1] - center_ned_m[1]
    return atan2(east_m, north_m) if hypot(north_m, east_m) > 0.1 else wrap_pi(yaw_rad + pi)


def facing(pos_ned_m: Vec3, vel_ned_mps: Vec3, center_ned_m: Vec3) -> tuple[float, float]:
    """Heading towards a centre, rad, and its rate, rad/s."""
    north_m, east_m = center_ned_m[0] - pos_ned_m[0], center_ned_m[1] - pos_ned_m[1]
    square_m2 = max(north_m * north_m + east_m * east_m, 0.01)
    return atan2(east_m, north_m), (east_m * vel_ned_mps[0] - north_m * vel_ned_mps[1]) / square_m2


def aim(q_ned_from_frd: Quat, way_ned_m: Vec3, roll_max_rad: float) -> tuple[float, float]:
    """Pitch and roll of the camera that put a target in the middle of the picture, within the axes' limits.

    Args:
        way_ned_m: (3,) from the camera to the target.
        roll_max_rad: limit of the roll axis.
    """
    forward_m, right_m, down_m = quat_rotate(quat_conjugate(q_ned_from_frd), way_ned_m)
    roll_rad = -atan2(right_m, max(down_m, 1e-9))
    if abs(roll_rad) > roll_max_rad:
        roll_rad = copysign(roll_max_rad, roll_rad)
    below_m = down_m * cos(roll_rad) - right_m * sin(roll_rad)
    return min(0.0, max(-0.5 * pi, -atan2(below_m, forward_m))), roll_rad
