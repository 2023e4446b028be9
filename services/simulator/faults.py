"""Faults of sensors and motors that people inject, as PX4's failure injection names them.

A fault changes the readings of a sensor's model before they are sent, so that the autopilot and the bus get the same.

Source: https://docs.px4.io/main/en/debug/failure_injection
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians
from typing import Any, TypeVar, cast

import msgspec
import numpy as np

from jezero.base.frames import Vec3, add, geodetic_from_ned, rotate_yaw, wrap_pi
from jezero.base.vehicle_config import PlanetConfig
from jezero.schemas import sensors as messages
from jezero.schemas.simulator import FAULTS, ActiveFault, FaultKind, FaultUnit, SetFault
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.noise import generator
from jezero.services.simulator.sensors import pressure_pa

DELAY_NS = 500_000_000
"""Additional delay of a delayed sensor's readings."""
SLOW_DIVISOR = 5
"""A slow sensor gives one reading of this number."""
SHARE_LOST = 0.7
"""Share of an intermittent sensor's readings that are lost."""
SHIFT_GNSS_NED_M: Vec3 = (20.0, 0.0, 0.0)
TURN_MAG_RAD = radians(45.0)
ERROR_ALTITUDE_M = -10.0
ERROR_RANGE_M = 1.0
ERROR_YAW_ROVER_RAD = 0.5
ERROR_ACC_FRD_MPS2: Vec3 = (1.0, 0.0, 0.0)
ERROR_GYRO_FRD_RPS: Vec3 = (0.1, 0.0, 0.0)
"""Errors of sensors that are wrong."""
GARBAGE_ACC_MPS2, GARBAGE_GYRO_RPS, GARBAGE_GAUSS = 100.0, 20.0, 1.0
"""Greatest components of garbage."""
GARBAGE_ALTITUDES_M = (-300.0, 5000.0)
INSTANCES: dict[FaultUnit, str] = {"motor": "motors", "uwb": "anchors"}
"""Units that have several instances."""
OF_ONE_ANCHOR: tuple[FaultKind, ...] = ("off", "stuck", "garbage", "wrong")

R = TypeVar("R", messages.Gnss, messages.Barometer, messages.Magnetometer, messages.Altimeter, messages.RoverOdometry)
Random = np.random.Generator


@dataclass
class _Fault:
    """A fault at work, with what it remembers."""

    shown: ActiveFault
    first: Any = None
    """First reading since the fault began, which a stuck sensor repeats."""
    count: int = 0


