"""Cost of a hovering stack: processor and memory by service, messages by topic, also in an orbit."""

import time
from collections import Counter

import msgspec
import zenoh

from benchmarks.speed.bare import direct
from benchmarks.speed.stack import HOVER_ALTITUDE_M, Stack, cpu_ns, memory_mb
from jezero import Vehicle
from jezero.base.zenoh_client import client_config, data_of
from jezero.schemas.topics import GET_IMAGES, TOPICS, feedback_of, key

CPU_S = 10.0
COUNT_S = 5.0
COUNTED_TOPICS = (*TOPICS, feedback_of(GET_IMAGES))
ORBIT_CENTER_M = (0.0, 0.0, -4.0)
"""Centre of the orbit, above the rover, so that its tags are in view."""
ORBIT_RADIUS_M = 2.0
PICTURES = 8


class Share(msgspec.Struct, frozen=True):
    """Use of one process.

    Attributes:
        cpu: fraction of a core.
        rss_mb: resident memory.
        pss_mb: resident memory with shared pages divided among their users.
    """

    cpu: float
    rss_mb: float
    pss_mb: float


class Hover(msgspec.Struct, frozen=True):
    """Figures of a hovering stack.

    Attributes:
        processes: use by process.
        rates_hz: messages per second by topic, of topics with messages.
        orbit_rates_hz: the same in an orbit around the rover, of topics that had no message in the hover.
        samples: one message by topic.
    """

    processes: dict[str, Share]
    rates_hz: dict[str, float]
    orbit_rates_hz: dict[str, float]
    samples: dict[str, bytes]

    @property
    def cpu(self) -> float:
        """Processor time of the whole stack, in cores."""
        return sum(share.cpu for share in self.processes.values())

    @property
    def cpu_without_camera(self) -> float:
        """Processor time of the stack without the camera, in cores."""
        return self.cpu - self.processes["camera"].cpu


def measure(stack: Stack) -> Hover:
    """Take off, hover and measure; then count messages in an orbit."""
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
    rates_hz, samples = _count_messages(stack)
    with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
        orbit = uav.get_images(ORBIT_CENTER_M, ORBIT_RADIUS_M, PICTURES, frame="rover")
        next(feedback for feedback in orbit.feedback() if feedback.taken)
        orbit_rates_hz, orbit_samples = _count_messages(stack)
    more_hz = {name: rate_hz for name, rate_hz in orbit_rates_hz.items() if name not in rates_hz}
    return Hover(shares, rates_hz, more_hz, orbit_samples | samples)


def _count_messages(stack: Stack) -> tuple[dict[str, float], dict[str, bytes]]:
    """Messages per second by topic, and one message by topic."""
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
        keys = {topic.name: key(instance.vehicle, topic.name) for topic in COUNTED_TOPICS}
        rates_hz = {name: counts[at] / spent_s for name, at in keys.items() if counts[at]}
    return rates_hz, {name: samples[keys[name]] for name in rates_hz}
