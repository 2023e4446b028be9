"""The process of one service: it is built, runs over Zenoh until a signal, and says what is wrong."""

import fcntl
import os
import queue
import secrets
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from jezero.base.config import ConfigError
from jezero.base.files import describe_os_error, keep_private
from jezero.runtime.instance import NAMES, PREFIX, Instance, make_socket_folder, service_instance
from jezero.runtime.links import SocketLink
from jezero.runtime.linux_processes import process_in_words
from jezero.runtime.service import Service
from jezero.runtime.zenoh_bus import ServiceLoop

NAME_TIMEOUT_S = 2.5
"""Time for which a service waits for its name: the process before may still be closing."""


def new_boot_id() -> int:
    """An id that differs between two runs of a service, on any host."""
    return secrets.randbits(48)


Build = Callable[[Instance, int], tuple[Service, Mapping[str, SocketLink]]]
"""Makes a service and its links from the instance and a fresh boot id."""


def run_process(name: str, build: Build) -> int:
    """Build a service and run its process until SIGTERM or SIGINT.

    Args:
        name: the service's, for error messages.
        build: makes the service and its links.

    Returns:
        Exit code of the process; EX_CONFIG when the settings are wrong, so that a restart would not help.
    """
    boot_id = new_boot_id()
    keep_private()
    try:
        instance = service_instance()
        service, links = build(instance, boot_id)
    except (ConfigError, OSError) as error:
        return _refuse(name, error)
    return run_service(service, instance, boot_id, links)


def run_service(
    service: Service, instance: Instance, boot_id: int, links: Mapping[str, SocketLink] | None = None
) -> int:
    """Run a service until SIGTERM or SIGINT.

    Args:
        links: one for each name in the service's `Spec.links`.

    Returns:
        Exit code of the process.
    """
    name = service.spec.name
    try:
        if holder := take_name(name, instance):
            print(f"{name} of vehicle {instance.vehicle} already runs as {holder}; stop that first", file=sys.stderr)
            return 1
        loop = ServiceLoop(service, instance, boot_id, dict(links or {}))
        signal.signal(signal.SIGTERM, loop.stop)
        signal.signal(signal.SIGINT, loop.stop)
        try:
            loop.run()
        finally:
            loop.close()
    except (ConfigError, OSError) as error:
        return _refuse(name, error)
    return 0


def _refuse(name: str, error: ConfigError | OSError) -> int:
    """Print why a service can't run; returns the exit code of its process."""
    print(f"{name}: {describe_os_error(error) if isinstance(error, OSError) else error}", file=sys.stderr)
    return os.EX_CONFIG if isinstance(error, ConfigError) else 1


def take_name(name: str, instance: Instance) -> str:
    """Take the name of a service at a router's socket, until this process ends.

    A lock beside the socket makes sure that no two processes serve one name; the kernel ends it with its process.

    Returns:
        "", or the host and process id of the process that has the name.

    Raises:
        ConfigError, OSError: the lock can't be made.
    """
    make_socket_folder(instance.router)
    socket_path = Path(instance.router.removeprefix(PREFIX))
    names = socket_path.parent / NAMES
    names.mkdir(mode=0o700, exist_ok=True)
    path = names / f"{socket_path.name}.{instance.vehicle}.{name}"
    lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    deadline_s = time.monotonic() + NAME_TIMEOUT_S
    while True:
        with suppress(BlockingIOError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        if time.monotonic() > deadline_s:
            return os.pread(lock, 200, 0).decode(errors="replace") or "an unknown process"
        time.sleep(0.05)
    os.ftruncate(lock, 0)
    os.pwrite(lock, process_in_words().encode(), 0)
    return ""


class Worker:
    """A thread beside a service's loop that executes functions, one after the other: for writing files, not to compute.

    It starts with the first task, and ends with the process. An exception that a task raises goes to standard error;
    the next task is executed all the same.
    """

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._started = False

    def add(self, task: Callable[[], object]) -> None:
        """Queue a task; returns at once."""
        self._tasks.put(task)
        if not self._started:
            self._started = True
            threading.Thread(target=self._run, name="worker", daemon=True).start()

    def wait(self) -> None:
        """Wait until all tasks so far have been executed."""
        done = threading.Event()
        self.add(done.set)
        done.wait()

    def _run(self) -> None:
        while True:
            task = self._tasks.get()
            try:
                task()
            except Exception as error:  # noqa: BLE001 - a thread that ends would execute nothing any more
                traceback.print_exception(error)
