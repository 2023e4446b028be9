"""The geometry of a flight around a target, and where the camera must look. Source: thesis §3.5, eqs. 3.1 to 3.6."""

from dataclasses import dataclass
from math import atan2, copysign, cos, hypot, pi, sin, sqrt

from jezero.frames import Quat, Vec3, add, distance, quat_conjugate, quat_rotate, scale, subtract, wrap_pi
from jezero.services.actions.motion.tracking import Reference

ZERO: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Profile:
    """A way from rest to rest with a trapezoidal speed: how far, how fast and how hard at a time.

    Attributes:
        acceleration_mps2: speeding up and braking.
    """

    length_m: float
    speed_mps: float
    acceleration_mps2: float

    @property
    def top_mps(self) -> float:
        """Less than `speed_mps` where the way is too short for it."""
        return min(self.speed_mps, sqrt(self.acceleration_mps2 * self.length_m))

    @property
    def duration_s(self) -> float:
        if self.length_m <= 0.0:
            return 0.0
        return self.length_m / self.top_mps + self.top_mps / self.acceleration_mps2

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Distance, speed and acceleration along the way; before and after it at rest."""
        a, top_mps, duration_s = self.acceleration_mps2, self.top_mps, self.duration_s
        if time_s <= 0.0 or time_s >= duration_s:
            return (0.0 if time_s <= 0.0 else self.length_m), 0.0, 0.0
        ramp_s, left_s = top_mps / a, duration_s - time_s
        if time_s < ramp_s:
            return 0.5 * a * time_s * time_s, a * time_s, a
        if left_s < ramp_s:
            return self.length_m - 0.5 * a * left_s * left_s, a * left_s, -a
        return top_mps * (time_s - 0.5 * ramp_s), top_mps, 0.0


class Line:
    """Straight from one point to another."""

    def __init__(self, start_ned_m: Vec3, end_ned_m: Vec3, speed_mps: float, acceleration_mps2: float) -> None:
        self.end_ned_m = end_ned_m
        length_m = distance(start_ned_m, end_ned_m)
        self.profile = Profile(length_m, speed_mps, acceleration_mps2)
        self._start_ned_m = start_ned_m
        self._direction = scale(subtract(end_ned_m, start_ned_m), 1.0 / length_m) if length_m > 0.0 else ZERO

    def at(self, time_s: float) -> Reference:
        """Position, velocity and acceleration."""
        way_m, speed_mps, acceleration_mps2 = self.profile.at(time_s)
        return Reference(
            add(self._start_ned_m, scale(self._direction, way_m)),
            scale(self._direction, speed_mps),
            scale(self._direction, acceleration_mps2),
        )


class Orbit:
    """One turn around a centre at constant height, clockwise as seen from above.

    Args:
        center_ned_m: (3,) its z is the height.
        phase_rad: where the turn begins and ends, from north, positive towards east.
    """

    def __init__(
        self, center_ned_m: Vec3, radius_m: float, phase_rad: float, speed_mps: float, acceleration_mps2: float
    ) -> None:
        self.center_ned_m = center_ned_m
        self.radius_m = radius_m
        self.phase_rad = phase_rad
        self.profile = Profile(2.0 * pi * radius_m, speed_mps, acceleration_mps2)

    def at(self, time_s: float) -> Reference:
        """Position, velocity and acceleration: on the circle, along it, and towards the centre."""
        way_m, speed_mps, acceleration_mps2 = self.profile.at(time_s)
        angle_rad = self.phase_rad + way_m / self.radius_m
        c, s, inwards_mps2 = cos(angle_rad), sin(angle_rad), speed_mps * speed_mps / self.radius_m
        north_m, east_m, down_m = self.center_ned_m
        return Reference(
            (north_m + self.radius_m * c, east_m + self.radius_m * s, down_m),
            (-speed_mps * s, speed_mps * c, 0.0),
            (-acceleration_mps2 * s - inwards_mps2 * c, acceleration_mps2 * c - inwards_mps2 * s, 0.0),
        )


def nearest_phase(center_ned_m: Vec3, pos_ned_m: Vec3, yaw_rad: float) -> float:
    """Angle of the circle's point that is nearest; from its very centre, the one behind the vehicle."""
    north_m, east_m = pos_ned_m[0] - center_ned_m[0], pos_ned_m[1] - center_ned_m[1]
    return atan2(east_m, north_m) if hypot(north_m, east_m) > 0.1 else wrap_pi(yaw_rad + pi)


def facing(pos_ned_m: Vec3, vel_ned_mps: Vec3, center_ned_m: Vec3) -> tuple[float, float]:
    """Heading towards a centre, and how fast it turns."""
    north_m, east_m = center_ned_m[0] - pos_ned_m[0], center_ned_m[1] - pos_ned_m[1]
    square_m2 = max(north_m * north_m + east_m * east_m, 0.01)
    return atan2(east_m, north_m), (east_m * vel_ned_mps[0] - north_m * vel_ned_mps[1]) / square_m2


def aim(q_ned_from_frd: Quat, way_ned_m: Vec3, roll_max_rad: float) -> tuple[float, float]:
    """Pitch and roll of the camera that put something in the middle of the picture, as far as the axes reach.

    Args:
        way_ned_m: (3,) from the camera to what it shall look at.
        roll_max_rad: the roll axis turns no farther.
    """
    forward_m, right_m, down_m = quat_rotate(quat_conjugate(q_ned_from_frd), way_ned_m)
    roll_rad = -atan2(right_m, max(down_m, 1e-9))
    if abs(roll_rad) > roll_max_rad:
        roll_rad = copysign(roll_max_rad, roll_rad)
    below_m = down_m * cos(roll_rad) - right_m * sin(roll_rad)
    return min(0.0, max(-0.5 * pi, -atan2(below_m, forward_m))), roll_rad
