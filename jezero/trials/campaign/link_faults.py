"""Faults of links: what becomes of a message on its way."""

import re
from random import Random

from jezero.runtime.memory_bus import REPLY, MemoryBus
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.faults import CLIENTS, HIL, MAVLINK, Fault, Kind, hits

REORDER_MAX_S = 0.1
DUPLICATE_MAX_S = 0.5
LINK_NAMES = {"autopilot": MAVLINK, "offboard": MAVLINK, "hil": HIL}
TIME = re.compile(rb'"(t_ns|issued_t_ns)":(\d+)')
NUMBER = re.compile(rb"(?<=[:,\[])-?\d+(\.\d+)?([eE][+-]?\d+)?(?=[,\]}])")
NO_NUMBERS = (b"NaN", b"null", b"1e999", b"-Infinity")

Items = list[tuple[int, bytes]]


class Disturber:
    """The bus's tamper: every fault that is on at present, one after the other. On the bus only while it has to be."""

    def __init__(self, bus: MemoryBus, rng: Random) -> None:
        self._bus = bus
        self._rng = rng
        self._active: list[tuple[Fault, int]] = []
        self.late_ns = 0
        """By how much a fault made any message on MAVLink late so far, at most."""
        self._not_before_ns: dict[tuple[str, str], int] = {}
        """What a connection holds back is not overtaken by what it carries later."""

    def begin(self, fault: Fault) -> None:
        """Let a fault begin now; it ends by itself after its duration."""
        end_ns = self._bus.t_ns + int(fault.duration_s * NS_PER_S)
        self._active.append((fault, end_ns))
        self._bus.tamper = self._tamper
        self._bus.at(end_ns, "", lambda: self._end(fault))

    def _end(self, fault: Fault) -> None:
        self._active = [(other, end_ns) for other, end_ns in self._active if other is not fault]
        self._rest()

    def _rest(self) -> None:
        held_ns = max(self._not_before_ns.values(), default=0)
        if self._active:
            return
        if held_ns > self._bus.t_ns:
            self._bus.at(held_ns + 1, "", self._rest)
        else:
            self._not_before_ns.clear()
            self._bus.tamper = None

    def _tamper(self, sender: str, receiver: str, name: str, t_ns: int, data: bytes) -> Items:
        path = LINK_NAMES.get(name, "bus")
        items: Items = [(t_ns, data)]
        for fault, end_ns in self._active:
            if fault.path == path and hits(fault, sender, receiver):
                items = self._suffer(fault, end_ns, name, receiver, items)
        if path == MAVLINK:
            self.late_ns = max(self.late_ns, *(at_ns - t_ns for at_ns, _ in items), 0)
            return items
        floor_ns = self._not_before_ns.get((sender, receiver), 0)
        reorders = any(fault.kind is Kind.REORDER for fault, _ in self._active) and name != REPLY
        items = [(max(at_ns, 0 if reorders else floor_ns), changed) for at_ns, changed in items]
        late_ns = max((at_ns for at_ns, _ in items), default=0)
        if late_ns > t_ns and not reorders:
            self._not_before_ns[sender, receiver] = late_ns
        return items

    def _suffer(self, fault: Fault, end_ns: int, name: str, receiver: str, items: Items) -> Items:
        """One fault's effect. A delay grows within a second, so that what is late need not have been missing before."""
        rng, amount = self._rng, fault.amount
        on_connection = name == REPLY or "@" in name
        for_client = receiver in CLIENTS
        match fault.kind:
            case Kind.DROP:
                items = [item for item in items if rng.random() >= amount]
            case Kind.PARTITION:
                items = [] if amount else [(max(at_ns, end_ns), data) for at_ns, data in items]
            case Kind.DELAY:
                grown = min(1.0, (self._bus.t_ns - end_ns) / NS_PER_S + fault.duration_s)
                items = [(at_ns + int(grown * amount * NS_PER_S), data) for at_ns, data in items]
            case Kind.REORDER if not on_connection:
                items = [(at_ns + self._chance_ns(amount, REORDER_MAX_S), data) for at_ns, data in items]
            case Kind.DUPLICATE if not on_connection:
                items = [(at_ns + late_ns, data) for at_ns, data in items for late_ns in self._copies_ns(amount)]
            case Kind.BIT_FLIPS:
                items = [(at_ns, self._flipped(data) if rng.random() < amount else data) for at_ns, data in items]
            case Kind.NAN if not for_client:
                items = [(at_ns, self._poisoned(data) if rng.random() < amount else data) for at_ns, data in items]
            case Kind.WRONG_TIME if not for_client:
                items = [(at_ns, _shifted(data, amount)) for at_ns, data in items]
        return items

    def _copies_ns(self, probability: float) -> tuple[int, ...]:
        return (0, self._chance_ns(1.0, DUPLICATE_MAX_S)) if self._rng.random() < probability else (0,)

    def _chance_ns(self, probability: float, longest_s: float) -> int:
        return int(self._rng.uniform(0.0, longest_s) * NS_PER_S) if self._rng.random() < probability else 0

    def _flipped(self, data: bytes) -> bytes:
        changed = bytearray(data)
        for _ in range(self._rng.randint(1, 3)):
            changed[self._rng.randrange(len(changed))] ^= 1 << self._rng.randrange(8)
        return bytes(changed)

    def _poisoned(self, data: bytes) -> bytes:
        """One of the numbers of a JSON text is no number any more."""
        numbers = list(NUMBER.finditer(data))
        if not numbers:
            return data
        start, end = self._rng.choice(numbers).span()
        return data[:start] + self._rng.choice(NO_NUMBERS) + data[end:]


def _shifted(data: bytes, seconds: float) -> bytes:
    def shift(match: re.Match[bytes]) -> bytes:
        return b'"%s":%d' % (match[1], max(0, int(match[2]) + int(seconds * NS_PER_S)))

    return TIME.sub(shift, data)
