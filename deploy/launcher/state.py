"""The run folder: the state of the launcher and its services, and their logs."""

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec

from jezero.runtime.instance import NAMES

LOCK = "lock"
"""File in a run folder that a launcher keeps open and locked."""
ServiceState = Literal["waiting", "running", "restarting", "stopping", "stopped", "exited", "failed", "external"]
"""waiting: waits for its dependencies. restarting: waits for its restart. stopped: stopped on request. exited: ended
without an error; failed: ended with an error or can't be started; neither is restarted. external: of another stack."""


class AlreadyUpError(RuntimeError):
    """Another launcher runs in the folder; the message names its process and the folder."""


class StartError(RuntimeError):
    """A stack can't start; the message gives the reason and the remedy."""


class LaunchedService(msgspec.Struct, frozen=True, kw_only=True):
    """One service as `jezero ps` shows it.

    Attributes:
        service: name of the service.
        state: its state.
        pid: process id; None without a process.
        health: its own health, starting, ok or degraded; "" until the service publishes it.
        healthy: whether it is alive on the bus and not starting.
        restarts: number of restarts so far.
        exit_code: exit code of its last process, negative for a signal.
        started_monotonic_s: start of its present process, on the monotonic clock of this machine.
        text: a sentence for people.
    """

    service: str
    state: ServiceState
    pid: int | None = None
    healthy: bool = False
    health: str = ""
    restarts: int = 0
    exit_code: int | None = None
    started_monotonic_s: float | None = None
    text: str = ""


class RunState(msgspec.Struct, frozen=True, kw_only=True):
    """State of a launcher and its services; the content of `<folder>/state.json`.

    Attributes:
        launcher_pid: process id of the launcher.
        launcher_start_ticks: start of the launcher, to distinguish it from a later process with the same id.
        compose_file: path of the compose file.
        vehicle: name of the vehicle.
        router: address of the router for people's programs.
        bus: address of the router for services.
        ready: whether the vehicle is ready.
        not_ready_reason: why it is not ready, or "".
        services: states of the services.
    """

    launcher_pid: int
    launcher_start_ticks: int
    compose_file: str
    vehicle: str
    router: str
    bus: str
    ready: bool
    not_ready_reason: str
    services: tuple[LaunchedService, ...]

    @property
    def failures(self) -> tuple[str, ...]:
        """A sentence for each reason for which services failed."""
        services: dict[str, list[str]] = {}
        for failed in (s for s in self.services if s.state == "failed"):
            services.setdefault(failed.text, []).append(failed.service)
        return tuple(f"{', '.join(names)}: {text}" for text, names in services.items())

    @property
    def page_address(self) -> str:
        """Address of the ground station's pages, which it publishes at the beginning of its health; "" without one."""
        texts = [s.text for s in self.services if s.service == "ground_station" and s.health == "ok"]
        return texts[0].partition(",")[0] if texts else ""

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where people and programs reach the stack, a line for each address."""
        page = self.page_address
        return (
            *((f"ground station: {page}",) if page else ()),
            f"programs: {self.router}, with the rights of a pilot",
            f"services of your own: JEZERO_ROUTER={self.bus}",
        )


def start_ticks(pid: int) -> int | None:
    """Clock ticks from the machine's start to that of a process; None without such a process. Source: proc(5)."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return None
    return None if fields[0] == "Z" else int(fields[19])


def _is_file(descriptor: int, path: Path) -> bool:
    """Whether an open file still has this name."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


class RunFolder:
    """Folder of a run, used by at most one launcher at a time."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self._lock: int | None = None

    @property
    def logs(self) -> Path:
        return self.path / "logs"

    def log_of(self, service: str) -> Path:
        """Log file of a service."""
        return self.logs / f"{service}.log"

    def logged(self) -> list[str]:
        """Services that have a log of the present or last run."""
        return sorted(path.stem for path in self.logs.glob("*.log") if path.stem != "launcher")

    @property
    def _state_path(self) -> Path:
        return self.path / "state.json"

    @property
    def _lock_path(self) -> Path:
        return self.path / LOCK

    def acquire(self) -> None:
        """Create the folder and lock it until this process ends.

        Raises:
            AlreadyUpError: another launcher has locked it.
            OSError: it can't be written.
        """
        self.logs.mkdir(parents=True, exist_ok=True)
        while self._lock is None:
            lock = os.open(self._lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                state = self.read()
                pid = state.launcher_pid if state else "unknown"
                raise AlreadyUpError(
                    f"already up: launcher process {pid} runs in {self.path}. Stop it with `jezero down`, or choose "
                    "another folder with --run-dir"
                ) from None
            if _is_file(lock, self._lock_path):
                self._lock = lock
            else:  # its owner removed the file between our two calls
                os.close(lock)

    def fileno(self) -> int:
        """File descriptor of the lock, which a process that takes the folder over must keep open.

        Raises:
            RuntimeError: the folder is not locked.
        """
        if self._lock is None:
            raise RuntimeError(f"{self.path} is not locked")
        return self._lock

    def write(self, state: RunState) -> None:
        """Replace the state atomically: a reader gets the old or the new one."""
        temporary = self.path / "state.json.new"
        temporary.write_bytes(msgspec.json.encode(state))
        temporary.replace(self._state_path)

    def release(self) -> None:
        """Remove the state and the names of services, and unlock the folder."""
        shutil.rmtree(self.path / NAMES, ignore_errors=True)
        with contextlib.suppress(FileNotFoundError):
            self._state_path.unlink()
        if self._lock is not None:
            with contextlib.suppress(FileNotFoundError):
                self._lock_path.unlink()
            os.close(self._lock)
            self._lock = None

    def read(self) -> RunState | None:
        """State of the running launcher; None if no launcher runs."""
        try:
            state = msgspec.json.decode(self._state_path.read_bytes(), type=RunState)
        except (FileNotFoundError, msgspec.DecodeError):
            return None
        alive = start_ticks(state.launcher_pid) == state.launcher_start_ticks
        return state if alive else None


def running_stacks() -> Iterator[tuple[Path, RunState]]:
    """Run folder and state of each stack of this user on this computer.

    A launcher keeps the lock of its folder open, so that its process leads to the folder.
    """
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # of another user, or ended
            for descriptor in (process / "fd").iterdir():
                opened = Path(os.readlink(descriptor))
                state = RunFolder(opened.parent).read() if opened.name == LOCK else None
                if state is not None and state.launcher_pid == int(process.name):
                    yield opened.parent, state
