"""Whole stacks of real processes, each on ports, keys and a run folder of its own."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import pytest

from jezero import Unreachable, Vehicle
from jezero.base.config import config_directory
from jezero.deploy.launcher.ports import instance_environment, reserved_instance, service_environment
from jezero.runtime.instance import Instance, socket_of
from jezero.schemas.state import Status, StatusCode
from tests.keys.rig import free_port
from tests.system.bridge_observation import Tap

GCS_PORT = 17550
"""Ground station's port of instance 0; the ports of other instances follow."""
PX4_GCS_PORT = 14550
UP_TIMEOUT_S = 150.0
"""A quiet machine needs 6 s, a busy one more than a minute."""
HERE = Path(__file__).parent
JEZERO = [sys.executable, "-m", "jezero.cli.main"]


FAILED = pytest.StashKey[bool]()
"""Whether the set-up or the call of a test has failed."""
TIMEOUT = pytest.StashKey[object]()
"""Settings of pytest-timeout for a test."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let `pytest --dist loadgroup` run at most two stacks at a time, because more of them would need more processors.

    There are two groups of tests, and each runs in one worker: the files belong to the one and to the other by turns.
    The tests of ROS 2 are all in the same group, because they share an installation.

    A test that fails runs once more, because other programs may keep real processes from a processor; but not in a
    debugger, which pytest-rerunfailures refuses.
    """
    reruns = 0 if config.getoption("usepdb") else 1
    places = [item.path.relative_to(HERE).parts[0] for item in items if HERE in item.path.parents]
    number_of = {place: number for number, place in enumerate(sorted(set(places)))}
    for item in items:
        if HERE in item.path.parents:
            number = number_of[item.path.relative_to(HERE).parts[0]]
            item.add_marker(pytest.mark.xdist_group(f"stack {number % 2}"))
            item.add_marker(pytest.mark.flaky(reruns=reruns))


@pytest.hookimpl(tryfirst=True)
def pytest_timeout_set_timer(item: pytest.Item, settings: object) -> None:
    """Keep the settings for `pytest_runtest_setup`; pytest-timeout itself sets the timer."""
    item.stash[TIMEOUT] = settings


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Set the timer of a second run: the first failure has ended it, so a test that hangs would never end."""
    if item.stash.get(FAILED, False) and TIMEOUT in item.stash:
        item.config.hook.pytest_timeout_set_timer(item=item, settings=item.stash[TIMEOUT])
    item.stash[FAILED] = False


def pytest_exception_interact(node: pytest.Item | pytest.Collector) -> None:
    """Note a failure."""
    node.stash[FAILED] = True


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> None:
    """Stop the shared stacks after a failure, so that the second run and the tests after it get new ones.

    pytest-rerunfailures would keep them, and forget to stop those that start in the second run.
    """
    if item.stash.get(FAILED, False):
        item.session._setupstate.teardown_exact(None)


@dataclass
class Stack:
    """A stack, and the commands to start and reach it."""

    instance: Instance
    run_dir: Path
    environment: dict[str, str]
    processes_cached: dict[str, int] = field(default_factory=dict)
    """Process id of each service at the start, so that a test can kill one without running a command first."""
    before: tuple[str, ...] = ()
    """Words before each command, which run it on another computer of a `Network`."""

    @property
    def bus(self) -> str:
        """Address of the router for services."""
        return socket_of(self.run_dir)

    @property
    def service_environment(self) -> dict[str, str]:
        """Environment of a service that a test starts itself."""
        return {**self.environment, **service_environment(self.instance, self.run_dir)}

    def choose_autopilot(self, autopilot: str) -> None:
        """Set the autopilot of the next start. PX4's start script has one port for ground stations only."""
        port = PX4_GCS_PORT if autopilot == "px4" else GCS_PORT + self.instance.number
        self.environment |= {"JEZERO_AUTOPILOT": autopilot, "JEZERO_GCS_PORT": str(port)}

    def up(self, *words: str) -> Self:
        """Start the stack, with extra words, and wait until the vehicle is ready."""
        self.jezero("up", "-d", "--wait", "--timeout", f"{UP_TIMEOUT_S:g}", *words, timeout_s=2 * UP_TIMEOUT_S)
        self.processes_cached = self.processes()
        return self

    def jezero(self, *words: str, check: bool = True, timeout_s: float = 120) -> subprocess.CompletedProcess[str]:
        """Run a jezero command against this stack."""
        done = subprocess.run(
            [*self.before, *JEZERO, *words],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )
        if check and done.returncode != 0:
            raise AssertionError(f"jezero {' '.join(words)}: exit {done.returncode}\n{done.stdout}\n{done.stderr}")
        return done

    def start(self, *words: str) -> "subprocess.Popen[str]":
        """Start a jezero command and leave it running."""
        return subprocess.Popen(
            [*self.before, *JEZERO, *words],
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def connect(self) -> Vehicle:
        """A client of this stack."""
        return Vehicle.connect(self.instance.vehicle, router=self.instance.router)

    def processes(self) -> dict[str, int]:
        """Process id of each running service."""
        rows = json.loads(self.jezero("ps", "--json").stdout)
        return {row["service"]: row["pid"] for row in rows if row["pid"]}


def wait_for(condition: Callable[[], object], timeout_s: float, description: str) -> float:
    """Poll until a condition holds; returns the seconds that this took.

    Args:
        description: of the condition, for the error.

    Raises:
        AssertionError: the condition did not hold in time.
    """
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > timeout_s:
            raise AssertionError(f"{description}: not within {timeout_s} s")
        time.sleep(0.01)
    return time.monotonic() - start


class ProcessorWait:
    """Measures the time that all threads of some processes wait for a processor from now on, on a busy machine."""

    def __init__(self, processes: Iterable[int]) -> None:
        self._before_ns = {pid: _waited_ns(pid) for pid in processes}

    def seconds(self, started: Iterable[int] = ()) -> float:
        """Sum so far, including the given processes that were started since."""
        after_ns = {pid: _waited_ns(pid) for pid in (*self._before_ns, *started)}
        return sum(max(0, ns - self._before_ns.get(pid, 0)) for pid, ns in after_ns.items()) * 1e-9


def _waited_ns(pid: int) -> int:
    """Waiting time of all threads of a process; 0 once it has ended. Source: proc(5), sched-stats.rst."""
    waited_ns = 0
    for thread in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError):  # it has ended
            waited_ns += int(thread.read_text().split()[1])
    return waited_ns


