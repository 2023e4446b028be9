"""What a stack costs while its vehicle hovers: processor and memory by service, messages by topic."""

import time
from collections import Counter

import msgspec
import zenoh

from benchmarks.bare import direct
from benchmarks.stack import HOVER_ALTITUDE_M, Stack, cpu_ns, memory_mb
from jezero import Vehicle
from jezero.runtime.zenoh_session import client_config
from jezero.schemas.topics import TOPICS, key

CPU_S = 10.0
COUNT_S = 5.0


class Share(msgspec.Struct, frozen=True):
    """Of one process: share of a core, memory in MB, and memory with common pages divided among their users."""

    cpu: float
    rss_mb: float
    pss_mb: float


class Hover(msgspec.Struct, frozen=True):
    """What was seen.

    Attributes:
        rates_hz: by topic; only those that had a message.
        samples: one message in JSON of each; none of pictures.
    """

    processes: dict[str, Share]
    rates_hz: dict[str, float]
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
    """Take off, hover, and look."""
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
    return Hover(shares, rates_hz, samples)


def _listen(stack: Stack) -> tuple[dict[str, float], dict[str, bytes]]:
    """Messages per second of each topic, and one in JSON of each."""
    instance = stack.instance
    counts: Counter[str] = Counter()
    samples: dict[str, bytes] = {}

    def on_sample(sample: zenoh.Sample) -> None:
        name = str(sample.key_expr)
        counts[name] += 1
        if sample.encoding == zenoh.Encoding.APPLICATION_JSON:  # pictures are measured by benchmarks.camera
            samples[name] = sample.payload.to_bytes()

    with zenoh.open(client_config(instance.router)) as session:
        session.declare_subscriber(key(instance.vehicle, "**"), direct(on_sample))
        counts.clear()
        begin_s = time.monotonic()
        time.sleep(COUNT_S)
        spent_s = time.monotonic() - begin_s
        seen = {topic.name: key(instance.vehicle, topic.name) for topic in TOPICS}
        rates_hz = {name: counts[at] / spent_s for name, at in seen.items() if counts[at]}
    return rates_hz, {name: samples[at] for name in rates_hz if (at := seen[name]) in samples}
