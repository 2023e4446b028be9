"""The autopilot's parameters that this system needs, set over MAVLink before the first flight.

Integers travel as PX4 wants them: the integer's bytes take the place of the float's. PX4 does not reply to a
PARAM_SET of a parameter that it doesn't know or that has another type, so the bridge gives up after some tries and
reports it.
"""

import struct
from collections.abc import Mapping

INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE of the two kinds that PX4 has."""
TRIES = 8
RETRY_PERIOD_NS = 300_000_000

Value = int | float


class ParameterSetter:
    """Sets a table of parameters, each until it is confirmed or given up.

    Attributes:
        failed: reason for each parameter that was given up, by its name.
    """

    def __init__(self, wanted: Mapping[str, Value]) -> None:
        self._wanted = dict(wanted)
        self.failed: dict[str, str] = {}
        self._pending: dict[str, int] = {}
        """Number of tries so far, by name."""
        self._reported: dict[str, Value] = {}
        self._next_ns: int | None = None
        self.restart()

    @property
    def pending(self) -> tuple[str, ...]:
        """Names that are neither confirmed nor given up."""
        return tuple(self._pending)

    @property
    def failure_text(self) -> str:
        """Parameters that were given up, for people; "" without any."""
        return "; ".join(f"parameter {name} {reason}" for name, reason in self.failed.items())

    def restart(self) -> None:
        """Set everything again, as for another autopilot."""
        self.failed.clear()
        self._reported.clear()
        self._pending = dict.fromkeys(self._wanted, 0)
        self._next_ns = None

    def due(self, wall_ns: int) -> list[tuple[str, float, int]]:
        """Parameters to send now: (name, value as PARAM_SET carries it, MAVLink type) each."""
        if not self._pending or (self._next_ns is not None and wall_ns < self._next_ns):
            return []
        self._next_ns = wall_ns + RETRY_PERIOD_NS
        for name in [name for name, tries in self._pending.items() if tries >= TRIES]:
            del self._pending[name]
            value = self._reported.get(name)
            self.failed[name] = "is unknown to the autopilot" if value is None else f"stays {value:g}"
        for name in self._pending:
            self._pending[name] += 1
        return [(name, *encoded(self._wanted[name])) for name in self._pending]

    def confirm(self, name: str, carried: float, carried_kind: int) -> None:
        """Update with a PARAM_VALUE: its name, value as it is carried, and MAVLink type."""
        if name not in self._wanted:
            return
        value, kind = encoded(self._wanted[name])
        if carried_kind == kind and struct.pack("<f", carried) == struct.pack("<f", value):
            self._pending.pop(name, None)
            self.failed.pop(name, None)
        else:
            self._reported[name] = decoded(carried, carried_kind)


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
