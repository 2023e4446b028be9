"""Faults in the point-mass world that correspond to those of the physical world."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from random import Random
from typing import Any

from jezero.runtime.service import Inbox, Output
from jezero.services.autopilot.alignment import Fix
from jezero.trials.campaign.faults import AUTOPILOT, HIL, MAVLINK, SENSOR_KINDS, SIMULATOR, Fault
from jezero.trials.campaign.point_mass_world import NAME, PointMass
from jezero.trials.campaign.sensor_faults import SensorFault

SUBSTITUTES = {"imu": "mag", "uwb": "baro", "rover_odometry": "altimeter"}
"""Sensors that fail instead of those that the point mass does not have."""
WRONG_FIX_DEG = 4.5e-5
GARBLED_FIX_DEG = 4.5e-4
WRONG_HEIGHT_M = 10.0
GARBLED_HEIGHT_M = 20.0
WRONG_FIELD_GAUSS = 0.2


def point_mass_fault(fault: Fault) -> Fault:
    """The corresponding fault where simulator and autopilot are one service without a link between them."""
    if fault.kind in SENSOR_KINDS:
        return replace(fault, where=SUBSTITUTES.get(fault.where, fault.where))
    if fault.path == HIL:
        return replace(
            fault, where=fault.where.replace(SIMULATOR, "vehicle_bridge").replace(AUTOPILOT, NAME), path=MAVLINK
        )
    return replace(fault, where=fault.where.replace(SIMULATOR, NAME).replace(AUTOPILOT, NAME))


class FaultyPointMass:
    """Service that runs a point mass and applies the active sensor faults to its readings.

    Attributes:
        active: the active faults; the caller of `start` removes them.
    """

    def __init__(self, world: PointMass, rng: Random) -> None:
        self.spec = world.spec
        self.active: list[SensorFault] = []
        self._world = world
        self._rng = rng

    def start(self, fault: Fault) -> SensorFault:
        running = SensorFault(fault, self._rng)
        self.active.append(running)
        return running

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """See `Service`."""
        self._world.sensor_filter = self._filter if self.active else None
        yield from self._world.step(t_ns, inbox)

    def _filter(self, sensor: str, t_ns: int, reading: Any) -> Iterable[Any]:
        readings = [reading]
        for fault in self.active:
            if fault.sensor != sensor:
                continue
            if sensor == "altimeter":
                readings = [changed for r in readings for changed in fault.on_bus(t_ns, r)]
            else:
                readings = [changed for r in readings for changed in self._changed(fault, t_ns, r)]
        return readings

    def _changed(self, fault: SensorFault, t_ns: int, reading: Any) -> Iterator[Any]:
        rng, amount = self._rng, fault.amount

        def garbled(value: Any) -> Any:
            match fault.sensor:
                case "gnss":
                    return _shifted(value, rng.uniform(-GARBLED_FIX_DEG, GARBLED_FIX_DEG), valid=rng.random() < 0.5)
                case "mag":
                    return tuple(rng.uniform(-1.0, 1.0) for _ in range(3))
            return rng.uniform(-GARBLED_HEIGHT_M, GARBLED_HEIGHT_M)

        def wrong(value: Any) -> Any:
            match fault.sensor:
                case "gnss":
                    return _shifted(value, WRONG_FIX_DEG * amount)
                case "mag":
                    x, y, z = value
                    return (x + WRONG_FIELD_GAUSS * amount, y - WRONG_FIELD_GAUSS * amount, z)
            return value + WRONG_HEIGHT_M * amount

        yield from fault.readings(t_ns, reading, lambda first, now: first, garbled, wrong)


def _shifted(fix: Fix, north_deg: float, *, valid: bool = True) -> Fix:
    latitude_deg, longitude_deg, amsl_m = fix.position_deg
    return replace(fix, position_deg=(latitude_deg + north_deg, longitude_deg, amsl_m), valid=valid)
