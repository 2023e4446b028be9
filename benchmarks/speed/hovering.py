"""What a stack costs while its vehicle hovers: processor and memory by service, messages by topic, also in an orbit."""

import time
from collections import Counter

import msgspec
import zenoh

from benchmarks.speed.bare import direct
from benchmarks.speed.stack import HOVER_ALTITUDE_M, Stack, cpu_ns, memory_mb
from jezero import Vehicle
from jezero.schemas.topics import GET_IMAGES, TOPICS, feedback_of, key
from jezero.zenoh_client import client_config, data_of

CPU_S = 10.0
COUNT_S = 5.0
LISTENED = (*TOPICS, feedback_of(GET_IMAGES))
ORBIT_CENTER_M = (0.0, 0.0, -4.0)
"""Above the rover, whose tags the camera then sees."""
ORBIT_RADIUS_M = 2.0
PICTURES = 8


class Share(msgspec.Struct, frozen=True):
    """Of one process: share of a core, memory in MB, and memory with common pages divided among their users."""

    cpu: float
    rss_mb: float
    pss_mb: float


class Hover(msgspec.Struct, frozen=True):
    """What was seen.

    Attributes:
        rates_hz: by topic; only those that had a message.
        orbit_rates_hz: by topic, of those that had one only in an orbit around the rover.
        samples: one message of each.
    """

    processes: dict[str, Share]
    rates_hz: dict[str, float]
    orbit_rates_hz: dict[str, float]
    samples: dict[str, bytes]

    @property
    def cpu(self) -> float:
        """Of the whole stack, in cores."""
        return sum(share.cpu for share in self.processes.values())

    @property
    def cpu_without_camera(self) -> float:
        """The same without the process that makes the pictures."""
        return self.cpu - self.processes["camera"].cpu


def measure(stack: Stack) -> Hover:
    """Take off, hover, and look; then once more on the way around the rover."""
    instance = stack.instance
    with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
        uav.wait_ready()
        uav.takeoff(altitude_m=HOVER_ALTITUDE_M).result(timeout_s=60)
    time.sleep(1.0)
    pids = stack.processes()
    before = {name: cpu_ns(pid) for name, pid in pids.items()}
    begin_s = time.monotonic()
    time.sleep(CPU_S)
    spent_s = time.monotonic() - begin_s
    shares = {name: Share((cpu_ns(pid) - before[name]) / 1e9 / spent_s, *memory_mb(pid)) for name, pid in pids.items()}
    rates_hz, samples = _listen(stack)
    with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
        orbit = uav.get_images(ORBIT_CENTER_M, ORBIT_RADIUS_M, PICTURES, frame="rover")
        next(told for told in orbit.feedback() if told.taken)
        orbit_rates_hz, orbit_samples = _listen(stack)
    more_hz = {name: rate_hz for name, rate_hz in orbit_rates_hz.items() if name not in rates_hz}
    return Hover(shares, rates_hz, more_hz, orbit_samples | samples)


def _listen(stack: Stack) -> tuple[dict[str, float], dict[str, bytes]]:
    """Messages per second of each topic, and one of each."""
    instance = stack.instance
    counts: Counter[str] = Counter()
    samples: dict[str, bytes] = {}

    def on_sample(sample: zenoh.Sample) -> None:
        name = str(sample.key_expr)
        counts[name] += 1
        samples[name] = data_of(sample)

    with zenoh.open(client_config(instance.router)) as session:
        session.declare_subscriber(key(instance.vehicle, "**"), direct(on_sample))
        counts.clear()
        begin_s = time.monotonic()
        time.sleep(COUNT_S)
        spent_s = time.monotonic() - begin_s
        seen = {topic.name: key(instance.vehicle, topic.name) for topic in LISTENED}
        rates_hz = {name: counts[at] / spent_s for name, at in seen.items() if counts[at]}
    return rates_hz, {name: samples[seen[name]] for name in rates_hz}
