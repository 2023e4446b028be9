"""Processor time of one message: at its writer, in the router and at each reader.

Two services on a router of their own exchange messages of one topic after the other through the shipped runtime:
encoding, decoding with all its checks, and the wake-ups, which are most of it.
"""

import json
import sys
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.speed.stack import cpu_ns, running_module, running_router
from jezero.base.codec import decode
from jezero.deploy.launcher.ports import reserved_instance
from jezero.runtime.instance import instance_from_environment
from jezero.runtime.process import new_boot_id, run_service
from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas.rows import Topic
from jezero.schemas.struct import Message
from jezero.schemas.topics import ACTIONS, TOPICS, feedback_of

OWN_MODULE = "benchmarks.speed.message_cost"
RATE_HZ = 100.0
COUNT = 200
"""Number of messages of each topic."""
NAMED = {topic.name: topic for topic in (*TOPICS, *map(feedback_of, ACTIONS.values()))}


class Cost(msgspec.Struct, frozen=True):
    """Processor time of one message in us."""

    size_bytes: int
    writer_us: float
    router_us: float
    reader_us: float


class Writer:
    """Publishes `COUNT` messages of each topic in turn, at first none, and prints the three processes' time for each.

    Args:
        router_pid: process id of the router.
        reader_pid: process id of the reader.
    """

    def __init__(self, messages: Mapping[str, Message], router_pid: int, reader_pid: int) -> None:
        self.spec = Spec(name="writer", outputs=tuple(NAMED[name] for name in messages), rate_hz=RATE_HZ)
        self._plan: list[tuple[Topic[Any], Message] | None] = [None, *((NAMED[n], m) for n, m in messages.items())]
        self._pids = (router_pid, reader_pid)
        self._steps = 0
        self._before: tuple[int, ...] = ()

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        phase, step = divmod(self._steps, COUNT)
        if step == 0:
            now = (time.process_time_ns(), *map(cpu_ns, self._pids))
            if self._before:
                print(json.dumps([b - a for a, b in zip(self._before, now, strict=True)]), flush=True)
            self._before = now
        self._steps += 1
        if phase < len(self._plan) and (item := self._plan[phase]) is not None:
            topic, message = item
            yield Publish(topic, msgspec.structs.replace(message, t_ns=self._steps))


class Reader:
    """Steps on each message."""

    def __init__(self, names: Iterable[str]) -> None:
        topics = tuple(NAMED[name] for name in names)
        self.spec = Spec(name="reader", inputs=topics, triggers=tuple(t.name for t in topics), rate_hz=1.0)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        return ()


def measure(samples: Mapping[str, bytes], folder: Path) -> dict[str, Cost]:
    """Measure the cost of a message, by topic.

    Args:
        samples: one payload by topic, as it is on the bus.
    """
    path = folder / "samples.json"
    path.write_bytes(msgspec.json.encode(samples))
    with reserved_instance(vehicle="cost") as reserved, ExitStack() as stack:
        router_pid, instance = stack.enter_context(running_router(reserved, folder))
        reader = stack.enter_context(running_module(OWN_MODULE, "reader", str(path), instance=instance))
        time.sleep(2.0)
        writer = stack.enter_context(
            running_module(
                OWN_MODULE,
                "writer",
                str(path),
                str(router_pid),
                str(reader.pid),
                instance=instance,
            )
        )
        assert writer.stdout is not None
        idle, *used = (json.loads(writer.stdout.readline()) for _ in range(1 + len(samples)))
    return {
        name: Cost(len(data), *((ns - idle_ns) / COUNT / 1e3 for ns, idle_ns in zip(spent, idle, strict=True)))
        for (name, data), spent in zip(samples.items(), used, strict=True)
    }


def main() -> int:
    role, path, *pids = sys.argv[1:]
    samples = msgspec.json.decode(Path(path).read_bytes(), type=dict[str, bytes])
    messages = {name: decode(NAMED[name].type, data) for name, data in samples.items()}
    service = Reader(messages) if role == "reader" else Writer(messages, *map(int, pids))
    return run_service(service, instance_from_environment(), new_boot_id())


if __name__ == "__main__":
    sys.exit(main())
