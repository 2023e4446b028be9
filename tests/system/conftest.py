"""Whole stacks of real processes, each on ports, keys and a run folder of its own."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from jezero import Vehicle
from jezero.deploy.launcher.ports import instance_environment, reserved_instance
from jezero.runtime.config import Instance
from jezero.schemas.state import Status

GCS_PORT = 17550
"""Of instance 0: each stack has a ground station's port of its own."""
JEZERO = [sys.executable, "-m", "jezero.cli.main"]


@dataclass
class Stack:
    """A running stack and how to reach it."""

    instance: Instance
    run_dir: Path
    environment: dict[str, str]
    processes_cached: dict[str, int] = field(default_factory=dict)
    """Process id of each service as of the start: no command has to run before something is killed."""

    def jezero(self, *words: str, check: bool = True, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
        """Run a jezero command against this stack."""
        done = subprocess.run(
            [*JEZERO, *words], env=self.environment, capture_output=True, text=True, timeout=timeout_s, check=False
        )
        if check and done.returncode != 0:
            raise AssertionError(f"jezero {' '.join(words)}: exit {done.returncode}\n{done.stdout}\n{done.stderr}")
        return done

    def start(self, *words: str) -> "subprocess.Popen[str]":
        """Start a jezero command and leave it running."""
        return subprocess.Popen(
            [*JEZERO, *words], env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def connect(self) -> Vehicle:
        """A client of this stack."""
        return Vehicle.connect(self.instance.vehicle, router=self.instance.router)

    def processes(self) -> dict[str, int]:
        """Process id of each running service."""
        rows = json.loads(self.jezero("ps", "--json").stdout)
        return {row["service"]: row["pid"] for row in rows if row["pid"]}


def wait_for(condition: Callable[[], bool], within_s: float, what: str) -> float:
    """Poll until it holds; returns how long that took in seconds.

    Raises:
        AssertionError: it didn't within the time.
    """
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > within_s:
            raise AssertionError(f"{what}: not within {within_s} s")
        time.sleep(0.01)
    return time.monotonic() - start


def wait_for_status(vehicle: Vehicle, condition: Callable[[Status], bool], within_s: float, what: str) -> float:
    """`wait_for` on the newest status."""
    return wait_for(lambda: condition(vehicle.status()), within_s, what)


@pytest.fixture
def start_stack(tmp_path: Path) -> Iterator[Callable[..., Stack]]:
    """Start a stack with `jezero up -d --wait` and extra words; stopped when the test ends."""
    started: list[Stack] = []

    with reserved_instance(vehicle=f"t{os.getpid()}") as instance:

        def start(*words: str) -> Stack:
            run_dir = tmp_path / "run"
            environment = {
                **os.environ,
                **instance_environment(instance),
                "JEZERO_GCS_PORT": str(GCS_PORT + instance.number),
                "JEZERO_RUN_DIR": str(run_dir),
            }
            stack = Stack(instance, run_dir, environment)
            started.append(stack)
            stack.jezero("up", "-d", "--wait", "--timeout", "60", *words)
            stack.processes_cached = stack.processes()
            return stack

        yield start
        for stack in started:
            stack.jezero("down", check=False)


@pytest.fixture
def stack(start_stack: Callable[..., Stack]) -> Stack:
    """A stack with the shipped compose file, ready to fly."""
    return start_stack()
