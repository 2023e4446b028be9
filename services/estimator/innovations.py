"""Innovations of the filter, for those who judge its noise settings."""

from collections.abc import Callable
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from jezero.base.arrays import Array

Sensor = Literal[
    "uwb",
    "tag",
    "tag_yaw",
    "altimeter",
    "rover_yaw",
    "rover_yaw_rate",
    "rover_speed",
    "autopilot_position",
    "autopilot_velocity",
]
"""Sources of innovations: parts of a message that the filter tests and weighs each by itself."""


class Innovation(msgspec.Struct, frozen=True, gc=False):
    """Difference between a measurement and what the filter expects, and the spread that the filter predicts for it.

    The unit is that of the measurement: m, m/s, rad or rad/s.

    Attributes:
        sensor: source of the measurement.
        t_ns: vehicle time of the measurement.
        residual: (m,) measured minus expected.
        cov: (m, m) predicted covariance of `residual`, H P Hᵀ + R.
        cov_noise: (m, m) the part R of `cov`: the measurement noise in force.
        accepted: (m,) whether each component passes the gate.
        setting: value in use of the setting to whose square `cov_noise` is proportional; None where no setting changes
            the noise.
    """

    sensor: Sensor
    t_ns: int
    residual: Array
    cov: Array
    cov_noise: Array
    accepted: NDArray[np.bool_]
    setting: float | None = None


Observer = Callable[[Innovation], None]
"""Called with each innovation. A measurement that is fused again, because an older one came late, gives another
innovation with the same sensor and time, which replaces the former."""
