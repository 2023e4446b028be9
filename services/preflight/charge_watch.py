"""Detects in flight that the reported charge of the battery stands still."""

from collections import deque

from jezero.base.vehicle_config import BatteryConfig
from jezero.schemas.state import Status
from jezero.schemas.units import NS_PER_S

PERIOD_NS = NS_PER_S
LEAST_FALL = 0.06
"""Fraction of the capacity that a flight surely uses in the time over which the charge is compared. It is several of
the whole percents that an autopilot reports, and more than an estimate from the voltage rises after a takeoff."""
STANDING_SHARE = 1.0 / 3.0
"""A charge that falls by less than this fraction of `LEAST_FALL` stands still."""
CHANGE_MIN = 0.015
"""Change of the charge on the ground that ends the problem: somebody has charged the battery, or put in another one."""


class ChargeWatch:
    """Compares the reported charge with what a flight uses at least.

    Args:
        battery: the vehicle's battery.

    Attributes:
        problem: what is wrong with the charge, for people, or "". It stays after the landing until the charge changes.
    """

    def __init__(self, battery: BatteryConfig) -> None:
        self.problem = ""
        self._window_s = LEAST_FALL / battery.least_used(1.0)
        """Flight time in which at least `LEAST_FALL` is used."""
        self._samples: deque[tuple[int, float]] = deque()
        """Times with the charge, one a second of the flight."""
        self._stands_at = 0.0

    def update(self, status: Status) -> None:
        """Update with the newest status."""
        charge = None if status.battery is None else status.battery.remaining
        if charge is None:
            return
        if not status.armed or status.landed:
            self._samples.clear()
            if abs(charge - self._stands_at) > CHANGE_MIN:
                self.problem = ""
            return
        samples = self._samples
        if samples and status.t_ns - samples[-1][0] < PERIOD_NS:
            return
        samples.append((status.t_ns, charge))
        begin_ns, begin_charge = samples[0]
        flown_s = (status.t_ns - begin_ns) / NS_PER_S
        if flown_s < self._window_s:
            return
        samples.popleft()
        self.problem = ""
        if begin_charge - charge < STANDING_SHARE * LEAST_FALL:
            self._stands_at = charge
            self.problem = (
                f"the charge went from {begin_charge:.0%} to {charge:.0%} in {flown_s:.0f} s of flight, which use "
                f"{LEAST_FALL:.0%} at least: its gauge stands still, don't trust it"
            )
