"""Extended Kalman filter on the state of `motion`, by FilterPy."""

from collections.abc import Callable
from functools import lru_cache
from math import inf, isfinite, sqrt

import msgspec
import numpy as np
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.innovations import Innovation, Observer, Sensor
from jezero.services.estimator.motion import (
    CLIMB_ROVER,
    COMPASS_BIAS,
    DOWN_ROVER,
    HEAVE_RPS,
    IDENTITY,
    LEVEL_ROVER,
    POS_ROVER,
    POS_UAV,
    SIZE,
    STD_HEAVE_M,
    UWB_BIAS,
    YAW,
    MotionModel,
)

ORIGIN = np.zeros(SIZE)


class FilterState(msgspec.Struct, frozen=True, gc=False):
    """State and covariance of the filter at one time."""

    t_ns: int
    x: Array
    P: Array


class UpdateResult(msgspec.Struct, frozen=True, gc=False):
    """Result of a measurement update.

    Attributes:
        used: number of components that passed the gate and were fused.
        offered: number of components that were tested; 0 when the measurement does not apply at present.
    """

    used: int
    offered: int


class Kalman:
    """Predicts and updates, after `restore` has set the initial state; every call of FilterPy is here.

    Attributes:
        t_ns: time of the state.
        observer: called with each innovation before its update; None for nobody.
    """

    def __init__(self, motion: MotionModel) -> None:
        from filterpy.kalman import KalmanFilter

        self._filter = KalmanFilter(dim_x=SIZE, dim_z=1)
        self._filter.inv = _make_inverse()
        self._motion = motion
        self.t_ns = 0
        self.observer: Observer | None = None

    @property
    def x(self) -> Array:
        x: Array = self._filter.x
        return x

    @property
    def P(self) -> Array:  # noqa: N802
        P: Array = self._filter.P
        return P

    def set_motion_model(self, motion: MotionModel) -> None:
        """Replace the motion model; the state stays."""
        self._motion = motion

    def save(self) -> FilterState:
        """Snapshot of the state."""
        return FilterState(self.t_ns, self.x, self.P)

    def restore(self, state: FilterState) -> None:
        """Continue from a snapshot; its covariance is made symmetric."""
        self.t_ns, self._filter.x, self._filter.P = state.t_ns, state.x, 0.5 * (state.P + state.P.T)

    def predict_to(self, t_ns: int) -> None:
        """Predict to a later time; an earlier one changes nothing."""
        if t_ns <= self.t_ns:
            return
        dt_s = (t_ns - self.t_ns) / NS_PER_S
        kf = self._filter
        x, F, Q = self._motion.step(kf.x, dt_s)
        kf.predict(F=F, Q=Q)
        kf.x = x  # the motion isn't linear: F is its Jacobian only
        self.t_ns = t_ns

    def innovation_covariance(self, H: Array, R: Array) -> Array:
        S: Array = H @ self.P @ H.T + R
        return S

    def announce(
        self,
        sensor: Sensor,
        innovation: Array,
        H: Array,
        R: Array,
        accepted: NDArray[np.bool_] | bool,
        setting: float | None = None,
    ) -> None:
        """Call the observer, if there is one; for the arguments see `Innovation` and `update`."""
        if self.observer is None:
            return
        fits = np.broadcast_to(np.asarray(accepted), innovation.shape)
        cov = self.innovation_covariance(H, R)
        self.observer(Innovation(sensor, self.t_ns, innovation, cov, R, fits, setting))

    def update(self, innovation: Array, H: Array, R: Array) -> None:
        """Measurement update, linearised at the present state.

        Args:
            innovation: (m,) measured minus expected.
            H: (m, n) Jacobian of the measurement.
            R: (m, m) covariance of the measurement.
        """
        kf = self._filter
        x, kf.x = kf.x, ORIGIN
        kf.update(innovation, R, H)
        kf.x = x + kf.x

    def reset_rover_position(self, pos_rel_m: Array, cov_m2: Array, error_jacobian: Array) -> None:
        """Reset the rover's position by a measured relative position.

        Args:
            pos_rel_m: (3,) measured position, vehicle minus rover.
            cov_m2: (3, 3) covariance of its independent error.
            error_jacobian: (3, n) derivative of its other error with respect to the state.
        """
        x = self.x.copy()
        x[POS_ROVER] = x[POS_UAV] - pos_rel_m + error_jacobian @ x
        T = IDENTITY.copy()
        T[POS_ROVER] = error_jacobian
        T[POS_ROVER, POS_UAV] += np.eye(3)
        P = T @ self.P @ T.T
        P[POS_ROVER, POS_ROVER] += cov_m2
        _level_from_height(x, P)
        self._filter.x, self._filter.P = x, P

    def reset_rover_heading(self, turn_rad: float, std_rad: float) -> None:
        """Turn the rover's heading, and take the turn as an error of its compass; both are independent of the rest."""
        x, P = self.x.copy(), self.P.copy()
        x[YAW] += turn_rad
        x[COMPASS_BIAS] -= turn_rad
        for state in (YAW, COMPASS_BIAS):
            P[state, :] = P[:, state] = 0.0
            P[state, state] = std_rad * std_rad
        self._filter.x, self._filter.P = x, P

    def reset_uwb_bias(self, std_m: float) -> None:
        """Forget the error that all UWB ranges share; it is independent of the rest then, with this deviation."""
        x, P = self.x.copy(), self.P.copy()
        x[UWB_BIAS] = 0.0
        P[UWB_BIAS, :] = P[:, UWB_BIAS] = 0.0
        P[UWB_BIAS, UWB_BIAS] = std_m * std_m
        self._filter.x, self._filter.P = x, P

    def begin_heave(self) -> None:
        """Let the platform's height and vertical speed be anything that a deck on waves may have."""
        x, P = self.x.copy(), self.P.copy()
        P[DOWN_ROVER, DOWN_ROVER] += STD_HEAVE_M**2
        P[CLIMB_ROVER, CLIMB_ROVER] += (HEAVE_RPS * STD_HEAVE_M) ** 2
        _level_from_height(x, P)
        self._filter.x, self._filter.P = x, P

    def inflate_covariance(self, states: slice, std: float) -> None:
        """Add an independent variance to some states."""
        P = self.P.copy()
        P[states, states] += std * std * np.eye(states.stop - states.start)
        self._filter.P = P

    @property
    def pos_rel_m(self) -> Array:
        """(3,) vehicle minus rover."""
        return self.x[POS_UAV] - self.x[POS_ROVER]

    @property
    def var_pos_rel_m2(self) -> tuple[float, float, float]:
        """Variance of the relative position on each axis."""
        at = self.P.item
        north = at(0, 0) + at(6, 6) - 2.0 * at(0, 6)
        east = at(1, 1) + at(7, 7) - 2.0 * at(1, 7)
        down = at(2, 2) + at(8, 8) - 2.0 * at(2, 8)
        return north, east, down

    @property
    def std_pos_rel_m(self) -> float:
        """Standard deviation of the relative position's worst axis; infinite when it is not a number."""
        variances_m2 = self.var_pos_rel_m2
        return sqrt(max(*variances_m2, 0.0)) if isfinite(sum(variances_m2)) else inf


def _level_from_height(x: Array, P: Array) -> None:
    """Set the mean height of a platform that may heave from its present height."""
    x[LEVEL_ROVER] = x[DOWN_ROVER]
    P[LEVEL_ROVER] = P[DOWN_ROVER]
    P[:, LEVEL_ROVER] = P[:, DOWN_ROVER]
    P[LEVEL_ROVER, LEVEL_ROVER] = P[DOWN_ROVER, DOWN_ROVER] + STD_HEAVE_M**2


def _make_inverse() -> Callable[[Array], Array]:
    """Inverse by LAPACK directly: the checks of numpy and scipy take five times as long for so small a matrix."""
    from scipy.linalg.lapack import dgesv

    identity = lru_cache(np.eye)

    def invert(S: Array) -> Array:
        _, _, result, failed = dgesv(S, identity(len(S)))
        if failed:
            raise np.linalg.LinAlgError("the covariance of an innovation is singular")
        inverse: Array = result
        return inverse

    return invert
