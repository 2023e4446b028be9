"""Estimate of the vehicle's motion from its own sensors: an error-state Kalman filter with 15 states.

The nominal state is integrated with plain floats at the rate of the IMU, the covariance of its error at 50 Hz.
The error states are in NED, except the biases, which are in body FRD:

| index   | error of                | unit  |
|---------|-------------------------|-------|
| 0 – 2   | attitude, `q_true = exp(error) q` | rad |
| 3 – 5   | velocity                | m/s   |
| 6 – 8   | position                | m     |
| 9 – 11  | gyroscope bias          | rad/s |
| 12 – 14 | accelerometer bias      | m/s²  |

Source: Solà, Quaternion kinematics for the error-state Kalman filter, 2017, ch. 7 (global angular error).
"""

from collections import deque
from math import atan2, hypot, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    ned_from_geodetic,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalize,
    rotation_matrix,
    subtract,
    tilt_from_quat,
    wrap_pi,
    yaw_from_quat,
)
from jezero.base.vehicle_config import HeadingSource
from jezero.services.autopilot.alignment import FIX_AGE_MAX_US, MAG_CHECK_GAUSS, Fix, StartAlignment
from jezero.services.autopilot.config import StateEstimatorConfig
from jezero.services.autopilot.heading import HeadingGate, MotionHeading
from jezero.services.autopilot.reset_detector import ResetDetector

COVARIANCE_PERIOD_US = 20_000
HISTORY_LENGTH = FIX_AGE_MAX_US // COVARIANCE_PERIOD_US
SETTLE_US, STD_VEL_SETTLED_MPS = 2_000_000, 0.5
"""The estimate is valid when the filter has run for this time and the velocity's standard deviation is below this."""
ACC_DENSITY, GYRO_DENSITY, GYRO_BIAS_WALK = 0.02, 0.002, 0.0003
"""White noise of the IMU in m/s²/√Hz and rad/s/√Hz, and random walk of the gyroscope bias in rad/s/√s."""
STD_ACC_BIAS_MPS2, STD_GYRO_BIAS_RPS = 0.1, 0.005
"""Standard deviations of the biases at the start; that of the gyroscope after averaging at rest."""
STD_FIX_DOWN_M = 1.5
"""Standard deviation of one fix's height for the update."""
NO_AIDING_TIMEOUT_US = 10_000_000
FAKE_VEL_PERIOD_US = 1_000_000
STD_FAKE_VEL_MPS = 3.0
"""After this time without horizontal aiding a velocity of zero is fused once per period, with this standard deviation.
Otherwise attitude and heading would drift along with the velocity. The vehicle descends at that time, so its velocity
is low. Source: EKF2's fusion of a fake position.
"""
HEADING_SENSORS: dict[HeadingSource, str] = {"magnetometer": "magnetometer", "gnss": "GNSS receiver"}
ACC_BIAS_LIMIT_MPS2 = 0.4
GYRO_BIAS_LIMIT_RPS = 0.15

Matrix = NDArray[np.float64]
IDENTITY: Matrix = np.eye(15)


