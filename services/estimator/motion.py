"""State vector and motion model of the filter.

| index   | state                                                              | unit  |
|---------|--------------------------------------------------------------------|-------|
| 0 – 2   | position of the vehicle, world NED without the autopilot's resets  | m     |
| 3 – 5   | velocity of the vehicle over ground, NED                           | m/s   |
| 6 – 8   | position of the platform, as the vehicle's                         | m     |
| 9 – 11  | velocity of the platform over ground, NED                          | m/s   |
| 12      | yaw of the rover                                                   | rad   |
| 13      | yaw rate of the rover                                              | rad/s |
| 14 – 16 | error of the autopilot's velocity, NED                             | m/s   |
| 17 – 19 | error of the autopilot's attitude, forward, right and down of its heading | rad |
| 20      | error that all UWB ranges share                                    | m     |
| 21      | relative error of distances by the tag, as from tags printed in another size | –     |
| 22      | error of the rover's compass                                       | rad   |
| 23      | mean height of a platform that heaves, positive down               | m     |

Source: thesis §4.2, extended by the errors of the autopilot's velocity and attitude, which limit the accuracy
at height, by the constant errors of UWB, tag and compass, which would make these inputs contradict each other, and by
the heave of a deck on waves: an oscillator about the mean height, driven by white noise.
"""

from functools import lru_cache
from math import cos, exp, pi, sin, sqrt

import numpy as np

from jezero.base.arrays import Array
from jezero.services.estimator.config import Tuning

SIZE = 24
POS_UAV, VEL_UAV, POS_ROVER, VEL_ROVER = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
YAW, YAW_RATE = 12, 13
VEL_ERROR, ATTITUDE_ERROR = slice(14, 17), slice(17, 20)
ROLL_ERROR, PITCH_ERROR, HEADING_ERROR = 17, 18, 19
UWB_BIAS, TAG_SCALE, COMPASS_BIAS = 20, 21, 22
DOWN_ROVER, CLIMB_ROVER, LEVEL_ROVER = 8, 11, 23

TAU_ATTITUDE_S = 100.0
TAU_CLIMB_S = 1.0
PSD_YAW_ACC_R2PS3 = 0.02
PSD_CLIMB_M2PS3 = 0.02
"""Process noise of the platform's vertical acceleration on uneven ground."""
HEAVE_RPS, HEAVE_DAMPING, STD_HEAVE_M = 2.0 * pi / 6.0, 0.3, 0.35
"""Angular frequency, damping ratio and standard deviation of a deck's heave. The heave is measured many times in a
wave, so that waves of other periods and heights are followed as well."""
PSD_HEAVE_M2PS3 = 4.0 * HEAVE_DAMPING * HEAVE_RPS**3 * STD_HEAVE_M**2
PSD_LEVEL_M2PS = 0.003
"""Process noise of the mean height, of a rover that drives uphill or downhill and of the autopilot's own height."""
STD_COMPASS_BIAS_RAD = 0.02
PSD_UWB_BIAS_M2PS, PSD_TAG_SCALE_PS, PSD_COMPASS_BIAS_R2PS = 1e-6, 4e-8, 1e-6
"""Constant errors may change by 1 cm, 0.2 % and 0.01 rad in 100 s, so that the filter never stops correcting them."""
STD_UNKNOWN_M = 1e3
STD_UNKNOWN_MPS = 2.0
IDENTITY = np.eye(SIZE)


def initial_state(pos_uav_m: Array, tuning: Tuning) -> tuple[Array, Array]:
    """State and covariance for a vehicle at a known position and a rover at an unknown one."""
    x = np.zeros(SIZE)
    x[POS_UAV] = pos_uav_m
    x[POS_ROVER] = pos_uav_m
    std = np.empty(SIZE)
    std[POS_UAV], std[VEL_UAV] = 1.0, 10.0
    std[POS_ROVER], std[VEL_ROVER] = STD_UNKNOWN_M, STD_UNKNOWN_MPS
    std[YAW], std[YAW_RATE] = 4.0, 1.0
    std[LEVEL_ROVER] = STD_UNKNOWN_M
    x[LEVEL_ROVER] = pos_uav_m[2]
    std[VEL_ERROR] = tuning.std_vel_uav_mps
    std[ATTITUDE_ERROR] = tuning.std_tilt_rad, tuning.std_tilt_rad, tuning.std_heading_rad
    std[UWB_BIAS], std[TAG_SCALE], std[COMPASS_BIAS] = tuning.std_uwb_bias_m, tuning.std_tag_scale, STD_COMPASS_BIAS_RAD
    return x, np.diag(std * std)


