"""Kinds of faults, and the random choice of a mission's faults."""

from dataclasses import dataclass
from enum import StrEnum
from random import Random

from jezero.plugins import action_names
from jezero.trials.campaign.bus_sensors import BUS_SENSORS

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
SENSORS = ("imu", "mag", "baro", "gnss", *BUS_SENSORS)


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


def affects(fault: Fault, sender: str, receiver: str) -> bool:
    """Whether a fault affects messages from sender to receiver."""
    one, arrow, other = fault.where.partition(">")
    if not arrow:
        return one in (sender, receiver)
    return _matches(one, sender) and _matches(other, receiver)


def _matches(name: str, service: str) -> bool:
    return service == name or (name == SERVERS and service in action_names())


def _one_way(rng: Random, a: str, b: str) -> str:
    return f"{a}>{b}" if rng.random() < 0.5 else f"{b}>{a}"
