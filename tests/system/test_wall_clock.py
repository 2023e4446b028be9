"""The wall clock jumps by an hour in flight, ahead and back, for every process of a stack and for its client."""

import json
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import zenoh

from jezero.base.zenoh_client import client_config
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from tests.system.conftest import Stack, new_stack
from tests.system.test_twin import START_TIMEOUT_S, fly_it, running_twin

HOUR_S = 3600
STEP_MAX_NS = 10_000_000_000
"""Time between two statuses, far below the jumps of the wall clock and far above any stall."""
SOURCE = Path(__file__).with_name("wall_clock.c")
CLOCKS = """
import sys, time, zenoh
config = zenoh.Config()
config.insert_json5("listen/endpoints", "[]")
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    for _ in sys.stdin:
        print(time.time(), session.new_timestamp().get_time().timestamp(), time.monotonic(), flush=True)
"""


class WallClock:
    """Wall clock of all processes that are started with its environment variables."""

    def __init__(self, folder: Path, compiler: str) -> None:
        library, self._offset = folder / "wall_clock.so", folder / "offset"
        subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"], check=True)
        self._offset.write_bytes(struct.pack("=q", 0))
        self.variables = {"LD_PRELOAD": str(library), "WALL_CLOCK_OFFSET": str(self._offset)}

    def set(self, ahead_s: int) -> None:
        """Set the offset from the machine's clock, from now on."""
        with self._offset.open("r+b") as file:
            file.write(struct.pack("=q", ahead_s))


@pytest.fixture
def wall_clock(tmp_path: Path) -> WallClock:
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler is installed: nothing else moves the clock of a process from outside")
    return WallClock(tmp_path, compiler)


@pytest.fixture
def stack(wall_clock: WallClock, tmp_path: Path) -> Iterator[Stack]:
    with new_stack(tmp_path) as new:
        new.environment.update(wall_clock.variables)
        yield new.up()


def test_a_jump_reaches_pythons_clock_and_zenohs_but_not_the_monotonic_one(wall_clock: WallClock) -> None:
    environment = {**os.environ, **wall_clock.variables}
    process = subprocess.Popen(
        [sys.executable, "-c", CLOCKS], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None and process.stdout is not None

    def clocks() -> list[float]:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write("\n")
        process.stdin.flush()
        return [float(word) for word in process.stdout.readline().split()]

    with process:
        before = clocks()
        for ahead_s in (HOUR_S, -HOUR_S):
            wall_clock.set(ahead_s)
            python_s, zenoh_s, monotonic_s = (a - b for a, b in zip(clocks(), before, strict=True))
            assert python_s == pytest.approx(ahead_s, abs=60) and zenoh_s == pytest.approx(ahead_s, abs=60)
            assert 0.0 <= monotonic_s < 60.0
        process.stdin.close()


def check_that_jumps_change_nothing(stack: Stack, wall_clock: WallClock) -> None:
    """Fly to a target while the wall clock jumps ahead, back and to its place again."""
    statuses: list[dict[str, Any]] = []
    stack.jezero("takeoff", "2")
    with zenoh.open(client_config(stack.instance.router)) as session:
        key = topics.key(stack.instance.vehicle, topics.STATUS.name)
        session.declare_subscriber(key, lambda sample: statuses.append(json.loads(sample.payload.to_string())))
        process = stack.start("target", "6", "0", "-3", "--json")
        assert process.stdout is not None
        jumps = {10: HOUR_S, 25: -HOUR_S, 35: 0}
        lines: list[dict[str, Any]] = []
        for text in process.stdout:
            lines.append(json.loads(text))
            if len(lines) in jumps:
                wall_clock.set(jumps[len(lines)])
        process.communicate(timeout=10)
    assert (lines[-1]["type"], lines[-1]["outcome"]) == ("result", "succeeded")
    assert len(lines) > max(jumps)
    flight = [StatusCode.HOVER, StatusCode.GO_TO, StatusCode.GO_TO_DONE]
    assert {status["code"] for status in statuses} <= set(flight)
    assert len({(status["epoch_id"], status["bridge_boot_id"]) for status in statuses}) == 1
    times_ns = [status["t_ns"] for status in statuses]
    # Vehicle time steps back by as long as its master stood still, which a loaded machine does for milliseconds.
    assert all(abs(after - before) < STEP_MAX_NS for before, after in pairwise(times_ns))


@pytest.mark.long
def test_a_wall_clock_that_jumps_in_flight_changes_nothing(stack: Stack, wall_clock: WallClock) -> None:
    check_that_jumps_change_nothing(stack, wall_clock)
    assert stack.processes() == stack.processes_cached


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_on_hardware_a_wall_clock_that_jumps_in_flight_changes_nothing(
    unstarted: Stack, wall_clock: WallClock, tmp_path: Path
) -> None:
    """The flight controller's clock, which the stack follows, is another one than this computer's."""
    with running_twin(tmp_path):
        unstarted.environment.update(wall_clock.variables)
        fly_it(unstarted, tmp_path)
        with unstarted.connect() as uav:
            uav.wait_ready(START_TIMEOUT_S)
        check_that_jumps_change_nothing(unstarted, wall_clock)
