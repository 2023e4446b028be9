"""Faults of a mission: their kinds, how they are drawn, and what they do to messages and to readings of sensors.

The mission itself kills and freezes services. The point mass has its own readings, see `point_mass.py`.
"""

import re
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from math import nan
from random import Random
from typing import Any, NamedTuple

import msgspec
from msgspec.structs import replace

from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.base.plugins import action_names
from jezero.runtime.memory_bus import REPLY, MemoryBus
from jezero.runtime.service import Inbox, Output, Publish, Send, Service
from jezero.schemas import sensors as messages
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.struct import Message
from jezero.schemas.units import NS_PER_S

CLIENTS = ("alice", "bob")
BRIDGE, AUTOPILOT, SIMULATOR = "vehicle_bridge", "autopilot", "simulator"
SERVERS = "servers"
"""All action servers at once, as if they ran on one host."""
MAVLINK, HIL = "MAVLink", "HIL"
FAULT_COUNTS = range(3, 15)
"""Default numbers of faults in one mission."""
PARTITION_MAX_S = 15.0


class Kind(StrEnum):
    """Kinds of faults; the names of sensor faults are PX4's."""

    DROP = "drop"
    DELAY = "delay"
    DUPLICATE = "duplicate"
    REORDER = "reorder"
    PARTITION = "partition"
    FREEZE = "freeze"
    KILL = "kill and restart"
    SENSOR_OFF = "sensor off"
    SENSOR_STUCK = "sensor stuck"
    SENSOR_GARBAGE = "sensor garbage"
    SENSOR_WRONG = "sensor wrong"
    SENSOR_SLOW = "sensor slow"
    SENSOR_DELAYED = "sensor delayed"
    SENSOR_INTERMITTENT = "sensor intermittent"
    NAN = "NaN"
    WRONG_TIME = "wrong time stamps"
    BIT_FLIPS = "bit flips"


SENSOR_KINDS = tuple(kind for kind in Kind if kind.startswith("sensor"))


@dataclass(frozen=True)
class Fault:
    """One fault of a mission.

    Attributes:
        kind: the kind.
        where: "a>b" for messages from a to b, where one end may be SERVERS; else a service, a client or a sensor.
        path: "bus", or the byte link: MAVLINK or HIL.
        start_s: time after the vehicle was first ready, or after the time-out for that.
        duration_s: length of the fault.
        amount: probability, delay in seconds, or size, depending on the kind; 0 for kinds without one.
    """

    kind: Kind
    where: str
    path: str
    start_s: float
    duration_s: float
    amount: float = 0.0

    def __str__(self) -> str:
        path = "" if self.path == "bus" else f" on {self.path}"
        amount = f" ({self.amount:.3g})" if self.amount else ""
        return f"{self.kind}{amount} of {self.where}{path} for {self.duration_s:.2f} s"


def draw_faults(
    rng: Random, start_max_s: float, others: tuple[str, ...] = (), fault_counts: range = FAULT_COUNTS
) -> list[Fault]:
    """Draw faults, in the order of their start.

    Args:
        rng: random generator.
        start_max_s: latest start.
        others: services of the stack besides simulator, autopilot, bridge and action servers.
        fault_counts: allowed numbers of faults.
    """
    kinds = [rng.choice(tuple(Kind)) for _ in range(rng.choice(fault_counts))]
    faults = [_draw_fault(kind, rng, rng.uniform(0.0, start_max_s), others) for kind in kinds]
    return sorted(faults, key=lambda fault: fault.start_s)


def _draw_fault(kind: Kind, rng: Random, start_s: float, others: tuple[str, ...]) -> Fault:
    if kind in SENSOR_KINDS:
        return _draw_sensor(kind, rng, start_s)
    if kind is Kind.KILL:
        names = (BRIDGE, BRIDGE, BRIDGE, *action_names(), *action_names(), AUTOPILOT, SIMULATOR, *others)
        return Fault(kind, rng.choice(names), "bus", start_s, rng.uniform(0.3, 5.0))
    if kind is Kind.FREEZE:
        name = rng.choice((BRIDGE, BRIDGE, *action_names(), AUTOPILOT, *others))
        longest_s = 0.1 if name == AUTOPILOT else 10.0
        return Fault(kind, name, "bus", start_s, rng.uniform(0.02, longest_s))
    if kind is Kind.PARTITION:
        return _draw_partition(rng, start_s, others)
    if kind is Kind.BIT_FLIPS:
        path, amount = rng.choice(((MAVLINK, 0.2), (MAVLINK, 0.05), (HIL, 0.01)))
        ends = (SIMULATOR, AUTOPILOT) if path == HIL else (BRIDGE, AUTOPILOT)
        return Fault(kind, _one_way(rng, *ends), path, start_s, rng.uniform(1.0, 15.0), amount)
    return _draw_link(kind, rng, start_s, others)


