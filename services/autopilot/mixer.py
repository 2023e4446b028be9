"""From collective thrust and torques to rotor commands."""

import numpy as np

from jezero.frames import Vec3
from jezero.services.autopilot.config import Airframe

Commands = tuple[float, float, float, float]
"""One per rotor, 0 to 1."""

STOPPED: Commands = (0.0, 0.0, 0.0, 0.0)


class Mixer:
    """Inverts the rotors' geometry.

    With rotor i at (x, y) and thrust f upwards: roll torque -y f, pitch torque x f, yaw torque km f. When the rotors
    can't do everything, yaw gives way first, then collective thrust, then roll and pitch.
    """

    def __init__(self, airframe: Airframe) -> None:
        full_n = airframe.mass_kg * airframe.gravity_mps2 / airframe.mpc_thr_hover
        self.thrust_full_n = full_n
        self._rotor_full_n = full_n / 4.0
        rows = [[1.0, -r.y_frd_m, r.x_frd_m, r.km_m] for r in airframe.rotors]
        inverse = np.linalg.inv(np.array(rows).T)
        self._inverse = [tuple(float(v) for v in row) for row in inverse]

    def commands(self, thrust_n: float, torque_frd_nm: Vec3) -> Commands:
        """Rotor commands for a thrust along the body's up axis and (3,) torques."""
        tx, ty, tz = torque_frd_nm
        full = self._rotor_full_n
        level = [row[0] * thrust_n for row in self._inverse]
        turn = [row[1] * tx + row[2] * ty for row in self._inverse]
        yaw = [row[3] * tz for row in self._inverse]
        share = 1.0
        for base, extra in zip(level, turn, strict=True):
            if base + extra < 0.0:
                share = min(share, max(0.0, base) / -extra)
        wanted = [base + share * extra for base, extra in zip(level, turn, strict=True)]
        excess = max(wanted) - full
        if excess > 0.0:
            wanted = [f - excess for f in wanted]
        share = 1.0
        for base, extra in zip(wanted, yaw, strict=True):
            if base + extra < 0.0:
                share = min(share, max(0.0, base) / -extra)
            elif base + extra > full:
                share = min(share, (full - base) / extra)
        f1, f2, f3, f4 = (
            max(0.0, min(1.0, (base + share * extra) / full)) for base, extra in zip(wanted, yaw, strict=True)
        )
        return (f1, f2, f3, f4)