def has_status(vehicle: Vehicle) -> bool:
    """Whether there is a status: a restarted bridge is healthy shortly before its first status."""
    with contextlib.suppress(Unreachable):
        vehicle.status()
        return True
    return False


def wait_for_status(vehicle: Vehicle, condition: Callable[[Status], bool], timeout_s: float, description: str) -> float:
    """`wait_for` with the newest status, which the error contains."""
    try:
        return wait_for(lambda: condition(vehicle.status()), timeout_s, description)
    except AssertionError as error:
        status = vehicle.status()
        raise AssertionError(f"{error}; {status.code} {status.name}: {status.text} {status.not_ready_reason}") from None


def in_the_air(vehicle: Vehicle, timeout_s: float = 60.0) -> None:
    """Bring the vehicle into a hover, from any state that the test before has left."""
    vehicle.wait_ready(timeout_s)
    wait_for_status(vehicle, lambda s: s.code in (StatusCode.IDLE, StatusCode.HOVER), timeout_s, "at rest")
    if vehicle.status().code == StatusCode.IDLE:
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=timeout_s)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.HOVER, timeout_s, "hovering")


@contextmanager
def new_stack(folder: Path, whole: bool = False) -> Iterator[Stack]:
    """A stack that `up` starts, with ports of its own; stopped at the end.

    Args:
        folder: for the run folder and the settings.
        whole: as users start it. Else nothing is recorded, and the camera finds the corners of tags by projection:
            without pictures and recorder the stack needs 0.4 instead of 0.7 of a processor.
    """
    with reserved_instance(vehicle=f"t{os.getpid()}") as instance:
        run_dir = folder / "run"
        environment = {
            **os.environ,
            **instance_environment(instance),
            "JEZERO_RUN_DIR": str(run_dir),
            "JEZERO_GROUND": "0",  # it takes seconds of a core to start; its own tests start it
        }
        if not whole:
            settings = settings_without_pictures(folder / "settings without pictures")
            environment |= {"JEZERO_CONFIG_DIR": str(settings), "JEZERO_RECORD": "0"}
        stack = Stack(instance, run_dir, environment)
        stack.choose_autopilot(os.environ.get("JEZERO_AUTOPILOT") or "embedded")
        try:
            yield stack
        finally:
            stack.jezero("down", check=False)


def settings_without_pictures(folder: Path) -> Path:
    """A copy of the settings, with a camera that renders nothing."""
    shutil.copytree(config_directory(), folder)
    camera = folder / "camera.toml"
    camera.write_text(f'mode = "projected"\n{camera.read_text()}')
    return folder


@contextmanager
def stack_with_keys(folder: Path, bundle: Path) -> Iterator[Stack]:
    """A stack that is up, and listens to other computers at `JEZERO_LISTEN`, an address on the loopback.

    Args:
        folder: for the run folder.
        bundle: folder of the vehicle's bundle.
    """
    with new_stack(folder) as stack:
        stack.environment |= {"JEZERO_LISTEN": f"tls/127.0.0.1:{free_port()}", "JEZERO_KEYS": str(bundle)}
        yield stack.up()


def _is_whole(request: pytest.FixtureRequest) -> bool:
    """Whether the test or file is marked `whole`."""
    return request.node.get_closest_marker("whole") is not None


@pytest.fixture
def unstarted(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Stack]:
    """A stack with ports and keys of its own, for `up` to start."""
    with new_stack(tmp_path, _is_whole(request)) as stack:
        yield stack


@pytest.fixture
def start_stack(unstarted: Stack) -> Callable[..., Stack]:
    """Start a stack with `jezero up -d --wait` and extra words."""
    return unstarted.up


@pytest.fixture
def tap(tmp_path: Path, unstarted: Stack) -> Iterator[Tap]:
    """A tap between autopilot and bridge; the stack must be started with the tap's words."""
    tap = Tap(unstarted.instance, tmp_path)
    yield tap
    tap.close()


@pytest.fixture
def stack(start_stack: Callable[..., Stack]) -> Stack:
    """A stack with the shipped compose file, ready to fly."""
    return start_stack()


@pytest.fixture(scope="module")
def shared_stack(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[Stack]:
    """One stack for all tests of a file, in the state in which the test before has left it."""
    with new_stack(tmp_path_factory.mktemp("shared"), _is_whole(request)) as stack:
        yield stack.up()
