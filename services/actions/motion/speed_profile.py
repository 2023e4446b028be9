"""Trapezoidal speed profiles from rest to rest: as a function of time, and step by step."""

from dataclasses import dataclass
from math import sqrt


@dataclass(frozen=True, slots=True)
class SpeedProfile:
    """A trapezoidal speed profile as a function of time.

    Attributes:
        length_m: from the start to the end.
        speed_mps: greatest speed.
        acceleration_mps2: speeding up and braking.
    """

    length_m: float
    speed_mps: float
    acceleration_mps2: float

    @property
    def top_mps(self) -> float:
        """Greatest speed that is reached; less than `speed_mps` where the length is too short for it."""
        return min(self.speed_mps, sqrt(self.acceleration_mps2 * self.length_m))

    @property
    def duration_s(self) -> float:
        if self.length_m <= 0.0:
            return 0.0
        return self.length_m / self.top_mps + self.top_mps / self.acceleration_mps2

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Distance, speed and acceleration at a time; at rest before the start and after the end."""
        a, top_mps, duration_s = self.acceleration_mps2, self.top_mps, self.duration_s
        if time_s <= 0.0 or time_s >= duration_s:
            return (0.0 if time_s <= 0.0 else self.length_m), 0.0, 0.0
        ramp_s, left_s = top_mps / a, duration_s - time_s
        if time_s < ramp_s:
            return 0.5 * a * time_s * time_s, a * time_s, a
        if left_s < ramp_s:
            return self.length_m - 0.5 * a * left_s * left_s, a * left_s, -a
        return top_mps * (time_s - 0.5 * ramp_s), top_mps, 0.0


def time_to_rest_s(length_m: float, speed_mps: float, *, speed_max_mps: float, accel_mps2: float) -> float:
    """Time of a trapezoidal profile that ends at rest after `length_m` and begins with `speed_mps`.

    It is the rest of a profile from rest that has reached this speed.
    """
    ramp_m = 0.5 * speed_mps * speed_mps / accel_mps2
    whole = SpeedProfile(length_m + ramp_m, max(speed_max_mps, speed_mps), accel_mps2)
    return max(whole.duration_s - speed_mps / accel_mps2, 0.0)


def next_speed_mps(
    speed_mps: float, dt_s: float, *, speed_max_mps: float, accel_mps2: float, remaining_m: float
) -> float:
    """Speed of a trapezoidal profile after one step, for a motion that may be held up on its way.

    Args:
        speed_mps: before the step.
        remaining_m: to the end, where the motion must be able to stop.
    """
    return min(speed_mps + accel_mps2 * dt_s, speed_max_mps, sqrt(2.0 * accel_mps2 * remaining_m))
