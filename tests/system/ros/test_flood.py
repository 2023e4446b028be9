"""A flooded bridge is nothing to the vehicle: it flies as without the bridge."""

import json
import os
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import pairwise
from math import hypot
from pathlib import Path
from typing import Any

import pytest
import zenoh

from jezero import Vehicle
from jezero.base.codec import decode
from jezero.base.zenoh_client import client_config, data_of
from jezero.client.errors import JezeroError
from jezero.schemas.rows import Topic
from jezero.schemas.topics import ODOMETRY, SETPOINT, STATUS, key
from tests.system.conftest import ProcessorWait, Stack
from tests.system.ros.conftest import Ros
from tests.system.ros.test_bridge import START_TIMEOUT_S, running_bridge

pytestmark = [pytest.mark.slow, pytest.mark.whole, pytest.mark.timeout(1200)]
FLOODER = Path(__file__).with_name("flooder.py")
NICE = ("setsid", "sh", "-c", 'echo 10 2>&- > /proc/self/autogroup; exec nice -n 10 "$@"', "nice")
"""ROS gets few of the processors, as if it were on another computer: this test asks what reaches the vehicle through
the bridge, not who gets a processor. Where Linux groups processes by their session, which desktops do, `nice` alone
ranks them in their session only, and each process of the stack has a session of its own. Source: sched(7), the
autogroup feature."""
HEIGHT_M, AWAY_M, SPEED_MPS = 3.0, 20.0, 0.6
RATE_SHARE_MIN, LATE_MORE_MAX, SLOWER_MAX, OFF_LINE_MORE_MAX_M = 0.9, 0.05, 1.05, 0.2
LATE_PERIODS = 3.0
"""A topic that has not come for so many of its periods is late. The flights are compared by the share of time for which
it was, as on a busy machine the longest gap of two flights differs by chance."""
FLOODED_MIN_S = 10.0
COST_MAX = 0.05
"""Share of a processor that each process of the stack may use more than without a flood of requests."""
WATCHED: tuple[Topic[Any], ...] = (SETPOINT, ODOMETRY, STATUS)


@dataclass
class Flight:
    """What the vehicle published while one goal was in charge.

    Attributes:
        goal_id: of the goal.
        messages: of each topic, in the order of their arrival.
        duration_s: vehicle time that the goal was in charge.
        waited_s: time that the stack's processes waited for a processor, on a busy machine.
        watched_s: time of the clock of the wall for which it was measured, with the flood if there is one.
        cpu: share of a processor that each of the stack's processes has used.
    """

    goal_id: str = ""
    messages: dict[str, list[Any]] = field(default_factory=dict)
    duration_s: float = 0.0
    waited_s: float = 0.0
    watched_s: float = 0.0
    cpu: dict[str, float] = field(default_factory=dict)

    def end(self) -> None:
        """Leave out what was published before and after the goal: then a goal of the flood may be accepted."""
        times_ns = [each.t_ns for each in self.messages[STATUS.name] if each.goal_id == self.goal_id]
        for name, messages in self.messages.items():
            self.messages[name] = [each for each in messages if times_ns[0] <= each.t_ns <= times_ns[-1]]
        self.duration_s = (times_ns[-1] - times_ns[0]) * 1e-9

    def rate_hz(self, topic: Topic[Any]) -> float:
        messages = self.messages[topic.name]
        return (len(messages) - 1) * 1e9 / float(messages[-1].t_ns - messages[0].t_ns)

    def late(self, topic: Topic[Any]) -> float:
        """Share of the flight's time in gaps that are longer than `LATE_PERIODS`."""
        assert topic.rate_hz is not None
        late_s = LATE_PERIODS / topic.rate_hz
        gaps_s: list[float] = [(b.t_ns - a.t_ns) * 1e-9 for a, b in pairwise(self.messages[topic.name])]
        return sum(gap_s for gap_s in gaps_s if gap_s > late_s) / sum(gaps_s)

    def gap_s(self, topic: Topic[Any]) -> float:
        return float(max(b.t_ns - a.t_ns for a, b in pairwise(self.messages[topic.name]))) * 1e-9

    @property
    def off_line_m(self) -> float:
        """Greatest distance from the line that is flown, to the side and in height."""
        at_m = [each.pos_uav_ned_m for each in self.messages[ODOMETRY.name]]
        return max(hypot(east_m, down_m + HEIGHT_M) for _, east_m, down_m in at_m)

    def __str__(self) -> str:
        rates = (
            f"{topic.name} {self.rate_hz(topic):.1f} Hz, late for {100 * self.late(topic):.1f} %, "
            f"longest gap {self.gap_s(topic):.3f} s"
            for topic in WATCHED
        )
        measured = f"measured for {self.watched_s:.1f} s, waited {self.waited_s:.1f} s"
        flown = f"{self.duration_s:.1f} s, {measured}, {self.off_line_m:.2f} m off the line"
        cpu = ", ".join(f"{name} {100 * share:.1f} %" for name, share in self.cpu.items())
        return f"{flown}, {', '.join(rates)}; processors: {cpu}"


