"""Which faults there are, and a seed's choice of them."""

from dataclasses import dataclass
from enum import StrEnum
from random import Random

from jezero.schemas.topics import ACTIONS

CLIENTS = ("alice", "bob")
BRIDGE, AUTOPILOT, SIMULATOR = "vehicle_bridge", "autopilot", "simulator"
SERVERS = "servers"
"""Of all actions at once, as when they run on one host."""
MAVLINK, HIL = "MAVLink", "HIL"
COUNTS = range(3, 15)
"""How many faults a mission has, unless something else is asked for."""
PARTITION_MAX_S = 15.0


class Kind(StrEnum):
    """What can go wrong; the words for sensors are PX4's."""

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
SENSORS = ("imu", "mag", "baro", "gnss", "altimeter", "uwb", "rover_odometry")


@dataclass(frozen=True)
class Fault:
    """One fault of a mission.

    Attributes:
        where: "a>b" for what a sends to b, where one may be SERVERS; else a service, a client or a sensor.
        path: "bus", or the byte link: MAVLINK or HIL.
        start_s: after the vehicle was first ready, or after the mission's start where it never is.
        amount: a probability, seconds, or a size, whichever the kind has; 0 where it has none.
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


def draw_faults(rng: Random, span_s: float, others: tuple[str, ...] = (), counts: range = COUNTS) -> list[Fault]:
    """Faults that all begin within `span_s`, in the order of their start.

    Args:
        others: services of the stack besides simulator, autopilot, bridge and action servers.
        counts: how many there may be.
    """
    kinds = [rng.choice(tuple(Kind)) for _ in range(rng.choice(counts))]
    faults = [_draw(kind, rng, rng.uniform(0.0, span_s), others) for kind in kinds]
    return sorted(faults, key=lambda fault: fault.start_s)


def _draw(kind: Kind, rng: Random, start_s: float, others: tuple[str, ...]) -> Fault:
    if kind in SENSOR_KINDS:
        return _draw_sensor(kind, rng, start_s)
    if kind is Kind.KILL:
        names = (BRIDGE, BRIDGE, BRIDGE, *ACTIONS, *ACTIONS, AUTOPILOT, SIMULATOR, *others)
        return Fault(kind, rng.choice(names), "bus", start_s, rng.uniform(0.3, 5.0))
    if kind is Kind.FREEZE:
        name = rng.choice((BRIDGE, BRIDGE, *ACTIONS, AUTOPILOT, *others))
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
    """The vehicle has one IMU: without it for long, or with an insane one, nothing can fly."""
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
    """On the bus what was sent arrives afterwards, as from a broken connection, or is lost (amount 1)."""
    duration_s = rng.uniform(0.2, PARTITION_MAX_S)
    if rng.random() < 0.3:
        return Fault(Kind.PARTITION, _one_way(rng, BRIDGE, AUTOPILOT), MAVLINK, start_s, duration_s, 1.0)
    name = rng.choice((BRIDGE, BRIDGE, *ACTIONS, *CLIENTS, *others))
    return Fault(Kind.PARTITION, name, "bus", start_s, duration_s, float(rng.random() < 0.3))


def _draw_link(kind: Kind, rng: Random, start_s: float, others: tuple[str, ...]) -> Fault:
    duration_s = rng.uniform(1.0, 15.0)
    carries_time = kind in (Kind.NAN, Kind.WRONG_TIME)
    if not carries_time and rng.random() < 0.35:
        amount = {Kind.DELAY: rng.uniform(0.02, 0.2)}.get(kind, rng.choice((0.1, 0.5, 0.9)))
        return Fault(kind, _one_way(rng, BRIDGE, AUTOPILOT), MAVLINK, start_s, duration_s, amount)
    action = SERVERS if rng.random() < 0.6 else rng.choice(tuple(ACTIONS))
    with_others = tuple((other, end) for other in others for end in (SIMULATOR, action))
    ends = rng.choice(((SIMULATOR, BRIDGE), (SIMULATOR, action), *with_others))
    if rng.random() < 0.5:  # what flies the vehicle
        ends = (BRIDGE, action)
    if not carries_time and rng.random() < 0.3:
        ends = (rng.choice(CLIENTS), rng.choice((action, BRIDGE)))
    amount = rng.choice((0.1, 0.5, 0.9))
    if kind is Kind.DELAY:
        amount = rng.uniform(0.05, 0.6)
    elif kind is Kind.WRONG_TIME:
        amount = rng.choice((-3600.0, -5.0, -1.0, -0.4, -0.2, 0.1, 1.0, 5.0, 3600.0))
    return Fault(kind, _one_way(rng, *ends), "bus", start_s, duration_s, amount)


def hits(fault: Fault, sender: str, receiver: str) -> bool:
    """Whether a fault of a link, or of one end, concerns what one sends to the other."""
    one, arrow, other = fault.where.partition(">")
    if not arrow:
        return one in (sender, receiver)
    return _is(one, sender) and _is(other, receiver)


def _is(name: str, who: str) -> bool:
    return who == name or (name == SERVERS and who in ACTIONS)


def _one_way(rng: Random, a: str, b: str) -> str:
    return f"{a}>{b}" if rng.random() < 0.5 else f"{b}>{a}"
