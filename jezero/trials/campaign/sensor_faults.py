"""Faults of the simulator's sensors, in its messages to the autopilot (HIL) and on the bus."""

from collections import deque
from collections.abc import Callable, Iterator
from math import nan
from random import Random
from typing import Any

import msgspec

from jezero.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.runtime.service import Inbox, Output, Publish, Send, Service
from jezero.schemas.struct import Message
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.bus_sensors import BUS_SENSORS
from jezero.trials.campaign.faults import Fault, Kind

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
NAMES = {sensor.topic.name: name for name, sensor in BUS_SENSORS.items()}
"""Name of a sensor by its topic."""


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
        sensor = NAMES.get(output.topic.name)
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
