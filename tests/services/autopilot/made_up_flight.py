"""A made-up flight whose truth is known, with the sensors that an estimator gets of it."""

from collections.abc import Callable
from math import cos, sin

import numpy as np

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    geodetic_from_ned,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    scale,
    subtract,
)
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import StateEstimatorConfig
from jezero.services.autopilot.estimator import ACC_DENSITY, GYRO_DENSITY, STD_FIX_DOWN_M, StateEstimator

G = 9.81
DT_US = 4000
REST_S = 3.0
ORIGIN: Vec3 = (47.4, 8.5, 488.0)
CONFIG = StateEstimatorConfig()
FIELD_NED: Vec3 = (0.216 * cos(CONFIG.declination_rad), 0.216 * sin(CONFIG.declination_rad), 0.432)


def pose(t_s: float) -> tuple[Vec3, Quat]:
    """Position and attitude at a time: at rest, then a banked wander."""
    t = max(0.0, t_s - REST_S)
    grow = min(1.0, t / 4.0) ** 2 * (3.0 - 2.0 * min(1.0, t / 4.0))
    pos = (4.0 * grow * sin(0.5 * t), 3.0 * grow * sin(0.35 * t), -2.0 * grow * (1.0 + 0.3 * sin(0.6 * t)))
    q = quat_from_euler(0.15 * grow * sin(0.8 * t), 0.12 * grow * sin(0.9 * t), 0.4 + 0.5 * grow * sin(0.2 * t))
    return pos, q


def velocity(t_s: float) -> Vec3:
    after, before = pose(t_s + 1e-4)[0], pose(t_s - 1e-4)[0]
    return scale(subtract(after, before), 5000.0)


class World:
    """Feeds an estimator with the sensors of the made-up flight.

    Args:
        seed: of noise and biases; None makes perfect sensors.
        shift_ned_m: added to each fix's position, by time.

    Attributes:
        gnss_delay_s: age of a fix at its arrival.
        dates_fixes: whether fixes have a time stamp.
        has_gnss: whether there are fixes.
    """

    def __init__(self, seed: int | None = None, shift_ned_m: Callable[[float], Vec3] = lambda _: (0.0, 0.0, 0.0)):
        self.estimator = StateEstimator(CONFIG, G)
        self._random = None if seed is None else np.random.default_rng(seed)
        self._shift = shift_ned_m
        self.gnss_delay_s, self.dates_fixes, self.has_gnss = 0.1, True, True
        self.acc_bias = self._draw(0.05)
        self.gyro_bias = self._draw(0.003)
        self.step = 0
        self.vel = (0.0, 0.0, 0.0)

    @property
    def t_s(self) -> float:
        return self.step * DT_US * 1e-6

    def _draw(self, std: float) -> Vec3:
        """Nothing is added at rest, where the filter takes its origin from."""
        if self._random is None:
            return (0.0, 0.0, 0.0)
        x, y, z = self._random.normal(0.0, std, 3).tolist()
        return (x, y, z)

    def _white(self, std: float) -> Vec3:
        return self._draw(std) if self.t_s > REST_S else (0.0, 0.0, 0.0)

    def run(self, until_s: float) -> "World":
        while self.t_s < until_s:
            self._advance()
        return self

    def _advance(self) -> None:
        q_before, before_s = pose(self.t_s)[1], self.t_s
        self.step += 1
        pos, q = pose(self.t_s)
        turn = quat_multiply(quat_conjugate(q_before), q)
        gyro = scale((turn[1], turn[2], turn[3]), 2.0 / (DT_US * 1e-6))
        acc = scale(subtract(velocity(self.t_s), velocity(before_s)), 1e6 / DT_US)
        middle = pose(0.5 * (self.t_s + before_s))[1]
        force = quat_rotate(quat_conjugate(middle), subtract(acc, (0.0, 0.0, G)))
        rate_hz = 1e6 / DT_US
        force = add(add(force, self.acc_bias), self._white(ACC_DENSITY * rate_hz**0.5))
        gyro = add(add(gyro, self.gyro_bias), self._white(GYRO_DENSITY * rate_hz**0.5))
        self.estimator.on_imu(self.step * DT_US, force, gyro)
        if self.step % 25 == 0:
            self._slow(pos, q)

    def _slow(self, pos: Vec3, q: Quat) -> None:
        """Fixes, which are late, pressure altitude and magnetic field, ten times a second."""
        then_s = self.t_s - self.gnss_delay_s
        noise = add(self._white(CONFIG.ekf2_gps_p_noise_m), self._shift(self.t_s))
        noise = (noise[0], noise[1], noise[2] * STD_FIX_DOWN_M / CONFIG.ekf2_gps_p_noise_m)
        vel = add(velocity(then_s), self._white(CONFIG.ekf2_gps_v_noise_mps))
        position_deg = geodetic_from_ned(add(pose(then_s)[0], noise), ORIGIN)
        t_us = round(then_s * 1e6) if self.dates_fixes else 0
        if self.has_gnss:
            self.estimator.on_fix(Fix(t_us, position_deg, vel, valid=True))
        self.estimator.on_baro(100.0 - pos[2] + self._white(CONFIG.ekf2_baro_noise_m)[0])
        about_down = quat_from_euler(0.0, 0.0, self._white(CONFIG.ekf2_head_noise_rad)[2])
        self.estimator.on_mag(quat_rotate(quat_conjugate(q), quat_rotate(about_down, FIELD_NED)))

    def error(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """(15,) true error states, in the filter's order."""
        e, (pos, q) = self.estimator, pose(self.t_s)
        turn = quat_multiply(q, quat_conjugate(e.q_ned_from_frd))
        sign = 2.0 if turn[0] >= 0.0 else -2.0
        parts = (
            scale((turn[1], turn[2], turn[3]), sign),
            subtract(velocity(self.t_s), e.vel_ned_mps),
            subtract(pos, e.pos_ned_m),
            subtract(self.gyro_bias, e.gyro_bias_rps),
            subtract(self.acc_bias, e.acc_bias_mps2),
        )
        return np.array([value for part in parts for value in part])
