"""Faults of links: changes of messages between sender and receiver."""

import re
from random import Random

from jezero.runtime.memory_bus import REPLY, MemoryBus
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.faults import CLIENTS, HIL, MAVLINK, Fault, Kind, affects

REORDER_MAX_S = 0.1
DUPLICATE_MAX_S = 0.5
LINK_NAMES = {"autopilot": MAVLINK, "offboard": MAVLINK, "hil": HIL}
TIME = re.compile(rb'"(t_ns|issued_t_ns)":(\d+)')
NUMBER = re.compile(rb"(?<=[:,\[])-?\d+(\.\d+)?([eE][+-]?\d+)?(?=[,\]}])")
INVALID_NUMBERS = (b"NaN", b"null", b"1e999", b"-Infinity")

Items = list[tuple[int, bytes]]


class LinkFaults:
    """The active link faults, applied one after the other to each message.

    It is the bus's `tamper`, but only while a fault is active or holds messages back, because it slows the bus down.

    Attributes:
        delay_max_ns: longest delay of a message on MAVLink by a fault so far.
    """

    def __init__(self, bus: MemoryBus, rng: Random) -> None:
        self._bus = bus
        self._rng = rng
        self._active: list[tuple[Fault, int]] = []
        self.delay_max_ns = 0
        self._not_before_ns: dict[tuple[str, str], int] = {}
        """Earliest next arrival by (sender, receiver): messages of one connection do not overtake each other."""

    def start(self, fault: Fault) -> None:
        """Start a fault now; it ends after its duration."""
        end_ns = self._bus.t_ns + int(fault.duration_s * NS_PER_S)
        self._active.append((fault, end_ns))
        self._bus.tamper = self._tamper
        self._bus.at(end_ns, "", lambda: self._stop(fault))

    def _stop(self, fault: Fault) -> None:
        self._active = [(other, end_ns) for other, end_ns in self._active if other is not fault]
        self._remove_if_unused()

    def _remove_if_unused(self) -> None:
        held_ns = max(self._not_before_ns.values(), default=0)
        if self._active:
            return
        if held_ns > self._bus.t_ns:
            self._bus.at(held_ns + 1, "", self._remove_if_unused)
        else:
            self._not_before_ns.clear()
            self._bus.tamper = None

    def _tamper(self, sender: str, receiver: str, name: str, t_ns: int, data: bytes) -> Items:
        path = LINK_NAMES.get(name, "bus")
        items: Items = [(t_ns, data)]
        for fault, end_ns in self._active:
            if fault.path == path and affects(fault, sender, receiver):
                items = self._apply(fault, end_ns, name, receiver, items)
        if path == MAVLINK:
            self.delay_max_ns = max(self.delay_max_ns, *(at_ns - t_ns for at_ns, _ in items), 0)
            return items
        floor_ns = self._not_before_ns.get((sender, receiver), 0)
        reorders = any(fault.kind is Kind.REORDER for fault, _ in self._active) and name != REPLY
        items = [(max(at_ns, 0 if reorders else floor_ns), changed) for at_ns, changed in items]
        last_ns = max((at_ns for at_ns, _ in items), default=0)
        if last_ns > t_ns and not reorders:
            self._not_before_ns[sender, receiver] = last_ns
        return items

    def _apply(self, fault: Fault, end_ns: int, name: str, receiver: str, items: Items) -> Items:
        """Apply one fault. A delay grows within a second, so that it does not start with a gap."""
        rng, amount = self._rng, fault.amount
        is_ordered = name == REPLY or "@" in name
        for_client = receiver in CLIENTS
        match fault.kind:
            case Kind.DROP:
                items = [item for item in items if rng.random() >= amount]
            case Kind.PARTITION:
                items = [] if amount else [(max(at_ns, end_ns), data) for at_ns, data in items]
            case Kind.DELAY:
                grown = min(1.0, (self._bus.t_ns - end_ns) / NS_PER_S + fault.duration_s)
                items = [(at_ns + int(grown * amount * NS_PER_S), data) for at_ns, data in items]
            case Kind.REORDER if not is_ordered:
                items = [(at_ns + self._random_delay_ns(amount, REORDER_MAX_S), data) for at_ns, data in items]
            case Kind.DUPLICATE if not is_ordered:
                items = [(at_ns + delay_ns, data) for at_ns, data in items for delay_ns in self._copies_ns(amount)]
            case Kind.BIT_FLIPS:
                items = [
                    (at_ns, self._with_flipped_bits(data) if rng.random() < amount else data) for at_ns, data in items
                ]
            case Kind.NAN if not for_client:
                items = [
                    (at_ns, self._with_invalid_number(data) if rng.random() < amount else data) for at_ns, data in items
                ]
            case Kind.WRONG_TIME if not for_client:
                items = [(at_ns, _shifted(data, amount)) for at_ns, data in items]
        return items

    def _copies_ns(self, probability: float) -> tuple[int, ...]:
        return (0, self._random_delay_ns(1.0, DUPLICATE_MAX_S)) if self._rng.random() < probability else (0,)

    def _random_delay_ns(self, probability: float, delay_max_s: float) -> int:
        return int(self._rng.uniform(0.0, delay_max_s) * NS_PER_S) if self._rng.random() < probability else 0

    def _with_flipped_bits(self, data: bytes) -> bytes:
        changed = bytearray(data)
        for _ in range(self._rng.randint(1, 3)):
            changed[self._rng.randrange(len(changed))] ^= 1 << self._rng.randrange(8)
        return bytes(changed)

    def _with_invalid_number(self, data: bytes) -> bytes:
        """The JSON text with one of its numbers replaced by an invalid one."""
        numbers = list(NUMBER.finditer(data))
        if not numbers:
            return data
        start, end = self._rng.choice(numbers).span()
        return data[:start] + self._rng.choice(INVALID_NUMBERS) + data[end:]


def _shifted(data: bytes, seconds: float) -> bytes:
    def shift(match: re.Match[bytes]) -> bytes:
        return b'"%s":%d' % (match[1], max(0, int(match[2]) + int(seconds * NS_PER_S)))

    return TIME.sub(shift, data)