def _draw_sensor(kind: Kind, rng: Random, start_s: float) -> Fault:
    """Draw a sensor fault. Those of the IMU are short or small: the vehicle has only one and cannot fly without it."""
    sensor = rng.choice(SENSORS)
    if sensor == "imu" and kind in (Kind.SENSOR_OFF, Kind.SENSOR_STUCK, Kind.SENSOR_DELAYED):
        return Fault(kind, sensor, HIL, start_s, rng.uniform(0.01, 0.04), rng.uniform(0.004, 0.012))
    amount = {
        Kind.SENSOR_GARBAGE: 0.05 if sensor == "imu" else 1.0,
        Kind.SENSOR_WRONG: rng.uniform(0.1, 1.0),
        Kind.SENSOR_DELAYED: rng.uniform(0.1, 1.0),
        Kind.SENSOR_INTERMITTENT: 0.1 if sensor == "imu" else rng.uniform(0.2, 0.9),
        Kind.SENSOR_SLOW: 2.0 if sensor == "imu" else float(rng.randint(2, 20)),
    }.get(kind, 0.0)
    return Fault(kind, sensor, HIL, start_s, rng.uniform(1.0, 15.0), amount)


def _draw_partition(rng: Random, start_s: float, others: tuple[str, ...]) -> Fault:
    """Draw a partition: messages arrive after its end, as from a broken connection, or are lost (amount 1)."""
    duration_s = rng.uniform(0.2, PARTITION_MAX_S)
    if rng.random() < 0.3:
        return Fault(Kind.PARTITION, _one_way(rng, BRIDGE, AUTOPILOT), MAVLINK, start_s, duration_s, 1.0)
    name = rng.choice((BRIDGE, BRIDGE, *action_names(), *CLIENTS, *others))
    return Fault(Kind.PARTITION, name, "bus", start_s, duration_s, float(rng.random() < 0.3))


def _draw_link(kind: Kind, rng: Random, start_s: float, others: tuple[str, ...]) -> Fault:
    duration_s = rng.uniform(1.0, 15.0)
    carries_time = kind in (Kind.NAN, Kind.WRONG_TIME)
    if not carries_time and rng.random() < 0.35:
        amount = {Kind.DELAY: rng.uniform(0.02, 0.2)}.get(kind, rng.choice((0.1, 0.5, 0.9)))
        return Fault(kind, _one_way(rng, BRIDGE, AUTOPILOT), MAVLINK, start_s, duration_s, amount)
    action = SERVERS if rng.random() < 0.6 else rng.choice(action_names())
    with_others = tuple((other, end) for other in others for end in (SIMULATOR, action))
    ends = rng.choice(((SIMULATOR, BRIDGE), (SIMULATOR, action), *with_others))
    if rng.random() < 0.5:  # the link that carries setpoints
        ends = (BRIDGE, action)
    if not carries_time and rng.random() < 0.3:
        ends = (rng.choice(CLIENTS), rng.choice((action, BRIDGE)))
    amount = rng.choice((0.1, 0.5, 0.9))
    if kind is Kind.DELAY:
        amount = rng.uniform(0.05, 0.6)
    elif kind is Kind.WRONG_TIME:
        amount = rng.choice((-3600.0, -5.0, -1.0, -0.4, -0.2, 0.1, 1.0, 5.0, 3600.0))
    return Fault(kind, _one_way(rng, *ends), "bus", start_s, duration_s, amount)


def _one_way(rng: Random, a: str, b: str) -> str:
    return f"{a}>{b}" if rng.random() < 0.5 else f"{b}>{a}"


# -- links -----------------------------------------------------------------------------------------------

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
                items = [(at_ns, _with_shifted_time(data, amount)) for at_ns, data in items]
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


def _with_shifted_time(data: bytes, seconds: float) -> bytes:
    def shift(match: re.Match[bytes]) -> bytes:
        return b'"%s":%d' % (match[1], max(0, int(match[2]) + int(seconds * NS_PER_S)))

    return TIME.sub(shift, data)


def affects(fault: Fault, sender: str, receiver: str) -> bool:
    """Whether a fault affects messages from sender to receiver."""
    one, arrow, other = fault.where.partition(">")
    if not arrow:
        return one in (sender, receiver)
    return _matches(one, sender) and _matches(other, receiver)


def _matches(name: str, service: str) -> bool:
    return service == name or (name == SERVERS and service in action_names())


# -- sensors ---------------------------------------------------------------------------------------------

