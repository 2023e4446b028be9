"""The mixer: from collective thrust and torques to rotor commands."""

from math import inf

import numpy as np

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig

Commands = tuple[float, float, float, float]
"""One per rotor, 0 to 1."""

STOPPED: Commands = (0.0, 0.0, 0.0, 0.0)
IDLE: Commands = (0.05, 0.05, 0.05, 0.05)
"""Commands while armed on the ground."""


class Mixer:
    """Inverts the geometry of the rotors.

    With rotor i at (x, y) and thrust f upwards: roll torque -y f, pitch torque x f, yaw torque km f. When the rotors
    saturate, yaw torque is reduced first, then collective thrust, then roll and pitch torque.

    Args:
        hover: hover thrust as a fraction of full thrust.
    """

    def __init__(self, vehicle: VehicleConfig, hover: float) -> None:
        airframe = vehicle.airframe
        full_n = vehicle.weight_n / hover
        self.thrust_full_n = full_n
        self._rotor_full_n = full_n / 4.0
        rotors = zip(airframe.pos_rotors_frd_m, airframe.moment_per_thrust_m, strict=True)
        rows = [[1.0, -y_m, x_m, km_m] for (x_m, y_m), km_m in rotors]
        inverse = np.linalg.inv(np.array(rows).T)
        self._inverse: list[list[float]] = inverse.tolist()

    def commands(self, thrust_n: float, torque_frd_nm: Vec3) -> Commands:
        """Rotor commands for a thrust along the body's up axis and (3,) torques."""
        tx, ty, tz = torque_frd_nm
        full = self._rotor_full_n
        (a1, b1, c1, d1), (a2, b2, c2, d2), (a3, b3, c3, d3), (a4, b4, c4, d4) = self._inverse
        level = (a1 * thrust_n, a2 * thrust_n, a3 * thrust_n, a4 * thrust_n)
        turn = (b1 * tx + c1 * ty, b2 * tx + c2 * ty, b3 * tx + c3 * ty, b4 * tx + c4 * ty)
        forces = _add_within_limits(level, turn, inf)
        lower = max(0.0, max(forces) - full)
        forces = (forces[0] - lower, forces[1] - lower, forces[2] - lower, forces[3] - lower)
        forces = _add_within_limits(forces, (d1 * tz, d2 * tz, d3 * tz, d4 * tz), full)
        f1, f2, f3, f4 = forces
        return (_clipped_ratio(f1, full), _clipped_ratio(f2, full), _clipped_ratio(f3, full), _clipped_ratio(f4, full))


def _clipped_ratio(force_n: float, full_n: float) -> float:
    return max(0.0, min(1.0, force_n / full_n))


def _add_within_limits(base: Commands, extra: Commands, limit: float) -> Commands:
    """`base` plus the largest fraction of `extra` that keeps every rotor between 0 and `limit`."""
    b1, b2, b3, b4 = base
    e1, e2, e3, e4 = extra
    whole = (b1 + e1, b2 + e2, b3 + e3, b4 + e4)
    if min(whole) >= 0.0 and max(whole) <= limit:
        return whole
    fraction = 1.0
    for b, e in zip(base, extra, strict=True):
        if e < 0.0 and b + e < 0.0:
            fraction = min(fraction, max(0.0, b) / -e)
        elif e > 0.0 and b + e > limit:
            fraction = min(fraction, max(0.0, limit - b) / e)
    return (b1 + fraction * e1, b2 + fraction * e2, b3 + fraction * e3, b4 + fraction * e4)
