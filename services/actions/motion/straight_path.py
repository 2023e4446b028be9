"""Straight paths from one point to another, with trapezoidal speed profiles from rest to rest.

`StraightPath` moves its reference step by step and lets it wait for the vehicle; it also turns the heading and tests
for arrival. `TimedStraightPath` gives its reference as a function of time, for the `Tracker`, which does the waiting.
"""

from dataclasses import dataclass
from math import sqrt

from jezero.base.frames import Vec3, add, distance, dot, norm, scale, subtract, wrap_pi
from jezero.schemas.commands import Phase
from jezero.schemas.goals import ImagesFeedback, LandFeedback, MoveFeedback
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.arrival import ArrivalDetector
from jezero.services.actions.motion.behaviour import Move, Remaining, VehicleState
from jezero.services.actions.motion.config import MoveConfig
from jezero.services.actions.motion.tracking import PROGRESS_TIMEOUT_S, ZERO, Reference, progress_timeout_s

STEP_MAX_S = 0.1
"""A server that was frozen goes on where it was instead of jumping ahead."""
LEAD_M, LEAD_S = 1.0, 0.5
"""The reference waits when it is more than LEAD_M + LEAD_S * speed ahead of the vehicle."""
LEAD_GAIN_1PS = 4.0
PROGRESS_M = 0.1


class StraightPath:
    """A straight path whose reference point moves with a trapezoidal speed profile, step by step.

    The reference waits for a vehicle that falls behind, so that an obstacle, a gust or a slow take-off never builds
    up a distant setpoint.

    Args:
        speed_mps: along the path; the vertical limits of `config` apply besides.
        yaw_end_rad: heading to turn to; None keeps `yaw_start_rad`.
        lead_max_m: greatest distance of the reference ahead of the vehicle; None: by `config` and `speed_mps`.

    Attributes:
        end_ned_m: end of the path.
        pos_ned_m: position of the reference.
        vel_ned_mps: velocity of the reference.
        acc_ned_mps2: acceleration of the reference.
        yaw_rad: heading of the reference.
        left_m: distance from the vehicle to the end.
        reached: whether the vehicle has arrived, by spec §1.
    """

    def __init__(
        self,
        t_ns: int,
        start_ned_m: Vec3,
        end_ned_m: Vec3,
        *,
        speed_mps: float,
        config: MoveConfig,
        yaw_start_rad: float,
        yaw_end_rad: float | None = None,
        lead_max_m: float | None = None,
    ) -> None:
        self.end_ned_m = end_ned_m
        self.pos_ned_m = start_ned_m
        self.vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self.acc_ned_mps2: Vec3 = (0.0, 0.0, 0.0)
        self.yaw_rad = yaw_start_rad
        self.reached = False
        self._start_ned_m = start_ned_m
        self._length_m = distance(start_ned_m, end_ned_m)
        self._direction = scale(subtract(end_ned_m, start_ned_m), 1.0 / max(self._length_m, 1e-9))
        self._speed_max_mps = straight_speed_mps(start_ned_m, end_ned_m, speed_mps, config)
        self._lead_max_m = LEAD_M + LEAD_S * speed_mps if lead_max_m is None else lead_max_m
        self._config = config
        self._yaw_end_rad = yaw_start_rad if yaw_end_rad is None else wrap_pi(yaw_end_rad)
        self.left_m = self._length_m
        self._travelled_m = 0.0
        self._speed_mps = 0.0
        self._t_ns = t_ns
        self._arrival = ArrivalDetector(config, config.reached_s)
        self._nearest_m = float("inf")
        self._nearer_ns = t_ns
        self._timeout_s = PROGRESS_TIMEOUT_S

    def step(self, t_ns: int, state: VehicleState) -> None:
        """Move the reference on and test whether the vehicle has arrived."""
        dt = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        self._timeout_s = progress_timeout_s(state)
        self._advance(dt, distance(self.pos_ned_m, state.pos_uav_ned_m))
        turned = self.yaw_rad == self._yaw_end_rad or self._turn(dt)
        self._test_arrival(t_ns, state, turned=turned)

    def wait(self, t_ns: int, state: VehicleState) -> None:
        """Keep the reference where it is; this time doesn't count as lack of progress."""
        self.left_m = distance(self.end_ned_m, state.pos_uav_ned_m)
        self._t_ns = t_ns
        self._nearer_ns = t_ns

    def redirect(self, end_ned_m: Vec3) -> None:
        """Lead to another end from where the reference is; it keeps its speed as far as that leads to the new end."""
        way_ned_m = subtract(end_ned_m, self.pos_ned_m)
        length_m = norm(way_ned_m)
        direction = scale(way_ned_m, 1.0 / max(length_m, 1e-9))
        self._nearest_m += distance(end_ned_m, self.end_ned_m)
        self._speed_mps *= max(dot(self._direction, direction), 0.0)
        self._start_ned_m, self.end_ned_m = self.pos_ned_m, end_ned_m
        self._length_m, self._direction, self._travelled_m = length_m, direction, 0.0

    def stuck(self, t_ns: int) -> str:
        """Reason why the end can't be reached, or "" while the vehicle makes progress."""
        stuck_s = (t_ns - self._nearer_ns) / NS_PER_S
        if stuck_s <= self._timeout_s:
            return ""
        return f"no progress for {stuck_s:.0f} s: still {self._nearest_m:.2f} m from the target"

    def remaining(self) -> Remaining:
        """Rest of the path, with the time for which the vehicle must be near and slow at its end."""
        config = self._config
        fly_s = _time_to_rest_s(
            self._length_m - self._travelled_m,
            self._speed_mps,
            speed_max_mps=self._speed_max_mps,
            accel_mps2=config.accel_mps2,
        )
        turn_s = abs(wrap_pi(self._yaw_end_rad - self.yaw_rad)) / config.yaw_rate_rps
        return Remaining(max(fly_s, turn_s) + config.reached_s, self.left_m)

    def move(self, phase: Phase, feedback: MoveFeedback | LandFeedback | ImagesFeedback) -> Move:
        """Setpoint of the reference, with the action's feedback."""
        return Move(phase, feedback, self.pos_ned_m, self.vel_ned_mps, self.acc_ned_mps2, self.yaw_rad)

    def _advance(self, dt: float, lead_m: float) -> None:
        accel, speed_before_mps = self._config.accel_mps2, self._speed_mps
        remaining = self._length_m - self._travelled_m
        (x, y, z), (n, e, d) = self._start_ned_m, self._direction
        free_mps = min(self._speed_mps + accel * dt, self._speed_max_mps, sqrt(2.0 * accel * remaining))
        self._speed_mps = min(free_mps, max(LEAD_GAIN_1PS * (self._lead_max_m - lead_m), 0.0))
        step_m = self._speed_mps * dt
        if remaining - step_m < 1e-3:
            self._travelled_m = self._length_m
            self._speed_mps = 0.0
            self.pos_ned_m = self.end_ned_m
        else:
            self._travelled_m += step_m
            self.pos_ned_m = (x + n * self._travelled_m, y + e * self._travelled_m, z + d * self._travelled_m)
        change = (self._speed_mps - speed_before_mps) / dt if dt > 0.0 else 0.0
        change = min(max(change, -accel), accel)
        self.vel_ned_mps = (n * self._speed_mps, e * self._speed_mps, d * self._speed_mps)
        self.acc_ned_mps2 = (n * change, e * change, d * change)

    def _turn(self, dt: float) -> bool:
        """Turn the reference's heading; returns whether it is the wanted one."""
        turn = wrap_pi(self._yaw_end_rad - self.yaw_rad)
        turn_max = self._config.yaw_rate_rps * dt
        if abs(turn) <= turn_max:
            self.yaw_rad = self._yaw_end_rad
            return True
        self.yaw_rad = wrap_pi(self.yaw_rad + min(max(turn, -turn_max), turn_max))
        return False

    def _test_arrival(self, t_ns: int, state: VehicleState, *, turned: bool) -> None:
        error_ned_m = subtract(self.end_ned_m, state.pos_uav_ned_m)
        distance_m = self.left_m = norm(error_ned_m)
        if distance_m < self._nearest_m - PROGRESS_M:
            self._nearest_m = distance_m
            self._nearer_ns = t_ns
        self.reached = self._arrival.update(
            t_ns, error_ned_m, state.vel_uav_ned_mps, turned=turned, wind_mps=state.wind_in_gusts_mps
        )


