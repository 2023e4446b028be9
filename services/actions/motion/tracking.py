"""Tracking of a moving reference: velocity setpoints by a PID controller of the position, with feed-forward.

Source: thesis §3.5 and algorithm 7.
"""

from typing import NamedTuple

from jezero.base.frames import Vec3, add, distance, norm, scale, subtract
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import VehicleState
from jezero.services.actions.motion.config import TrackingConfig

STEP_MAX_S = 0.1
"""A server that was frozen goes on where it was instead of jumping ahead."""
INTEGRAL_WITHIN_M, INTEGRAL_MAX_MPS = 0.5, 0.3
"""The integral grows only at a smaller position error than INTEGRAL_WITHIN_M; the other is its limit."""
CORRECTION_MAX_MPS = 1.0
"""Limit of the proportional and the derivative part together."""
LAG_FREE_M, LAG_MAX_M = 0.3, 1.0
"""The reference slows down when the vehicle is farther from it than LAG_FREE_M, and waits beyond LAG_MAX_M."""
PROGRESS_TIMEOUT_S = 20.0
"""A goal is aborted when the vehicle gets no nearer, or the reference had to wait, for this duration."""
STRONG_WIND_MPS, STRONG_WIND_TIMEOUT_S = 8.0, 60.0
"""In a stronger wind, gusts included, this longer time-out holds: a gust that carries the vehicle off lasts for some
seconds, and the vehicle needs as long again to come back."""
RATE_AT_REST = 1e-3
"""The reference counts as waiting at a lower rate than this."""
SPEED_AT_REST_MPS = 1e-6
"""Below this speed the reference is at its end. A vehicle that has not arrived there makes no progress any more."""
ZERO: Vec3 = (0.0, 0.0, 0.0)


class Reference(NamedTuple):
    """Reference position at one time, with its velocity and acceleration."""

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    acc_ned_mps2: Vec3

    def slowed(self, rate: float) -> "Reference":
        """The same point, passed at `rate` times the speed."""
        return Reference(self.pos_ned_m, scale(self.vel_ned_mps, rate), scale(self.acc_ned_mps2, rate * rate))


class Tracker:
    """Keeps a vehicle on a reference that is a function of its own time.

    The reference's time slows down when the vehicle falls behind.

    Attributes:
        time_s: the reference's own time.
        rate: rate of the reference's time relative to the vehicle's: 1 as planned, 0 while it waits.
    """

    def __init__(self, t_ns: int, config: TrackingConfig) -> None:
        self.time_s = 0.0
        self.rate = 1.0
        self._config = config
        self._t_ns = t_ns
        self._moved_ns = t_ns
        self._lag_m = 0.0
        self._timeout_s = PROGRESS_TIMEOUT_S
        self._integral_mps = ZERO

    def restart(self, t_ns: int) -> None:
        """Begin another reference; the integral stays, because it compensates the wind."""
        self.time_s = 0.0
        self._t_ns = self._moved_ns = t_ns

    def advance(self, t_ns: int, reference: Reference, state: VehicleState) -> float:
        """Advance the reference's time, by the vehicle's distance from it.

        Args:
            reference: at `time_s`.

        Returns:
            Time since the last call, s.
        """
        dt_s = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        self._timeout_s = progress_timeout_s(state)
        lag_m = distance(reference.pos_ned_m, position_now(state))
        self.rate = min(max((LAG_MAX_M - lag_m) / (LAG_MAX_M - LAG_FREE_M), 0.0), 1.0)
        self._lag_m = lag_m
        if self.rate > RATE_AT_REST and norm(reference.vel_ned_mps) > SPEED_AT_REST_MPS:
            self._moved_ns = t_ns
        self.time_s += self.rate * dt_s
        return dt_s

    def stuck(self, t_ns: int) -> str:
        """Reason why the vehicle can't follow, or "" while it makes progress."""
        stuck_s = (t_ns - self._moved_ns) / NS_PER_S
        if stuck_s <= self._timeout_s:
            return ""
        return f"no progress for {stuck_s:.0f} s: {self._lag_m:.1f} m from the reference"

    def command(self, dt_s: float, reference: Reference, state: VehicleState) -> tuple[Vec3, Vec3]:
        """Velocity setpoint and its derivative.

        Args:
            dt_s: since the last command.
            reference: at `time_s`, at its full speed.
        """
        config = self._config
        pos_ned_m, vel_ned_mps, acc_ned_mps2 = reference.slowed(self.rate)
        error_m = subtract(pos_ned_m, position_now(state))
        error_mps = subtract(vel_ned_mps, state.vel_uav_ned_mps)
        if norm(error_m) < INTEGRAL_WITHIN_M:
            grown = add(self._integral_mps, scale(error_m, config.gain_integral_1ps2 * dt_s))
            self._integral_mps = clipped(grown, INTEGRAL_MAX_MPS)
        correction = add(scale(error_m, config.gain_1ps), scale(error_mps, config.gain_derivative))
        velocity = add(vel_ned_mps, add(clipped(correction, CORRECTION_MAX_MPS), self._integral_mps))
        return velocity, clipped(add(acc_ned_mps2, scale(error_mps, config.gain_1ps)), config.acceleration_max_mps2)


def progress_timeout_s(state: VehicleState) -> float:
    """Time without progress after which a goal is aborted, by the wind at the vehicle."""
    return STRONG_WIND_TIMEOUT_S if state.wind_in_gusts_mps > STRONG_WIND_MPS else PROGRESS_TIMEOUT_S


def position_now(state: VehicleState) -> Vec3:
    """The vehicle's position, extrapolated from the time of its measurement."""
    return add(state.pos_uav_ned_m, scale(state.vel_uav_ned_mps, state.age_s))


def clipped(vector: Vec3, length_max: float) -> Vec3:
    """The vector, shortened to `length_max` if it is longer."""
    length = norm(vector)
    return vector if length <= length_max else scale(vector, length_max / length)