class InjectedFaults:
    """The faults at work.

    Args:
        seed: seed of lost and garbled readings.
        planet: whose air the barometer measures.
        instances: number of instances of the units that have several.

    Attributes:
        any: whether there is one, which is cheap to ask in every step.
    """

    def __init__(self, seed: int, planet: PlanetConfig, instances: dict[FaultUnit, int]) -> None:
        self.any = False
        self._planet = planet
        self._instances = instances
        self._rng = generator(seed, "injected faults")
        self._faults: dict[tuple[FaultUnit, int], _Fault] = {}

    @property
    def active(self) -> tuple[ActiveFault, ...]:
        return tuple(fault.shown for fault in self._faults.values())

    def refusal(self, request: SetFault) -> str:
        """Reason why there is no such fault; "" for one that can begin or end."""
        unit, kind, instance = request.unit, request.kind, request.instance
        if kind != "ok" and kind not in FAULTS[unit]:
            return f"{unit} {kind} can't be simulated; {unit} has: {', '.join((*FAULTS[unit], 'ok'))}"
        if unit not in INSTANCES and instance > 1:
            return f"there is one {unit} only: leave the instance out"
        if unit in INSTANCES and instance > self._instances[unit]:
            return f"{unit} {instance}: there are {self._instances[unit]} {INSTANCES[unit]}, counted from 1"
        if unit == "uwb" and instance and kind not in (*OF_ONE_ANCHOR, "ok"):
            return f"one anchor can't be {kind}, as a round has one time; it can be {', '.join(OF_ONE_ANCHOR)}"
        return ""

    def set(self, request: SetFault, t_ns: int) -> None:
        """Begin or end a fault that `refusal` has nothing against."""
        unit, instance = request.unit, request.instance if request.unit in INSTANCES else 0
        for key in list(self._faults):
            if key[0] == unit and (instance in (0, key[1]) or (key[1] == 0 and request.kind != "ok")):
                del self._faults[key]
        if request.kind != "ok":
            until = None if request.duration_s is None else t_ns + round(request.duration_s * NS_PER_S)
            shown = ActiveFault(unit=unit, kind=request.kind, instance=instance, until_t_ns=until)
            self._faults[unit, instance] = _Fault(shown)
        self.any = bool(self._faults)

    def clear(self) -> None:
        """End all faults."""
        self._faults.clear()
        self.any = False

    def end_over(self, t_ns: int) -> None:
        """End the faults whose time is over."""
        for key, fault in list(self._faults.items()):
            if fault.shown.until_t_ns is not None and t_ns >= fault.shown.until_t_ns:
                del self._faults[key]
        self.any = bool(self._faults)

    # -- what the models' readings become --

    def delay_ns(self, unit: FaultUnit) -> int:
        """Additional delay of the readings."""
        fault = self._faults.get((unit, 0))
        return DELAY_NS if fault is not None and fault.shown.kind == "delayed" else 0

    def loses(self, unit: FaultUnit) -> bool:
        """Whether this reading is lost; to be called once for each."""
        fault = self._faults.get((unit, 0))
        if fault is None:
            return False
        fault.count += 1
        kind = fault.shown.kind
        return (
            kind == "off"
            or (kind == "slow" and fault.count % SLOW_DIVISOR != 0)
            or (kind == "intermittent" and float(self._rng.random()) < SHARE_LOST)
        )

    def reading(self, unit: FaultUnit, reading: R) -> R:
        """The reading that a sensor gives in place of its model's."""
        fault = self._faults.get((unit, 0))
        if fault is None:
            return reading
        if fault.first is None:
            fault.first = reading
        kind = fault.shown.kind
        if kind == "stuck":
            return cast(R, msgspec.structs.replace(fault.first, t_ns=reading.t_ns))
        if isinstance(reading, messages.Barometer) and kind in ("wrong", "garbage"):
            wrong: Any = self._wrong_pressure(reading, kind)
            return cast(R, wrong)
        change = (WRONG if kind == "wrong" else GARBAGE if kind == "garbage" else {}).get(unit)
        return reading if change is None else cast(R, change(reading, self._rng))

    def _wrong_pressure(self, reading: messages.Barometer, kind: FaultKind) -> messages.Barometer:
        """The reading at another altitude: with a constant error, or anywhere."""
        altitude_m = reading.altitude_pressure_m + ERROR_ALTITUDE_M
        if kind == "garbage":
            altitude_m = float(self._rng.uniform(*GARBAGE_ALTITUDES_M))
        wrong_pa = pressure_pa(altitude_m, self._planet)
        return msgspec.structs.replace(reading, pressure_pa=wrong_pa, altitude_pressure_m=altitude_m)

    def vector(self, unit: FaultUnit, value: Vec3) -> Vec3:
        """What accelerometer or gyroscope measures in place of its model's value."""
        fault = self._faults.get((unit, 0))
        if fault is None:
            return value
        if fault.first is None:
            fault.first = value
        if fault.shown.kind == "stuck":
            return cast(Vec3, fault.first)
        if fault.shown.kind == "wrong":
            return add(value, ERROR_ACC_FRD_MPS2 if unit == "accel" else ERROR_GYRO_FRD_RPS)
        return _random_vector(self._rng, GARBAGE_ACC_MPS2 if unit == "accel" else GARBAGE_GYRO_RPS)

    def ranges(self, uwb: messages.Uwb, range_max_m: float) -> messages.Uwb:
        """The round of UWB ranges in place of the model's, each range by the fault of its anchor or of all."""
        kept = []
        for each in uwb.ranges:
            fault = self._faults.get(("uwb", each.anchor + 1)) or self._faults.get(("uwb", 0))
            range_m: float | None = each.range_m
            if fault is not None:
                range_m = self._range_m(fault, each, range_max_m)
            if range_m is not None:
                kept.append(msgspec.structs.replace(each, range_m=range_m))
        return msgspec.structs.replace(uwb, ranges=tuple(kept))

    def _range_m(self, fault: _Fault, each: messages.UwbRange, range_max_m: float) -> float | None:
        kind = fault.shown.kind
        if kind == "stuck":
            if fault.first is None:
                fault.first = {}
            return float(fault.first.setdefault(each.anchor, each.range_m))
        if kind == "wrong":
            return each.range_m + ERROR_RANGE_M
        if kind == "garbage":
            return float(self._rng.uniform(0.0, range_max_m))
        return None if kind == "off" else each.range_m

    def stops_motor(self, index: int) -> bool:
        """Whether the motor of this index, from 0, stands still."""
        return ("motor", index + 1) in self._faults or ("motor", 0) in self._faults


