"""Mean wind and Dryden gusts at low altitude.

Source: MIL-F-8785C, Dryden form, altitudes below 1000 ft. The gust field is carried past the vehicle at the mean wind's
speed; its filters are discretised exactly, so the variance is right at any step.
"""

from math import cos, exp, radians, sin, sqrt

from jezero.base.frames import Vec3
from jezero.services.simulator.config import WindConfig
from jezero.services.simulator.noise import Normals

FEET_PER_M = 3.28084
HEIGHT_MIN_M = 3.0
HEIGHT_MAX_M = 300.0
CARRY_MIN_MPS = 2.0
HEIGHT_STEP_M = 0.5


def dryden_scales(height_m: float) -> tuple[float, float, float]:
    """Scale lengths and the vertical gusts' share at a height above ground.

    Returns:
        length_horizontal_m, length_vertical_m, and sigma_w / sigma_u.
    """
    feet = FEET_PER_M * min(max(height_m, HEIGHT_MIN_M), HEIGHT_MAX_M)
    base: float = 0.177 + 0.000823 * feet
    return feet / base**1.2 / FEET_PER_M, feet / FEET_PER_M, base**0.4


class _Longitudinal:
    """Unit-variance output of 1 / (1 + tau s) driven by white noise."""

    def __init__(self, tau_s: float, dt_s: float, normals: Normals) -> None:
        self.value = normals()
        self._normals = normals
        self._dt_s = dt_s
        self.retune(tau_s)

    def retune(self, tau_s: float) -> None:
        self._keep = exp(-self._dt_s / tau_s)
        self._std = sqrt(1.0 - self._keep * self._keep)

    def step(self) -> float:
        self.value = self._keep * self.value + self._std * self._normals()
        return self.value


class _Transverse:
    """Unit-variance output of (1 + sqrt(3) tau s) / (1 + tau s)^2 driven by white noise.

    State (x, tau x') of the double pole, scaled so that both have the variance 1 and the output is
    (x + sqrt(3) tau x') / 2. With u = dt / tau the transition is e^-u [[1 + u, u], [-u, 1 - u]]; the noise's covariance
    keeps the stationary covariance, the identity.
    """

    def __init__(self, tau_s: float, dt_s: float, normals: Normals) -> None:
        self._x, self._dx = normals(), normals()
        self._normals = normals
        self._dt_s = dt_s
        self.retune(tau_s)

    def retune(self, tau_s: float) -> None:
        u = self._dt_s / tau_s
        decay = exp(-u)
        a, b, c, d = decay * (1.0 + u), decay * u, -decay * u, decay * (1.0 - u)
        self._phi = (a, b, c, d)
        q11, q12, q22 = 1.0 - a * a - b * b, -a * c - b * d, 1.0 - c * c - d * d
        l22 = sqrt(max(q22, 0.0))
        l12 = q12 / l22 if l22 > 0.0 else 0.0
        self._std = (sqrt(max(q11 - l12 * l12, 0.0)), l12, l22)

    def step(self) -> float:
        a, b, c, d = self._phi
        l11, l12, l22 = self._std
        n1, n2 = self._normals(), self._normals()
        x, dx = self._x, self._dx
        self._x = a * x + b * dx + l11 * n1 + l12 * n2
        self._dx = c * x + d * dx + l22 * n2
        return 0.5 * self._x + 0.8660254037844386 * self._dx


class WindModel:
    """Wind at the vehicle, advanced by one step at a time.

    Args:
        dt_s: duration of a step.
        normals: stream of random numbers.

    Attributes:
        mean_mps: speed of the mean wind.
        from_deg: direction from which it blows, clockwise from north.
        std_gust_mps: standard deviation of each horizontal component of the gusts.
        vel_ned_mps: velocity of the air.
    """

    def __init__(self, config: WindConfig, dt_s: float, normals: Normals) -> None:
        self.std_gust_mps = config.std_gust_mps
        self._set_mean(config.mean_mps, config.from_deg)
        horizontal_m, vertical_m, self._share_down = dryden_scales(0.0)
        self._height_m = 0.0
        self._u = _Longitudinal(horizontal_m / self._carry_mps, dt_s, normals)
        self._v = _Transverse(horizontal_m / self._carry_mps, dt_s, normals)
        self._w = _Transverse(vertical_m / self._carry_mps, dt_s, normals)
        self.vel_ned_mps: Vec3 = self._combine(0.0, 0.0, 0.0)

    def change(self, mean_mps: float, from_deg: float, std_gust_mps: float | None = None) -> None:
        """Change the mean wind from now on, and the gusts unless they are None."""
        self._set_mean(mean_mps, from_deg)
        if std_gust_mps is not None:
            self.std_gust_mps = std_gust_mps
        self._retune(self._height_m)
        if self.std_gust_mps == 0.0:
            self.vel_ned_mps = self._combine(0.0, 0.0, 0.0)

    def step(self, height_m: float) -> Vec3:
        """Advance by one step; `vel_ned_mps` is the velocity of the air.

        Args:
            height_m: height of the vehicle above ground.
        """
        if self.std_gust_mps == 0.0:
            return self.vel_ned_mps
        if abs(height_m - self._height_m) > HEIGHT_STEP_M:
            self._retune(height_m)
        self.vel_ned_mps = self._combine(self._u.step(), self._v.step(), self._w.step())
        return self.vel_ned_mps

    def _set_mean(self, mean_mps: float, from_deg: float) -> None:
        self.from_deg = from_deg
        towards_rad = radians(from_deg + 180.0)
        self._along = (cos(towards_rad), sin(towards_rad))
        self.mean_mps = mean_mps
        self._carry_mps = max(mean_mps, CARRY_MIN_MPS)

    def _retune(self, height_m: float) -> None:
        self._height_m = height_m
        horizontal_m, vertical_m, self._share_down = dryden_scales(height_m)
        self._u.retune(horizontal_m / self._carry_mps)
        self._v.retune(horizontal_m / self._carry_mps)
        self._w.retune(vertical_m / self._carry_mps)

    def _combine(self, u: float, v: float, w: float) -> Vec3:
        """Mean wind and unit gusts along, across and down."""
        c, s = self._along
        along_mps = self.mean_mps + self.std_gust_mps * u
        across_mps = self.std_gust_mps * v
        return (
            c * along_mps - s * across_mps,
            s * along_mps + c * across_mps,
            self.std_gust_mps * self._share_down * w,
        )