GROUPS: dict[str, tuple[int, tuple[str, ...]]] = {
    "imu": (0x3F, ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")),
    "mag": (0x1C0, ("xmag", "ymag", "zmag")),
    "baro": (0x1A00, ("abs_pressure", "pressure_alt", "temperature")),
}
"""Bits of `fields_updated` and fields of HIL_SENSOR for each sensor."""
FIX = ("lat", "lon", "alt", "vn", "ve", "vd", "fix_type", "satellites_visible")
ERRORS = {"imu": (0.2, 0.2, 0.2, 0.02, 0.02, 0.02), "mag": (0.2, -0.2, 0.0), "baro": (-1.0, 10.0, 0.0)}
"""Error of the readings of a wrong sensor at amount 1."""
GARBAGE = {"imu": 1e4, "mag": 1.0, "baro": 500.0}


class FaultySimulator:
    """Service that runs a simulator and applies the active sensor faults to its outputs.

    Attributes:
        active: the active faults; the caller of `start` removes them.
    """

    def __init__(self, simulator: Service, rng: Random) -> None:
        self.spec = simulator.spec
        self.simulator = simulator
        self.active: list[SensorFault] = []
        self._rng = rng
        self._in, self._out = MavlinkCodec(1, 25), MavlinkCodec(1, 25)

    def start(self, fault: Fault) -> "SensorFault":
        running = SensorFault(fault, self._rng)
        self.active.append(running)
        return running

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for output in self.simulator.step(t_ns, inbox):
            if not self.active:
                yield output
            elif isinstance(output, Send):
                yield from self._send(t_ns, output)
            elif isinstance(output, Publish):
                yield from self._publish(t_ns, output)
            else:
                yield output

    def _send(self, t_ns: int, output: Send) -> Iterator[Output]:
        for message in self._in.parse(output.data):
            messages = [message]
            for fault in self.active:
                messages = [changed for m in messages for changed in fault.on_hil(t_ns, m)]
            yield from (Send(output.link, self._out.pack(changed)) for changed in messages)

    def _publish(self, t_ns: int, output: Publish) -> Iterator[Output]:
        sensor = SENSOR_OF_TOPIC.get(output.topic.name)
        messages = [output.message]
        for fault in self.active:
            if fault.sensor == sensor:
                messages = [changed for m in messages for changed in fault.on_bus(t_ns, m)]
        yield from (Publish(output.topic, changed) for changed in messages)


class SensorFault:
    """Active fault of one sensor, with the readings that it needs to remember."""

    def __init__(self, fault: Fault, rng: Random) -> None:
        self.sensor = fault.where
        self._kind = fault.kind
        self.amount = fault.amount
        self._rng = rng
        self._first: Any = None
        self._count = 0
        self._late: deque[tuple[int, Any]] = deque()

    def on_hil(self, t_ns: int, message: MavMessage) -> Iterator[MavMessage]:
        """Messages that the autopilot gets instead of one message of the simulator."""
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_HIL_GPS and self.sensor == "gnss":
            yield from self.readings(t_ns, message, _stuck_fix, self._garbled_fix, self._wrong_fix)
        elif kind == dialect.MAVLINK_MSG_ID_HIL_SENSOR and self.sensor in GROUPS:
            mask, fields = GROUPS[self.sensor]
            if message.fields_updated & mask:
                self._change_group(t_ns, message, mask, fields)
            yield message
        else:
            yield message

    def _change_group(self, t_ns: int, message: MavMessage, mask: int, fields: tuple[str, ...]) -> None:
        """Change one sensor's fields in HIL_SENSOR, or clear its bits of `fields_updated`."""
        values = [getattr(message, name) for name in fields]
        readings = list(self.readings(t_ns, values, lambda first, now: first, self._garbled, self._wrong))
        if readings:
            for name, value in zip(fields, readings[-1], strict=True):
                setattr(message, name, value)
        else:
            message.fields_updated &= ~mask

    def on_bus(self, t_ns: int, message: Message) -> Iterator[Message]:
        """Messages that the bus gets instead of one reading."""
        sensor = BUS_SENSORS[self.sensor]
        yield from self.readings(
            t_ns,
            message,
            _stuck_message,
            lambda reading: sensor.garbled(reading, self._rng),
            lambda reading: sensor.wrong(reading, self.amount),
        )

    def readings(
        self,
        t_ns: int,
        reading: Any,
        stuck: Callable[[Any, Any], Any],
        garbled: Callable[[Any], Any],
        wrong: Callable[[Any], Any],
    ) -> Iterator[Any]:
        """Readings that arrive now instead of `reading`, mostly one or none.

        Args:
            t_ns: time of the reading.
            reading: the sensor's reading.
            stuck: returns the stuck reading from the first and the present one.
            garbled: returns a random reading.
            wrong: returns the reading with a constant error.
        """
        if self._first is None:
            self._first = reading
        self._count += 1
        match self._kind:
            case Kind.SENSOR_OFF:
                return
            case Kind.SENSOR_STUCK:
                yield stuck(self._first, reading)
            case Kind.SENSOR_GARBAGE:
                yield garbled(reading) if self._rng.random() < self.amount else reading
            case Kind.SENSOR_WRONG:
                yield wrong(reading)
            case Kind.SENSOR_SLOW:
                if self._count % int(self.amount) == 0:
                    yield reading
            case Kind.SENSOR_INTERMITTENT:
                if self._rng.random() >= self.amount:
                    yield reading
            case Kind.SENSOR_DELAYED:
                self._late.append((t_ns + int(self.amount * NS_PER_S), reading))
                while self._late and self._late[0][0] <= t_ns:
                    yield self._late.popleft()[1]
            case _:
                yield reading

    def _garbled(self, values: list[float]) -> list[float]:
        size = GARBAGE[self.sensor]
        return [nan if self._rng.random() < 0.2 else self._rng.uniform(-size, size) for _ in values]

    def _wrong(self, values: list[float]) -> list[float]:
        return [value + self.amount * error for value, error in zip(values, ERRORS[self.sensor], strict=True)]

    def _garbled_fix(self, message: MavMessage) -> MavMessage:
        rng = self._rng
        message.lat += rng.randint(-20_000, 20_000)
        message.lon += rng.randint(-20_000, 20_000)
        message.alt += rng.randint(-200_000, 200_000)
        message.vn, message.ve, message.vd = (rng.randint(-32_000, 32_000) for _ in range(3))
        message.fix_type = rng.randint(0, 6)
        message.satellites_visible = rng.randint(0, 255)
        return message

    def _wrong_fix(self, message: MavMessage) -> MavMessage:
        """Move the fix by up to 5 m north and 3 m up."""
        message.lat += int(450 * self.amount)
        message.alt += int(3000 * self.amount)
        return message


def _stuck_fix(first: MavMessage, message: MavMessage) -> MavMessage:
    for name in FIX:
        setattr(message, name, getattr(first, name))
    return message


def _stuck_message(first: Any, message: Message) -> Any:
    return msgspec.structs.replace(first, t_ns=message.t_ns)


class BusSensor(NamedTuple):
    """One sensor.

    Attributes:
        topic: topic of its readings.
        garbled: returns a random reading from a reading.
        wrong: returns a reading with a constant error from a reading and the error's amount, 0 to 1.
    """

    topic: Topic[Any]
    garbled: Callable[[Any, Random], Any]
    wrong: Callable[[Any, float], Any]


def _garbled_altimeter(reading: messages.Altimeter, rng: Random) -> messages.Altimeter:
    return replace(reading, range_m=rng.choice((None, 0.0, rng.uniform(0.0, 10.0), rng.uniform(0.0, 1e6))))


def _wrong_altimeter(reading: messages.Altimeter, amount: float) -> messages.Altimeter:
    return reading if reading.range_m is None else replace(reading, range_m=reading.range_m + amount)


def _garbled_uwb(reading: messages.Uwb, rng: Random) -> messages.Uwb:
    return replace(reading, ranges=tuple(replace(r, range_m=rng.uniform(0.0, 1e3)) for r in reading.ranges))


def _wrong_uwb(reading: messages.Uwb, amount: float) -> messages.Uwb:
    return replace(reading, ranges=tuple(replace(r, range_m=r.range_m + amount) for r in reading.ranges))


def _garbled_rover_odometry(reading: messages.RoverOdometry, rng: Random) -> messages.RoverOdometry:
    return replace(reading, yaw_rover_rad=rng.uniform(-6.0, 6.0), speed_rover_body_mps=rng.uniform(-100.0, 100.0))


def _wrong_rover_odometry(reading: messages.RoverOdometry, amount: float) -> messages.RoverOdometry:
    return replace(reading, speed_rover_body_mps=reading.speed_rover_body_mps + amount)


BUS_SENSORS: dict[str, BusSensor] = {
    "altimeter": BusSensor(topics.ALTIMETER, _garbled_altimeter, _wrong_altimeter),
    "uwb": BusSensor(topics.UWB, _garbled_uwb, _wrong_uwb),
    "rover_odometry": BusSensor(topics.ROVER_ODOMETRY, _garbled_rover_odometry, _wrong_rover_odometry),
}
SENSOR_OF_TOPIC = {sensor.topic.name: name for name, sensor in BUS_SENSORS.items()}
"""Name of a sensor by its topic."""
SENSORS = ("imu", "mag", "baro", "gnss", *BUS_SENSORS)
