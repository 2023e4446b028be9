"""The autopilot's parameters that this system needs, set over MAVLink before the first flight.

Integers travel as PX4 wants them, their bytes in the place of the float's. PX4 says nothing at all about a parameter
that it doesn't know or that has another type: what isn't confirmed after some tries is given up and told.
"""

import struct
from collections.abc import Mapping

INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE of the two kinds that PX4 has."""
TRIES = 8
RETRY_NS = 300_000_000

Value = int | float


class ParameterSetter:
    """Sets a table of parameters, each until it is confirmed or given up.

    Attributes:
        failed: why, by the name of each parameter that was given up.
    """

    def __init__(self, wanted: Mapping[str, Value]) -> None:
        self._wanted = dict(wanted)
        self.failed: dict[str, str] = {}
        self._pending: dict[str, int] = {}
        self._told: dict[str, Value] = {}
        self._next_ns: int | None = None
        self.restart()

    @property
    def pending(self) -> tuple[str, ...]:
        """Names that are neither confirmed nor given up."""
        return tuple(self._pending)

    @property
    def complaint(self) -> str:
        """What was given up, in words; "" when nothing was."""
        return "; ".join(f"parameter {name} {why}" for name, why in self.failed.items())

    def restart(self) -> None:
        """The autopilot is another one than before: set everything again."""
        self.failed.clear()
        self._told.clear()
        self._pending = dict.fromkeys(self._wanted, 0)
        self._next_ns = None

    def due(self, wall_ns: int) -> list[tuple[str, float, int]]:
        """What must be sent now: (name, value as PARAM_SET carries it, MAVLink type) each."""
        if not self._pending or (self._next_ns is not None and wall_ns < self._next_ns):
            return []
        self._next_ns = wall_ns + RETRY_NS
        for name in [name for name, tries in self._pending.items() if tries >= TRIES]:
            del self._pending[name]
            told = self._told.get(name)
            self.failed[name] = "is unknown to the autopilot" if told is None else f"stays {told:g}"
        for name in self._pending:
            self._pending[name] += 1
        return [(name, *encoded(self._wanted[name])) for name in self._pending]

    def confirm(self, name: str, carried: float, told_kind: int) -> None:
        """Take in a PARAM_VALUE: its name, value as it is carried, and type."""
        if name not in self._wanted:
            return
        value, kind = encoded(self._wanted[name])
        if told_kind == kind and struct.pack("<f", carried) == struct.pack("<f", value):
            self._pending.pop(name, None)
            self.failed.pop(name, None)
        else:
            self._told[name] = decoded(carried, told_kind)


def encoded(value: Value) -> tuple[float, int]:
    """The float that carries a parameter's value, and its MAVLink type."""
    if isinstance(value, int):
        return float(struct.unpack("<f", struct.pack("<i", value))[0]), INT32
    return value, REAL32


def decoded(carried: float, kind: int) -> Value:
    """The value that a PARAM_VALUE carries."""
    if kind == INT32:
        return int(struct.unpack("<i", struct.pack("<f", carried))[0])
    return carried
