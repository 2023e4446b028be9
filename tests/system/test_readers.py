"""Readers that stop, or can't keep up, on the ground and in each phase of a landing: nothing waits for them.

`pytest -rP` shows the measurements.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
import zenoh

from jezero import Vehicle
from jezero.base.zenoh_client import client_config
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from tests.system.conftest import Stack, wait_for, wait_for_status

pytestmark = pytest.mark.whole
TIMEOUT_S = 60.0
GAP_MAX_S = 1.0
"""Longest gap of a topic and longest reply, on a busy machine. A reader that is waited for costs 5 s and more."""
READER = Path(__file__).with_name("reader.py")
LONG_LEASE_MS = 60_000
WATCHED = (topics.STATUS, topics.ODOMETRY, topics.RELATIVE)


class Readers:
    """Programs that read everything, inside its `with` block; the stopped ones are killed as they are.

    Args:
        kinds: of each program that `add` starts, "stopped" or the seconds that it spends on each message.
    """

    def __init__(self, stack: Stack, kinds: tuple[str, ...], lease_ms: int) -> None:
        self._arguments = [sys.executable, str(READER), stack.instance.router, stack.instance.vehicle, str(lease_ms)]
        self._kinds = kinds
        self._ends = ExitStack()
        self._threads: list[threading.Thread] = []
        self.stopped = 0

    def __enter__(self) -> "Readers":
        return self

    def __exit__(self, *_: object) -> None:
        self.wait()
        self._ends.close()

    def add(self) -> None:
        """Start one program of each kind, in the background, so that a phase that is short is not over before."""
        thread = threading.Thread(target=self._add)
        self._threads.append(thread)
        thread.start()

    def wait(self) -> None:
        """Wait until all programs have read, and those that shall be stopped are."""
        for thread in self._threads:
            thread.join()

    def _add(self) -> None:
        started = [self._start("0" if kind == "stopped" else kind) for kind in self._kinds]
        for kind, reader in zip(self._kinds, started, strict=True):
            assert reader.stdout is not None
            assert reader.stdout.readline() == b"reads\n"
            if kind == "stopped":
                os.kill(reader.pid, signal.SIGSTOP)
                self.stopped += 1

    def _start(self, callback_s: str) -> "subprocess.Popen[bytes]":
        reader = subprocess.Popen(
            [*self._arguments, callback_s], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self._ends.enter_context(reader)
        self._ends.callback(reader.kill)
        return reader


@contextmanager
def measured(stack: Stack) -> Iterator[dict[str, float]]:
    """The longest gap of each watched topic and the longest reply of the bridge, in s, after the `with` block."""
    longest_s: dict[str, float] = {}
    arrivals_s: dict[str, list[float]] = {topic.name: [] for topic in WATCHED}
    ended = threading.Event()

    def on_sample(sample: zenoh.Sample) -> None:
        arrivals_s[str(sample.key_expr).split("/", 2)[2]].append(time.monotonic())

    def request() -> None:
        status = topics.key(stack.instance.vehicle, topics.STATUS.name)
        while not ended.wait(0.1):
            begin_s = time.monotonic()
            replied = any(reply.ok for reply in session.get(status, timeout=TIMEOUT_S))
            took_s = time.monotonic() - begin_s if replied else TIMEOUT_S
            longest_s["reply"] = max(longest_s.get("reply", 0.0), took_s)

    with zenoh.open(client_config(stack.instance.router)) as session:
        subscribers = [
            session.declare_subscriber(topics.key(stack.instance.vehicle, topic.name), on_sample) for topic in WATCHED
        ]
        requests = threading.Thread(target=request)
        requests.start()
        yield longest_s
        ended.set()
        requests.join()
        for subscriber in subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
    for name, times_s in arrivals_s.items():
        longest_s[name] = max(after - before for before, after in pairwise([*times_s, time.monotonic()]))


@pytest.mark.long
@pytest.mark.parametrize(
    ("kinds", "lease_ms"),
    [
        pytest.param(("stopped",), 0, id="one stopped reader", marks=pytest.mark.slow),
        pytest.param(("stopped",) * 3, LONG_LEASE_MS, id="three stopped readers with a long lease"),
        pytest.param(("0.3", "0"), 0, id="a slow reader and one that takes everything"),
    ],
)
def test_a_landing_goes_on_and_hover_is_answered_whatever_the_readers_do(
    shared_stack: Stack, kinds: tuple[str, ...], lease_ms: int
) -> None:
    before = shared_stack.processes()
    closed_before = closed_links(shared_stack)
    with (
        shared_stack.connect() as vehicle,
        Readers(shared_stack, kinds, lease_ms) as readers,
        measured(shared_stack) as longest_s,
    ):
        vehicle.wait_ready(TIMEOUT_S)
        readers.add()
        readers.wait()
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=TIMEOUT_S)
        readers.add()
        longest_s["hover"] = hover(vehicle)
        phases: list[str] = []
        goal = vehicle.land_on_spot()
        for feedback in goal.feedback():
            if feedback.phase not in phases:
                phases.append(feedback.phase)
                readers.add()
        goal.result(timeout_s=TIMEOUT_S)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE and not s.armed, TIMEOUT_S, "disarmed")
        readers.wait()
        all_stopped = closed_before + readers.stopped
        wait_for(lambda: closed_links(shared_stack) >= all_stopped, TIMEOUT_S, "the stopped readers' links closed")
    print(f"{', '.join(phases)}: " + ", ".join(f"{name} {value_s:.2f} s" for name, value_s in longest_s.items()))
    assert {"approach", "descent"} <= set(phases)
    assert max(longest_s.values()) < GAP_MAX_S
    assert shared_stack.processes() == before
    if readers.stopped:
        assert "stopped reading, link closed: 127.0.0.1:" in shared_stack.jezero("ps").stdout


def hover(vehicle: Vehicle) -> float:
    """Request a hover; returns the seconds until the reply."""
    begin_s = time.monotonic()
    vehicle.hover()
    return time.monotonic() - begin_s


def closed_links(stack: Stack) -> int:
    """Number of sessions whose link was closed because they stopped reading, by the router's log."""
    lines = (stack.run_dir / "logs" / "router.log").read_text().splitlines()
    return len([line for line in lines if "stopped reading" in line])