class StateEstimator:
    """The filter. IMU samples must come in the order of time; other measurements are fused as they arrive."""

    def __init__(
        self, config: StateEstimatorConfig, gravity_mps2: float, heading_by: HeadingSource = "magnetometer"
    ) -> None:
        self._config = config
        self._heading_by = heading_by
        self._gravity_mps2 = gravity_mps2
        self._alignment = StartAlignment(config, gravity_mps2, heading_by)
        self.running = False
        self.t_us = 0
        self.q_ned_from_frd: Quat = (1.0, 0.0, 0.0, 0.0)
        self.vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self.pos_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self.acc_ned_mps2: Vec3 = (0.0, 0.0, 0.0)
        self.rates_frd_rps: Vec3 = (0.0, 0.0, 0.0)
        self.gyro_bias_rps: Vec3 = (0.0, 0.0, 0.0)
        self.acc_bias_mps2: Vec3 = (0.0, 0.0, 0.0)
        self.R_ned_from_frd = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        """Elements row by row."""
        self.origin_deg: Vec3 | None = None
        self.reset_counter = 0
        self.reset_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        """Sum of all steps of the position by resets."""
        self.P: Matrix = np.zeros((15, 15))
        self._covariance_us = 0
        self._delta_vel_ned_mps = [0.0, 0.0, 0.0]
        self._origin_pressure_m = 0.0
        self._started_us = 0
        self._fake_vel_due_us = 0
        self._correction_sum = [0.0] * 6
        self._history: deque[tuple[int, Vec3, Vec3, float]] = deque(maxlen=HISTORY_LENGTH)
        self._pos_reset = ResetDetector()
        self._vel_reset = ResetDetector()
        self._height_reset = ResetDetector()
        self._heading_gate = HeadingGate(HEADING_SENSORS[heading_by])
        self._motion_heading = MotionHeading()
        self._turned_ned_rad: Vec3 = (0.0, 0.0, 0.0)
        """Sum of all corrections of the attitude."""

    def configure(self, config: StateEstimatorConfig) -> None:
        """Apply new settings at once."""
        self._config = config

    # -- state --------------------------------------------------------------------------------------------

    @property
    def invalid_reason(self) -> str:
        """Why the estimate is invalid, as a text for people; empty when it is valid."""
        if not self.running:
            return self._alignment.incomplete_reason
        if self.t_us - self._started_us < SETTLE_US or self.std_vel_mps > STD_VEL_SETTLED_MPS:
            return "position estimate is settling"
        return self._rejection_reason

    @property
    def _rejection_reason(self) -> str:
        """Text on the sensor that the innovation gate rejects, or ""."""
        if self._pos_reset.mean_innovation:
            return f"GNSS is {hypot(*self._pos_reset.mean_innovation):.1f} m away from the estimate"
        if self._vel_reset.mean_innovation:
            return "GNSS and the estimate differ in velocity"
        if self._height_reset.mean_innovation:
            return f"the barometer is {abs(self._height_reset.mean_innovation[0]):.1f} m away from the estimate"
        return self._heading_gate.rejection_reason

    @property
    def std_vel_mps(self) -> float:
        return sqrt(max(self.P[3, 3], self.P[4, 4], self.P[5, 5]))

    @property
    def var_pos_ned_m2(self) -> Vec3:
        """(3,) variance of the position, NED."""
        P = self.P
        return (float(P[6, 6]), float(P[7, 7]), float(P[8, 8]))

    @property
    def tilt_rad(self) -> float:
        return tilt_from_quat(self.q_ned_from_frd)

    @property
    def yaw_rad(self) -> float:
        return yaw_from_quat(self.q_ned_from_frd)

    # -- measurements --------------------------------------------------------------------------------------

    def on_imu(self, t_us: int, acc_frd_mps2: Vec3, gyro_frd_rps: Vec3) -> None:
        """Advance to `t_us` with the mean specific force and rate since the last sample."""
        dt_us = t_us - self.t_us if self.t_us else 0
        self.t_us = t_us
        if self.running:
            self._predict(dt_us * 1e-6, acc_frd_mps2, gyro_frd_rps)
            self._covariance_us += dt_us
            if self._covariance_us >= COVARIANCE_PERIOD_US:
                self._predict_covariance()
            if self.t_us >= self._fake_vel_due_us:
                self._fake_vel_due_us = self.t_us + FAKE_VEL_PERIOD_US
                self._update([(3, -self.vel_ned_mps[0], STD_FAKE_VEL_MPS), (4, -self.vel_ned_mps[1], STD_FAKE_VEL_MPS)])
            return
        self.rates_frd_rps = gyro_frd_rps
        self._alignment.on_imu(dt_us, acc_frd_mps2, gyro_frd_rps)
        if not self._alignment.incomplete_reason:
            self._start()

    def on_fix(self, fix: Fix) -> None:
        """Fuse a GNSS fix with the state at the time of its measurement."""
        if not self.running:
            self._alignment.on_fix(fix)
            return
        if not fix.valid or self.origin_deg is None:
            return
        c = self._config
        pos_then, vel_then = self._state_at(fix.t_us or self.t_us - int(c.ekf2_gps_delay_s * 1e6))
        vel_error = subtract(fix.vel_ned_mps, vel_then)
        north, east, down = subtract(ned_from_geodetic(fix.position_deg, self.origin_deg), pos_then)
        innovations = []
        gate = c.ekf2_gps_v_gate_mps + 3.0 * self.std_vel_mps
        if max(abs(e) for e in vel_error) < gate:
            self._vel_reset.clear()
            innovations += [(3 + i, vel_error[i], c.ekf2_gps_v_noise_mps) for i in range(3)]
        elif self._vel_reset.update(self.t_us, vel_error, c.ekf2_gps_v_gate_mps):
            self._reset(3, self._vel_reset.mean_innovation, c.ekf2_gps_v_noise_mps)
            self._vel_reset.clear()
        if hypot(north, east) < max(c.ekf2_gps_p_gate_m, 3.0 * sqrt(max(self.P[6, 6], self.P[7, 7]))):
            self._pos_reset.clear()
            innovations += [(6, north, c.ekf2_gps_p_noise_m), (7, east, c.ekf2_gps_p_noise_m)]
        elif self._pos_reset.update(self.t_us, (north, east), c.ekf2_gps_p_gate_m):
            self._reset(6, self._pos_reset.mean_innovation, c.ekf2_gps_p_noise_m)
            self._pos_reset.clear()
        if abs(down) < 4.0 * STD_FIX_DOWN_M + 3.0 * sqrt(self.P[8, 8]):
            innovations.append((8, down, STD_FIX_DOWN_M))
        if any(index < 8 for index, _, _ in innovations):
            self._fake_vel_due_us = self.t_us + NO_AIDING_TIMEOUT_US
        self._update(innovations)
        if self._heading_by == "gnss" and fix.yaw_rad is not None:
            then_us = fix.t_us or self.t_us - int(c.ekf2_gps_delay_s * 1e6)
            self._fuse_heading(wrap_pi(fix.yaw_rad - self._yaw_at(then_us)))
        motion = self._motion_heading
        motion.on_fix(fix.t_us or self.t_us - int(c.ekf2_gps_delay_s * 1e6), fix.vel_ned_mps)
        if motion.insists:
            # Velocity and position were integrated with the wrong heading, and may have been kept from the fixes since.
            self._reset(2, (motion.error_rad,), motion.std_rad)
            pos_then, vel_then = self._state_at(fix.t_us or self.t_us - int(c.ekf2_gps_delay_s * 1e6))
            self._reset(3, subtract(fix.vel_ned_mps, vel_then)[:2], c.ekf2_gps_v_noise_mps)
            north, east, _ = subtract(ned_from_geodetic(fix.position_deg, self.origin_deg), pos_then)
            self._reset(6, (north, east), c.ekf2_gps_p_noise_m)
            self._vel_reset.clear()
            self._pos_reset.clear()

    def on_baro(self, altitude_pressure_m: float) -> None:
        if not self.running:
            self._alignment.on_baro(altitude_pressure_m)
            return
        c = self._config
        down = -(altitude_pressure_m - self._origin_pressure_m) - self.pos_ned_m[2]
        if abs(down) < c.ekf2_baro_gate_m + 3.0 * sqrt(self.P[8, 8]):
            self._height_reset.clear()
            self._update([(8, down, c.ekf2_baro_noise_m)])
        elif self._height_reset.update(self.t_us, (down,), c.ekf2_baro_gate_m):
            self._reset(8, self._height_reset.mean_innovation, c.ekf2_baro_noise_m)
            self._height_reset.clear()

    def on_mag(self, field_frd_gauss: Vec3) -> None:
        """Fuse the heading of a field with a plausible horizontal strength; the tilt is not corrected by it.

        A vehicle whose heading another sensor measures ignores it.
        """
        if self._heading_by != "magnetometer":
            return
        if not self.running:
            self._alignment.on_mag(field_frd_gauss)
            return
        x, y, z = field_frd_gauss
        r = self.R_ned_from_frd
        north = r[0] * x + r[1] * y + r[2] * z
        east = r[3] * x + r[4] * y + r[5] * z
        c = self._config
        if abs(hypot(north, east) - c.field_horizontal_gauss) > MAG_CHECK_GAUSS:
            return
        self._fuse_heading(wrap_pi(c.declination_rad - atan2(east, north)))

    def _fuse_heading(self, error: float) -> None:
        """Fuse a measured heading, or reset the heading to it.

        Args:
            error: measured minus estimated heading.
        """
        c, gate = self._config, self._heading_gate
        match gate.judge(self.t_us, error, c.ekf2_head_gate_rad + 3.0 * sqrt(self.P[2, 2])):
            case "fuse":
                self._update([(2, error, c.ekf2_head_noise_rad)])
            case "reset":
                self._reset(2, (gate.error_rad,), c.ekf2_head_noise_rad)
                gate.clear()

    def on_landed(self, landed: bool) -> None:
        """Update the state of the land detector; in the air no compass resets the heading."""
        self._heading_gate.landed = landed

    # -- mathematics ---------------------------------------------------------------------------------------

    def _start(self) -> None:
        q, gyro_bias, origin, self._origin_pressure_m = self._alignment.result()
        self.q_ned_from_frd, self.gyro_bias_rps, self.origin_deg = q, gyro_bias, origin
        self.R_ned_from_frd = rotation_matrix(self.q_ned_from_frd)
        c = self._config
        std_tilt = STD_ACC_BIAS_MPS2 / self._gravity_mps2
        std = [std_tilt, std_tilt, c.ekf2_head_noise_rad, 0.1, 0.1, 0.1, 0.3, 0.3, 0.3]
        std += [STD_GYRO_BIAS_RPS] * 3 + [STD_ACC_BIAS_MPS2] * 3
        self.P = np.diag(np.square(np.array(std)))
        self._correlate_tilt_with_bias()
        self.running = True
        self._started_us = self.t_us
        self._fake_vel_due_us = self.t_us + NO_AIDING_TIMEOUT_US

    def _correlate_tilt_with_bias(self) -> None:
        """Correlate tilt and accelerometer bias, as the initial tilt was computed from biased accelerations."""
        r, g = np.array(self.R_ned_from_frd).reshape(3, 3), self._gravity_mps2
        tilt_from_bias = np.array([[0.0, 1.0 / g, 0.0], [-1.0 / g, 0.0, 0.0], [0.0, 0.0, 0.0]]) @ r
        self.P[0:3, 12:15] = tilt_from_bias @ self.P[12:15, 12:15]
        self.P[12:15, 0:3] = self.P[0:3, 12:15].T
        self.P[0:2, 0:2] += 1e-6 * np.eye(2)

    def _predict(self, dt: float, acc: Vec3, gyro: Vec3) -> None:
        """Integrate the nominal state over `dt` seconds; second order in the rotation."""
        bias, (qw, qx, qy, qz) = self.gyro_bias_rps, self.q_ned_from_frd
        wx, wy, wz = gyro[0] - bias[0], gyro[1] - bias[1], gyro[2] - bias[2]
        self.rates_frd_rps = (wx, wy, wz)
        bias = self.acc_bias_mps2
        ax, ay, az = acc[0] - bias[0], acc[1] - bias[1], acc[2] - bias[2]
        h = 0.5 * dt
        hx, hy, hz = wx * h, wy * h, wz * h
        ax, ay, az = ax + hy * az - hz * ay, ay + hz * ax - hx * az, az + hx * ay - hy * ax
        r = self.R_ned_from_frd
        fn = r[0] * ax + r[1] * ay + r[2] * az
        fe = r[3] * ax + r[4] * ay + r[5] * az
        fd = r[6] * ax + r[7] * ay + r[8] * az
        delta_vel = self._delta_vel_ned_mps
        delta_vel[0] += fn * dt
        delta_vel[1] += fe * dt
        delta_vel[2] += fd * dt
        fd += self._gravity_mps2
        self.acc_ned_mps2 = (fn, fe, fd)
        vn, ve, vd = self.vel_ned_mps
        pn, pe, pd = self.pos_ned_m
        self.pos_ned_m = (pn + (vn + h * fn) * dt, pe + (ve + h * fe) * dt, pd + (vd + h * fd) * dt)
        self.vel_ned_mps = (vn + fn * dt, ve + fe * dt, vd + fd * dt)
        n2 = hx * hx + hy * hy + hz * hz
        c, s = 1.0 - 0.5 * n2, 1.0 - n2 / 6.0
        hx, hy, hz = hx * s, hy * s, hz * s
        w = qw * c - qx * hx - qy * hy - qz * hz
        x = qx * c + qw * hx + qy * hz - qz * hy
        y = qy * c + qw * hy + qz * hx - qx * hz
        z = qz * c + qw * hz + qx * hy - qy * hx
        n = 1.0 / sqrt(w * w + x * x + y * y + z * z)
        if w < 0.0:
            n = -n
        self.q_ned_from_frd = (w * n, x * n, y * n, z * n)
        self.R_ned_from_frd = rotation_matrix(self.q_ned_from_frd)

    def _predict_covariance(self) -> None:
        """P = F P Fᵀ + Q over the time since the last call; adds the state to the history for late fixes."""
        c, dt = self._config, self._covariance_us * 1e-6
        fn, fe, fd = self._delta_vel_ned_mps
        r = np.array(self.R_ned_from_frd).reshape(3, 3) * dt
        F = IDENTITY.copy()
        F[0:3, 9:12] = F[3:6, 12:15] = -r
        F[3, 1], F[3, 2], F[4, 2] = fd, -fe, fn
        F[4, 0], F[5, 0], F[5, 1] = -fd, fe, -fn
        F[6, 3] = F[7, 4] = F[8, 5] = dt
        P = F @ self.P @ F.T
        diagonal = P.reshape(-1)[::16]
        diagonal[0:3] += GYRO_DENSITY**2 * dt
        diagonal[3:6] += ACC_DENSITY**2 * dt
        diagonal[9:12] += GYRO_BIAS_WALK**2 * dt
        diagonal[12:15] += c.acc_bias_walk**2 * dt
        self.P = 0.5 * (P + P.T)
        self._motion_heading.on_motion(self.t_us, (fn, fe, fd), self._turned_ned_rad)
        self._covariance_us = 0
        self._delta_vel_ned_mps = [0.0, 0.0, 0.0]
        d, (vn, ve, vd), (pn, pe, pd) = self._correction_sum, self.vel_ned_mps, self.pos_ned_m
        yaw = self.yaw_rad - self._turned_ned_rad[2]
        self._history.append(
            (self.t_us, (vn - d[0], ve - d[1], vd - d[2]), (pn - d[3], pe - d[4], pd - d[5]), yaw),
        )

    def _state_at(self, t_us: int) -> tuple[Vec3, Vec3]:
        """Position and velocity at a past time, with all corrections since then applied."""
        if not self._history:
            return self.pos_ned_m, self.vel_ned_mps
        then_us, v, p, _ = min(self._history, key=lambda entry: abs(entry[0] - t_us))
        d, dt = self._correction_sum, (t_us - then_us) * 1e-6
        vel = (v[0] + d[0], v[1] + d[1], v[2] + d[2])
        pos = (p[0] + d[3] + vel[0] * dt, p[1] + d[4] + vel[1] * dt, p[2] + d[5] + vel[2] * dt)
        return pos, vel

    def _yaw_at(self, t_us: int) -> float:
        """Heading at a past time, with all corrections since then applied."""
        if not self._history:
            return self.yaw_rad
        return min(self._history, key=lambda entry: abs(entry[0] - t_us))[3] + self._turned_ned_rad[2]

    def _reset(self, first: int, step: tuple[float, ...], std: float) -> None:
        """Reset error states to a sensor in one step, and remove their correlations.

        Args:
            first: index of the first error state.
            step: correction of each error state.
            std: standard deviation after the reset.
        """
        before = self.pos_ned_m
        dx = [0.0] * 15
        dx[first : first + len(step)] = step
        self._inject(dx)
        moved = slice(first, first + len(step))
        self.P[moved, :] = 0.0
        self.P[:, moved] = 0.0
        self.P[moved, moved] = std * std * np.eye(len(step))
        self.reset_offset_ned_m = add(self.reset_offset_ned_m, subtract(self.pos_ned_m, before))
        self.reset_counter += 1

    def _update(self, innovations: list[tuple[int, float, float]]) -> None:
        """Fuse measurements of single error states one after the other, then correct the nominal state.

        Args:
            innovations: (index of the error state, measured minus expected, standard deviation).
        """
        if not innovations:
            return
        P = self.P
        dx = np.zeros(15)
        for index, innovation, std in innovations:
            if not isfinite(innovation):
                continue
            column = P[:, index].copy()
            gain = column / (column[index] + std * std)
            dx += gain * (innovation - dx[index])
            P -= np.multiply.outer(column, gain)
        self._inject(dx.tolist())

    def _inject(self, dx: list[float]) -> None:
        v, p = self.vel_ned_mps, self.pos_ned_m
        self.vel_ned_mps = (v[0] + dx[3], v[1] + dx[4], v[2] + dx[5])
        self.pos_ned_m = (p[0] + dx[6], p[1] + dx[7], p[2] + dx[8])
        for i in range(6):
            self._correction_sum[i] += dx[3 + i]
        self.gyro_bias_rps = _limited(self.gyro_bias_rps, dx[9:12], GYRO_BIAS_LIMIT_RPS)
        self.acc_bias_mps2 = _limited(self.acc_bias_mps2, dx[12:15], ACC_BIAS_LIMIT_MPS2)
        turned_ned_rad = (dx[0], dx[1], dx[2])
        self._turned_ned_rad = add(self._turned_ned_rad, turned_ned_rad)
        turn = quat_from_rotation_vector(turned_ned_rad)
        self.q_ned_from_frd = quat_normalize(quat_multiply(turn, self.q_ned_from_frd))
        self.R_ned_from_frd = rotation_matrix(self.q_ned_from_frd)


def _limited(bias: Vec3, change: list[float], limit: float) -> Vec3:
    x, y, z = bias[0] + change[0], bias[1] + change[1], bias[2] + change[2]
    return (max(-limit, min(limit, x)), max(-limit, min(limit, y)), max(-limit, min(limit, z)))