class MotionModel:
    """Constant velocity, with the rover turning at its yaw rate; the errors are first-order Gauss–Markov processes.

    The process noise of a step is a cubic in its length, with constant coefficients. Matrices that depend on the
    length alone are cached, as most steps have one of a few lengths.

    Args:
        heaves: whether the platform heaves; otherwise its vertical speed decays, as on the ground.
    """

    def __init__(self, tuning: Tuning, *, heaves: bool = False) -> None:
        self._heaves = heaves
        self._tau_vel_s = tuning.tau_vel_uav_s
        linear, square, cubic = (np.zeros((SIZE, SIZE)) for _ in range(3))
        for axis in range(3):
            psd_vertical = PSD_HEAVE_M2PS3 if heaves else PSD_CLIMB_M2PS3
            psd_rover = tuning.psd_acc_rover_m2ps3 if axis < 2 else psd_vertical
            for pos, vel, psd in ((axis, 3 + axis, tuning.psd_acc_uav_m2ps3), (6 + axis, 9 + axis, psd_rover)):
                _add_white_acceleration(pos, vel, psd, linear, square, cubic)
        _add_white_acceleration(YAW, YAW_RATE, PSD_YAW_ACC_R2PS3, linear, square, cubic)
        stds = (tuning.std_tilt_rad, tuning.std_tilt_rad, tuning.std_heading_rad)
        for i in range(3):
            linear[14 + i, 14 + i] = 2.0 * tuning.std_vel_uav_mps**2 / tuning.tau_vel_uav_s
            linear[17 + i, 17 + i] = 2.0 * stds[i] ** 2 / TAU_ATTITUDE_S
        linear[UWB_BIAS, UWB_BIAS], linear[TAG_SCALE, TAG_SCALE] = PSD_UWB_BIAS_M2PS, PSD_TAG_SCALE_PS
        linear[COMPASS_BIAS, COMPASS_BIAS] = PSD_COMPASS_BIAS_R2PS
        linear[LEVEL_ROVER, LEVEL_ROVER] = PSD_LEVEL_M2PS if heaves else 0.0
        self._linear, self._square, self._cubic = linear, square, cubic
        self._discretize = lru_cache(maxsize=256)(self._discretize_uncached)

    def _discretize_uncached(self, dt_s: float) -> tuple[Array, Array]:
        """Jacobian of a step without the rover's turn, and its process noise covariance."""
        F = IDENTITY.copy()
        F[0, 3] = F[1, 4] = F[2, 5] = F[6, 9] = F[7, 10] = F[DOWN_ROVER, CLIMB_ROVER] = F[YAW, YAW_RATE] = dt_s
        if self._heaves:
            self._oscillate(F, dt_s)
        else:
            F[CLIMB_ROVER, CLIMB_ROVER] = exp(-dt_s / TAU_CLIMB_S)
        F[14, 14] = F[15, 15] = F[16, 16] = exp(-dt_s / self._tau_vel_s)
        F[17, 17] = F[18, 18] = F[19, 19] = exp(-dt_s / TAU_ATTITUDE_S)
        return F, self._linear * dt_s + self._square * (dt_s * dt_s) + self._cubic * (dt_s * dt_s * dt_s)

    def _oscillate(self, F: Array, dt_s: float) -> None:
        """Set the part of a heaving platform: height and vertical speed, relative to the mean height."""
        damped_rps, decay_1ps = HEAVE_RPS * sqrt(1.0 - HEAVE_DAMPING**2), HEAVE_DAMPING * HEAVE_RPS
        c, s = cos(damped_rps * dt_s), sin(damped_rps * dt_s) / damped_rps
        decay = exp(-decay_1ps * dt_s)
        keep, later = decay * (c + decay_1ps * s), decay * s
        back = -decay * HEAVE_RPS**2 * s
        down, climb, level = DOWN_ROVER, CLIMB_ROVER, LEVEL_ROVER
        F[down, down], F[down, climb], F[down, level] = keep, later, 1.0 - keep
        F[climb, down], F[climb, climb], F[climb, level] = back, decay * (c - decay_1ps * s), -back

    def step(self, x: Array, dt_s: float) -> tuple[Array, Array, Array]:
        """State after `dt_s`, its Jacobian, and the process noise covariance, which callers must not modify."""
        F_without_turn, Q = self._discretize(dt_s)
        F = F_without_turn.copy()
        turn = float(x[YAW_RATE]) * dt_s
        c, s = cos(turn), sin(turn)
        F[9, 9] = F[10, 10] = c
        F[9, 10], F[10, 9] = -s, s
        after = F @ x
        F[9, YAW_RATE], F[10, YAW_RATE] = -dt_s * after[10], dt_s * after[9]
        return after, F, Q


def heave_acc_mps2(x: Array) -> float:
    """Vertical acceleration of a platform that heaves, positive down."""
    below_m, climb_mps = float(x[DOWN_ROVER] - x[LEVEL_ROVER]), float(x[CLIMB_ROVER])
    return -(HEAVE_RPS**2) * below_m - 2.0 * HEAVE_DAMPING * HEAVE_RPS * climb_mps


def _add_white_acceleration(pos: int, vel: int, psd: float, linear: Array, square: Array, cubic: Array) -> None:
    """Add the process noise of a white acceleration with density `psd` to the coefficients of position and velocity."""
    linear[vel, vel] = psd
    square[pos, vel] = square[vel, pos] = psd / 2.0
    cubic[pos, pos] = psd / 3.0