def _random_vector(rng: Random, limit: float) -> Vec3:
    x, y, z = rng.uniform(-limit, limit, 3).tolist()
    return (x, y, z)


def _shifted(reading: messages.Gnss, rng: Random) -> messages.Gnss:
    return msgspec.structs.replace(reading, position_deg=geodetic_from_ned(SHIFT_GNSS_NED_M, reading.position_deg))


def _garbled_fix(reading: messages.Gnss, rng: Random) -> messages.Gnss:
    x, y, z = _random_vector(rng, 1000.0)
    vel_ned_mps = _random_vector(rng, 50.0)
    return msgspec.structs.replace(
        reading, position_deg=geodetic_from_ned((x, y, z), reading.position_deg), vel_uav_ned_mps=vel_ned_mps
    )


def _turned(reading: messages.Magnetometer, rng: Random) -> messages.Magnetometer:
    return msgspec.structs.replace(reading, field_frd_gauss=rotate_yaw(reading.field_frd_gauss, TURN_MAG_RAD))


def _odometry(reading: messages.RoverOdometry, yaw_rad: float, speed_mps: float) -> messages.RoverOdometry:
    return msgspec.structs.replace(reading, yaw_rover_rad=wrap_pi(yaw_rad), speed_rover_body_mps=speed_mps)


WRONG: dict[FaultUnit, Callable[[Any, Random], Any]] = {
    "gps": _shifted,
    "mag": _turned,
    "distance_sensor": lambda reading, rng: (
        reading
        if reading.range_m is None
        else msgspec.structs.replace(reading, range_m=reading.range_m + ERROR_RANGE_M)
    ),
    "rover_odometry": lambda reading, rng: _odometry(
        reading, reading.yaw_rover_rad + ERROR_YAW_ROVER_RAD, reading.speed_rover_body_mps
    ),
}
GARBAGE: dict[FaultUnit, Callable[[Any, Random], Any]] = {
    "gps": _garbled_fix,
    "mag": lambda reading, rng: msgspec.structs.replace(reading, field_frd_gauss=_random_vector(rng, GARBAGE_GAUSS)),
    "distance_sensor": lambda reading, rng: msgspec.structs.replace(reading, range_m=float(rng.uniform(0.1, 40.0))),
    "rover_odometry": lambda reading, rng: _odometry(
        reading, float(rng.uniform(-3.0, 3.0)), float(rng.uniform(-2.0, 2.0))
    ),
}
"""What a wrong or a garbled reading is, by unit, for the units whose readings are one message."""
