"""Whole stacks of real processes, each on ports, keys and a run folder of its own."""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import pytest

from jezero import Vehicle
from jezero.deploy.launcher.ports import instance_environment, reserved_instance
from jezero.runtime.config import Instance
from jezero.schemas.state import Status
from tests.system.overheard import Tap

GCS_PORT = 17550
"""Of instance 0: each stack has a ground station's port of its own."""
PX4_GCS_PORT = 14550
HERE = Path(__file__).parent
JEZERO = [sys.executable, "-m", "jezero.cli.main"]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """One stack at a time with `pytest --dist loadgroup`: it needs a core and a half, and there may be two."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.xdist_group("stack"))


@dataclass
class Stack:
    """A running stack and how to reach it."""

    instance: Instance
    run_dir: Path
    environment: dict[str, str]
    processes_cached: dict[str, int] = field(default_factory=dict)
    """Process id of each service as of the start: no command has to run before something is killed."""

    def choose(self, autopilot: str) -> None:
        """Who flies once it is started; PX4's start script knows one port for ground stations only."""
        port = PX4_GCS_PORT if autopilot == "px4" else GCS_PORT + self.instance.number
        self.environment |= {"JEZERO_AUTOPILOT": autopilot, "JEZERO_GCS_PORT": str(port)}

    def up(self, *words: str) -> Self:
        """Start it, with extra words, and wait until the vehicle is ready."""
        self.jezero("up", "-d", "--wait", "--timeout", "60", *words)
        self.processes_cached = self.processes()
        return self

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


def wait_for(condition: Callable[[], object], within_s: float, what: str) -> float:
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


class ProcessorWait:
    """For how long all threads of some processes wait for a processor from now on: what a busy machine costs them."""

    def __init__(self, processes: Iterable[int]) -> None:
        self._before_ns = {pid: _waited_ns(pid) for pid in processes}

    def seconds(self, started: Iterable[int] = ()) -> float:
        """So far, with that of processes which were started since."""
        after_ns = {pid: _waited_ns(pid) for pid in (*self._before_ns, *started)}
        return sum(max(0, ns - self._before_ns.get(pid, 0)) for pid, ns in after_ns.items()) * 1e-9


def _waited_ns(pid: int) -> int:
    """Of all threads of a process; 0 once it has ended. Source: proc(5), sched-stats.rst."""
    waited_ns = 0
    for thread in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError):  # it has ended
            waited_ns += int(thread.read_text().split()[1])
    return waited_ns


def wait_for_status(vehicle: Vehicle, condition: Callable[[Status], bool], within_s: float, what: str) -> float:
    """`wait_for` on the newest status; a failure tells that status."""
    try:
        return wait_for(lambda: condition(vehicle.status()), within_s, what)
    except AssertionError as error:
        status = vehicle.status()
        raise AssertionError(f"{error}; {status.code} {status.name}: {status.text} {status.not_ready_reason}") from None


@contextmanager
def new_stack(folder: Path) -> Iterator[Stack]:
    """A stack that `up` starts, with ports of its own; stopped at the end.

    Args:
        folder: for what it leaves.
    """
    with reserved_instance(vehicle=f"t{os.getpid()}") as instance:
        run_dir = folder / "run"
        environment = {
            **os.environ,
            **instance_environment(instance),
            "JEZERO_RUN_DIR": str(run_dir),
        }
        stack = Stack(instance, run_dir, environment)
        stack.choose(os.environ.get("JEZERO_AUTOPILOT") or "embedded")
        yield stack
        stack.jezero("down", check=False)


@pytest.fixture
def unstarted(tmp_path: Path) -> Iterator[Stack]:
    """A stack with ports and keys of its own, for `up` to start."""
    with new_stack(tmp_path) as stack:
        yield stack


@pytest.fixture
def start_stack(unstarted: Stack) -> Callable[..., Stack]:
    """Start a stack with `jezero up -d --wait` and extra words."""
    return unstarted.up


@pytest.fixture
def tap(tmp_path: Path, unstarted: Stack) -> Iterator[Tap]:
    """What the bridge will send to the autopilot, once the stack is started with the tap's words."""
    tap = Tap(unstarted.instance, tmp_path)
    yield tap
    tap.close()


@pytest.fixture
def stack(start_stack: Callable[..., Stack]) -> Stack:
    """A stack with the shipped compose file, ready to fly."""
    return start_stack()


@pytest.fixture(scope="module")
def shared_stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The same for all tests of a file, in whatever state the one before has left it."""
    with new_stack(tmp_path_factory.mktemp("shared")) as stack:
        yield stack.up()