def straight_speed_mps(start_ned_m: Vec3, end_ned_m: Vec3, speed_mps: float, config: MoveConfig) -> float:
    """`speed_mps`, or less where a straight path would exceed a vertical speed limit."""
    length = distance(start_ned_m, end_ned_m)
    down = end_ned_m[2] - start_ned_m[2]
    vertical_max = config.speed_down_mps if down > 0.0 else config.speed_up_mps
    if abs(down) * speed_mps <= vertical_max * length:
        return speed_mps
    return vertical_max * length / abs(down)


class TimedStraightPath:
    """A straight path as a function of time."""

    def __init__(self, start_ned_m: Vec3, end_ned_m: Vec3, speed_mps: float, acceleration_mps2: float) -> None:
        self.end_ned_m = end_ned_m
        length_m = distance(start_ned_m, end_ned_m)
        self.profile = SpeedProfile(length_m, speed_mps, acceleration_mps2)
        self._start_ned_m = start_ned_m
        self._direction = scale(subtract(end_ned_m, start_ned_m), 1.0 / length_m) if length_m > 0.0 else ZERO

    def at(self, time_s: float) -> Reference:
        """Reference at a time since the start."""
        way_m, speed_mps, acceleration_mps2 = self.profile.at(time_s)
        return Reference(
            add(self._start_ned_m, scale(self._direction, way_m)),
            scale(self._direction, speed_mps),
            scale(self._direction, acceleration_mps2),
        )


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

    def remaining(self, time_s: float) -> Remaining:
        """Rest of the motion at a time since its start."""
        return Remaining(max(self.duration_s - time_s, 0.0), self.length_m - self.at(time_s)[0])


def _time_to_rest_s(length_m: float, speed_mps: float, *, speed_max_mps: float, accel_mps2: float) -> float:
    """Time of a trapezoidal profile that ends at rest after `length_m` and begins with `speed_mps`.

    It is the rest of a profile from rest that has reached this speed.
    """
    ramp_m = 0.5 * speed_mps * speed_mps / accel_mps2
    whole = SpeedProfile(length_m + ramp_m, max(speed_max_mps, speed_mps), accel_mps2)
    return max(whole.duration_s - speed_mps / accel_mps2, 0.0)
