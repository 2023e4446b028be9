"""Model of the battery: charge, current, voltage."""

from math import sqrt

from jezero.base.vehicle_config import BatteryConfig
from jezero.services.autopilot.mixer import Commands


class BatteryModel:
    """Battery that the rotors and the electronics discharge: its voltage falls with the charge and the current.

    Args:
        charge_at_start: fraction of the capacity.
        hover: command of each rotor in hover.

    Attributes:
        current_a: present current.
        used_mah: charge drawn since the start.
    """

    def __init__(self, config: BatteryConfig, charge_at_start: float, hover: float) -> None:
        self._config = config
        self._full_a = config.hover_a / (4.0 * hover**1.5)
        self._start_mah = config.capacity_mah * charge_at_start
        self.current_a = 0.0
        self.used_mah = 0.0

    def configure(self, config: BatteryConfig) -> None:
        """Apply new settings; the charge stays the same."""
        self._config = config

    def swap(self) -> None:
        """Put in a full battery."""
        self._start_mah = self._config.capacity_mah
        self.used_mah = 0.0

    def step(self, dt: float, commands: Commands) -> None:
        """Discharge for `dt` seconds. The power of a rotor is proportional to its thrust to the power of 3/2."""
        f1, f2, f3, f4 = commands
        rotors = f1 * sqrt(f1) + f2 * sqrt(f2) + f3 * sqrt(f3) + f4 * sqrt(f4)
        self.current_a = self._config.electronics_a + self._full_a * rotors
        self.used_mah += self.current_a * dt / 3.6

    @property
    def remaining(self) -> float:
        """Remaining fraction of the capacity, 0 to 1."""
        return max(0.0, (self._start_mah - self.used_mah) / self._config.capacity_mah)

    @property
    def voltage_v(self) -> float:
        c = self._config
        cell_v = c.empty_v + (c.full_v - c.empty_v) * self.remaining
        return c.cells * (cell_v - c.internal_ohm * self.current_a)