def fly(stack: Stack, uav: Vehicle, flood: AbstractContextManager[Callable[[], None]]) -> Flight:
    """Fly to the north; the flood, which is ready, begins when the goal has."""
    uav.go_to(0.0, 0.0, -HEIGHT_M).result(START_TIMEOUT_S)
    flight = Flight(messages={topic.name: [] for topic in WATCHED})

    def watch(topic: Topic[Any]) -> None:
        def on_sample(sample: zenoh.Sample) -> None:
            flight.messages[topic.name].append(decode(topic.type, data_of(sample)))

        session.declare_subscriber(key(stack.instance.vehicle, topic.name), on_sample)

    with zenoh.open(client_config(stack.bus)) as session, flood as begin:
        for topic in WATCHED:
            watch(topic)
        goal = uav.go_to(AWAY_M, 0.0, -HEIGHT_M, speed_mps=SPEED_MPS)
        flight.goal_id = goal.goal_id
        begin()
        waiting, begin_s = ProcessorWait(stack.processes_cached.values()), time.monotonic()
        before_s = {name: cpu_s(pid) for name, pid in stack.processes_cached.items()}
        try:
            goal.result(START_TIMEOUT_S)
        except JezeroError as error:
            raise AssertionError(f"{error}; the stack waited {waiting.seconds():.0f} s for processors") from error
        flight.waited_s = waiting.seconds()
        flight.watched_s = time.monotonic() - begin_s
        after_s = {name: cpu_s(pid) for name, pid in stack.processes_cached.items()}
        flight.cpu = {name: (after_s[name] - before_s[name]) / flight.watched_s for name in after_s}
    flight.end()
    return flight


def cpu_s(pid: int) -> float:
    """Time for which a process has used a processor. Source: proc(5), utime and stime."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Flood:
    """A process that floods; the newest counts that it has printed."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self.counts: dict[str, int] = {}
        self.ready, self.flowing = threading.Event(), threading.Event()
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.ready.set()
            self.counts = json.loads(line)
            if self.counts:
                self.flowing.set()

    def begin(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        assert self.flowing.wait(START_TIMEOUT_S), "the flood does not flow"


@contextmanager
def flooded(stack: Stack, ros: Ros, what: str, counts: dict[str, int]) -> Iterator[Callable[[], None]]:
    """What begins a flood that is ready; `counts` gets how much of it there was."""
    with subprocess.Popen(
        [*NICE, ros.python, str(FLOODER), stack.instance.vehicle, what],
        env=ros.environment(stack.environment),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        flood = Flood(process)
        try:
            assert flood.ready.wait(START_TIMEOUT_S), "the flood is not ready"
            yield flood.begin
        finally:
            process.kill()
            flood.reader.join()
            counts |= flood.counts


@pytest.fixture(scope="module")
def uav(shared_stack: Stack) -> Iterator[Vehicle]:
    with shared_stack.connect() as uav:
        uav.wait_ready(START_TIMEOUT_S)
        uav.takeoff(altitude_m=HEIGHT_M).result(START_TIMEOUT_S)
        yield uav
        uav.hover()
        uav.land_on_spot((0.0, 0.0, 0.0), use_uwb=False, use_tag=False).result(START_TIMEOUT_S)


@pytest.fixture(scope="module")
def alone(shared_stack: Stack, uav: Vehicle) -> Flight:
    """The flight without a bridge."""
    return fly(shared_stack, uav, nullcontext(lambda: None))


@pytest.mark.parametrize("what", ["requests", "images"])
def test_a_flooded_bridge_is_nothing_to_the_vehicle(
    shared_stack: Stack, ros_with_interfaces: Ros, uav: Vehicle, alone: Flight, what: str
) -> None:
    with running_bridge(shared_stack, ros_with_interfaces, "--commands", before=NICE):
        counts: dict[str, int] = {}
        flight = fly(shared_stack, uav, flooded(shared_stack, ros_with_interfaces, what, counts))
    uav.hover()  # the bridge, which has ended, may have passed on a goal that waited in it
    shown = f"the flood: {counts}; without: {alone}; with: {flight}"
    print(shown)
    assert flight.watched_s > FLOODED_MIN_S, f"the flood began late; {shown}"
    for topic in WATCHED:
        # A topic of the wall's clock comes more often in vehicle time where that is slow.
        assert topic.rate_hz is not None
        rate_hz = min(alone.rate_hz(topic), topic.rate_hz)
        assert flight.rate_hz(topic) > RATE_SHARE_MIN * rate_hz, f"{topic.name}; {shown}"
        assert flight.late(topic) < alone.late(topic) + LATE_MORE_MAX, f"{topic.name}; {shown}"
    if what == "requests":
        for name, share in flight.cpu.items():
            assert share < alone.cpu[name] + COST_MAX, f"{name}; {shown}"
    assert flight.duration_s < SLOWER_MAX * alone.duration_s, shown
    assert flight.off_line_m < alone.off_line_m + OFF_LINE_MORE_MAX_M, shown
    statuses = flight.messages[STATUS.name]
    assert {each.goal_id for each in statuses} == {flight.goal_id}
    assert {each.code for each in statuses} <= {each.code for each in alone.messages[STATUS.name]}
    assert all(each.ready for each in statuses)
