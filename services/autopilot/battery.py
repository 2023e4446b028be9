"""Model of the battery: charge, current, voltage."""

from math import sqrt

from jezero.services.autopilot.config import Airframe, BatteryConfig
from jezero.services.autopilot.mixer import Commands


class Battery:
    """Battery that the rotors and the electronics discharge.

    Attributes:
        current_a: present current.
        used_mah: charge drawn since the start.
    """

    def __init__(self, config: BatteryConfig, airframe: Airframe) -> None:
        self._config = config
        self._full_a = config.hover_a / (4.0 * airframe.mpc_thr_hover**1.5)
        self._start_mah = config.bat1_capacity_mah * config.charge_at_start
        self.current_a = 0.0
        self.used_mah = 0.0

    def configure(self, config: BatteryConfig) -> None:
        """Apply new settings; the charge stays the same."""
        self._config = config

    def step(self, dt: float, commands: Commands) -> None:
        """Discharge for `dt` seconds. The power of a rotor is proportional to its thrust to the power of 3/2."""
        f1, f2, f3, f4 = commands
        rotors = f1 * sqrt(f1) + f2 * sqrt(f2) + f3 * sqrt(f3) + f4 * sqrt(f4)
        self.current_a = self._config.electronics_a + self._full_a * rotors
        self.used_mah += self.current_a * dt / 3.6

    @property
    def remaining(self) -> float:
        """Remaining fraction of the capacity, 0 to 1."""
        return max(0.0, (self._start_mah - self.used_mah) / self._config.bat1_capacity_mah)

    @property
    def voltage_v(self) -> float:
        c = self._config
        cell_v = c.bat1_v_empty_v + (c.bat1_v_charged_v - c.bat1_v_empty_v) * self.remaining
        return c.bat1_n_cells * (cell_v - c.bat1_r_internal_ohm * self.current_a)
