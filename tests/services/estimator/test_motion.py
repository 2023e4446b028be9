"""The motion model beside a numerical derivative and an integral of its noise, and the filter beside the textbook."""

from math import exp

import numpy as np
import pytest
from scipy.linalg import expm

from jezero.base.arrays import Array
from jezero.services.estimator.config import Tuning
from jezero.services.estimator.kalman import FilterState, Kalman
from jezero.services.estimator.motion import (
    HEAVE_DAMPING,
    HEAVE_RPS,
    PSD_CLIMB_M2PS3,
    PSD_COMPASS_BIAS_R2PS,
    PSD_HEAVE_M2PS3,
    PSD_LEVEL_M2PS,
    PSD_TAG_SCALE_PS,
    PSD_UWB_BIAS_M2PS,
    PSD_YAW_ACC_R2PS3,
    SIZE,
    STD_COMPASS_BIAS_RAD,
    STD_HEAVE_M,
    TAU_ATTITUDE_S,
    TAU_CLIMB_S,
    YAW_RATE,
    MotionModel,
    heave_acc_mps2,
    initial_state,
)

TUNING = Tuning()
MODEL = MotionModel(TUNING)


def a_state(seed: int) -> tuple[Array, Array]:
    """A state, and a covariance in which all errors depend on each other."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(SIZE, SIZE))
    return rng.normal(size=SIZE), root @ root.T / SIZE


@pytest.mark.parametrize("dt_s", [0.004, 0.02, 0.5])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_jacobian_of_a_step_is_its_derivative(seed: int, dt_s: float) -> None:
    x, _ = a_state(seed)
    after, F, _ = MODEL.step(x, dt_s)
    small = 1e-6 * np.eye(SIZE)
    derivative = [(MODEL.step(x + each, dt_s)[0] - MODEL.step(x - each, dt_s)[0]) / 2e-6 for each in small]
    assert pytest.approx(np.array(derivative).T, abs=1e-7) == F
    assert after[:9] == pytest.approx(np.concatenate((x[:3] + dt_s * x[3:6], x[3:6], x[6:9] + dt_s * x[9:12])))
    turned = (x[9] + 1j * x[10]) * np.exp(1j * dt_s * x[YAW_RATE])
    assert after[9:14] == pytest.approx(
        (turned.real, turned.imag, x[11] * exp(-dt_s / TAU_CLIMB_S), x[12] + dt_s * x[13], x[13])
    )
    assert after[14:17] == pytest.approx(x[14:17] * exp(-dt_s / TUNING.tau_vel_uav_s))
    assert after[17:20] == pytest.approx(x[17:20] * exp(-dt_s / TAU_ATTITUDE_S))
    assert after[20:] == pytest.approx(x[20:])


def test_the_process_noise_is_the_integral_of_its_densities() -> None:
    """The integral is found by a matrix exponential, for a step much shorter than all time constants.

    Source: Van Loan (1978).
    """
    dt_s = 0.02
    drift, density = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    for pos, vel in ((0, 3), (1, 4), (2, 5), (6, 9), (7, 10), (8, 11), (12, 13)):
        drift[pos, vel] = 1.0
    density[3:6] = TUNING.psd_acc_uav_m2ps3
    density[9:12] = TUNING.psd_acc_rover_m2ps3, TUNING.psd_acc_rover_m2ps3, PSD_CLIMB_M2PS3
    density[13] = PSD_YAW_ACC_R2PS3
    density[14:17] = 2.0 * TUNING.std_vel_uav_mps**2 / TUNING.tau_vel_uav_s
    density[17:19] = 2.0 * TUNING.std_tilt_rad**2 / TAU_ATTITUDE_S
    density[19] = 2.0 * TUNING.std_heading_rad**2 / TAU_ATTITUDE_S
    density[20:23] = PSD_UWB_BIAS_M2PS, PSD_TAG_SCALE_PS, PSD_COMPASS_BIAS_R2PS
    blocks = np.block([[-drift, np.diag(density)], [np.zeros((SIZE, SIZE)), drift.T]])
    solved = expm(blocks * dt_s)
    expected = solved[SIZE:, SIZE:].T @ solved[:SIZE, SIZE:]
    assert pytest.approx(expected, rel=1e-9, abs=1e-18) == MODEL.step(np.zeros(SIZE), dt_s)[2]


def test_the_first_state_is_at_the_vehicle_and_knows_what_it_does_not_know() -> None:
    x, P = initial_state(np.array((1.0, 2.0, 3.0)), TUNING)
    assert x == pytest.approx(np.array((1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, *(0.0,) * 14, 3.0)))
    stds = [1.0] * 3 + [10.0] * 3 + [1e3] * 3 + [2.0] * 3 + [4.0, 1.0] + [TUNING.std_vel_uav_mps] * 3
    stds += [TUNING.std_tilt_rad, TUNING.std_tilt_rad, TUNING.std_heading_rad]
    stds += [TUNING.std_uwb_bias_m, TUNING.std_tag_scale, STD_COMPASS_BIAS_RAD, 1e3]
    assert pytest.approx(np.diag(np.square(stds))) == P


@pytest.mark.parametrize("dt_s", [0.02, 0.5])
def test_a_heaving_platform_is_a_damped_oscillator_about_its_mean_height(dt_s: float) -> None:
    """Compared with the matrix exponential of the differential equation."""
    x, _ = a_state(8)
    drift = np.zeros((3, 3))  # height, vertical speed, mean height
    drift[0, 1] = 1.0
    drift[1] = -(HEAVE_RPS**2), -2.0 * HEAVE_DAMPING * HEAVE_RPS, HEAVE_RPS**2
    states = [8, 11, 23]
    after, F, Q = MotionModel(TUNING, heaves=True).step(x, dt_s)
    assert after[states] == pytest.approx(expm(drift * dt_s) @ x[states])
    assert F[np.ix_(states, states)] == pytest.approx(expm(drift * dt_s))
    assert heave_acc_mps2(x) == pytest.approx((drift @ x[states])[1])
    still = MODEL.step(x, dt_s)
    others = np.setdiff1d(np.arange(SIZE), states)
    assert after[others] == pytest.approx(still[0][others])
    assert Q[11, 11] == pytest.approx(PSD_HEAVE_M2PS3 * dt_s) and Q[23, 23] == pytest.approx(PSD_LEVEL_M2PS * dt_s)


def test_the_heave_of_a_deck_that_is_not_measured_has_its_standard_deviation_and_no_more() -> None:
    kalman = Kalman(MotionModel(TUNING, heaves=True))
    x, P = initial_state(np.zeros(3), TUNING)
    P[6:9] = P[:, 6:9] = P[23] = P[:, 23] = 0.0
    kalman.restore(FilterState(0, x, P))
    for step in range(1, 3000):
        kalman.predict_to(step * 20_000_000)
    below_level = np.zeros(SIZE)
    below_level[8], below_level[23] = 1.0, -1.0
    assert float(below_level @ kalman.P @ below_level) ** 0.5 == pytest.approx(STD_HEAVE_M, rel=0.1)


def a_kalman(seed: int) -> Kalman:
    kalman = Kalman(MODEL)
    kalman.restore(FilterState(1_000, *a_state(seed)))
    return kalman


def test_a_prediction_and_an_update_are_those_of_the_textbook() -> None:
    kalman, (x, P) = a_kalman(3), a_state(3)
    kalman.predict_to(20_001_000)
    after, F, Q = MODEL.step(x, 0.02)
    predicted = F @ P @ F.T + Q
    assert kalman.t_ns == 20_001_000
    assert kalman.x == pytest.approx(after) and pytest.approx(predicted) == kalman.P
    kalman.predict_to(1_000)
    assert kalman.t_ns == 20_001_000 and kalman.x == pytest.approx(after)

    rng = np.random.default_rng(4)
    innovation, H, R = rng.normal(size=3), rng.normal(size=(3, SIZE)), np.diag((0.1, 0.2, 0.3))
    S = H @ predicted @ H.T + R
    assert kalman.innovation_covariance(H, R) == pytest.approx(S)
    kalman.update(innovation, H, R)
    gain = np.linalg.solve(S, H @ predicted).T
    assert kalman.x == pytest.approx(after + gain @ innovation)
    assert pytest.approx(predicted - gain @ S @ gain.T, abs=1e-9) == kalman.P


def test_a_reset_rover_position_is_the_vehicles_minus_the_measured_one_with_the_errors_of_both() -> None:
    kalman, (x, P) = a_kalman(5), a_state(5)
    rng = np.random.default_rng(6)
    measured, jacobian, cov = np.array((1.0, -2.0, -3.0)), rng.normal(size=(3, SIZE)), np.diag((0.1, 0.2, 0.3))
    kalman.reset_rover_position(measured, cov, jacobian)

    def reset(state: Array) -> Array:
        rover_m = state[:3] - measured + jacobian @ state
        return np.concatenate((state[:6], rover_m, state[9:23], rover_m[2:]))

    T = np.array([reset(each) - reset(np.zeros(SIZE)) for each in np.eye(SIZE)]).T
    expected = T @ P @ T.T
    expected[6:9, 6:9] += cov
    expected[8, 23] = expected[23, 8] = expected[8, 8]
    expected[23, 23] = expected[8, 8] + STD_HEAVE_M**2
    assert kalman.x == pytest.approx(reset(x))
    assert pytest.approx(expected, abs=1e-9) == kalman.P


def test_a_turned_heading_and_an_inflated_covariance_change_their_states_alone() -> None:
    kalman, (x, P) = a_kalman(7), a_state(7)
    kalman.reset_rover_heading(0.3, 0.2)
    assert kalman.x[12] == pytest.approx(x[12] + 0.3) and kalman.x[22] == pytest.approx(x[22] - 0.3)
    assert [kalman.P[12, 12], kalman.P[22, 22], kalman.P[12, 22]] == pytest.approx([0.04, 0.04, 0.0])
    others = np.delete(np.arange(SIZE), (12, 22))
    assert not kalman.P[[12, 22]][:, others].any() and not kalman.P[others][:, [12, 22]].any()
    assert kalman.P[np.ix_(others, others)] == pytest.approx(P[np.ix_(others, others)])
    before = kalman.P.copy()
    kalman.inflate_covariance(slice(14, 17), 0.5)
    assert kalman.P - before == pytest.approx(np.diag([0.25 if 14 <= i < 17 else 0.0 for i in range(SIZE)]))


def test_the_relative_position_has_the_variance_of_a_difference() -> None:
    kalman, (x, P) = a_kalman(8), a_state(8)
    difference = np.zeros((3, SIZE))
    difference[:, :3], difference[:, 6:9] = np.eye(3), -np.eye(3)
    variances = np.diag(difference @ P @ difference.T)
    assert kalman.pos_rel_m == pytest.approx(difference @ x)
    assert kalman.var_pos_rel_m2 == pytest.approx(tuple(variances))
    assert kalman.std_pos_rel_m == pytest.approx(np.sqrt(variances.max()))
    kalman.restore(FilterState(0, x, np.full((SIZE, SIZE), np.nan)))
    assert kalman.std_pos_rel_m == np.inf
