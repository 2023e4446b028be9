"""What would end a stack within seconds of its start: checked first, and refused in one sentence.

Of two launchers that start at the same instant, only one starts each service: it claims them.
"""

import contextlib
import errno
import hashlib
import os
import resource
import socket
import struct
import sys
import threading
import time
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from msgspec.structs import replace

from jezero.base.config import config_directory
from jezero.base.router_address import shown_router
from jezero.deploy.launcher.compose import ComposeService
from jezero.deploy.launcher.health import HealthWatcher, router_is_up
from jezero.deploy.launcher.ports import ports_of
from jezero.deploy.launcher.state import AlreadyUpError, RunFolder, StartError
from jezero.replay import NAME as REPLAY
from jezero.runtime.instance import LISTEN_VARIABLE, PREFIX, Instance, links_from_environment, socket_of
from jezero.runtime.linux_processes import listen_problem
from jezero.runtime.routing import ListenError, bus_of_router, check_local, router_problem
from jezero.services.table import SERVICES

OPEN_FILES_MIN = 256
"""The launcher of the shipped stack has 63 files open, its router 49 and 3 more for each client."""
ROUTER, GATE = "router", "gate"
OF_COMPUTER = (ROUTER, GATE)
"""Services of a computer: each has its own."""
ROUTER_TIMEOUT_S = 10.0
"""Duration after which a router that another launcher starts has long replied."""
TOKENS_TIMEOUT_S = 0.5
"""Duration after which the tokens of all services that live have arrived."""
HEALTH_TIMEOUT_S = 1.2
"""Health is published once a second."""


# -- claims ----------------------------------------------------------------------------------------------


class Claims:
    """The services that no other launcher of this machine may start, until this process ends or `close` is called.

    A claim is a Unix socket with an abstract name. Like the ports it belongs to the machine's network, ends with its
    process, and is no file that another user could have put there.
    """

    def __init__(self) -> None:
        self._sockets: list[socket.socket] = []

    def take(self, *owner: str) -> bool:
        """Claim something; False if another launcher has claimed it.

        Args:
            owner: words that name it.
        """
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(_address(owner))
            claim.listen()
        except OSError as error:
            claim.close()
            if error.errno != errno.EADDRINUSE:
                raise
            return False
        self._sockets.append(claim)
        return True

    def take_services(self, services: Iterable[str], vehicle: str, router: str) -> None:
        """Claim services of a vehicle.

        Raises:
            AlreadyUpError: another launcher has claimed one of them.
        """
        for service in sorted(services):  # in one order, so that two launchers can't each get a part and both give up
            if not self.take(router, vehicle, service):
                pid = _holder((router, vehicle, service)) or "of an unknown id"
                raise AlreadyUpError(
                    f"{service} of vehicle {vehicle} belongs to launcher process {pid} already. Stop that with "
                    "`jezero down`, or choose another vehicle with JEZERO_VEHICLE"
                )

    def close(self) -> None:
        """Give all claims up."""
        for claim in self._sockets:
            claim.close()
        self._sockets.clear()


def _address(owner: Iterable[str]) -> str:
    """Abstract address, which has to be shorter than the names may be."""
    return f"\0jezero-{hashlib.sha256(' '.join(owner).encode()).hexdigest()}"


def _holder(owner: Iterable[str]) -> str:
    """Id of the process with a claim, "" if it has just ended. Source: unix(7), SO_PEERCRED."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as probe:
        probe.connect(_address(owner))
        pid, _, _ = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
        return str(pid)
    return ""


# -- the router ------------------------------------------------------------------------------------------


def find_bus(
    services: Mapping[str, ComposeService], instance: Instance, folder: RunFolder, claims: Claims
) -> tuple[str, bool]:
    """Find the router that the services join, or claim the right to start it.

    Args:
        services: services to start, by name; without a router among them, it is one that runs or comes later.
        instance: the stack; its `router` is the address for people's programs.
        folder: folder of this run.
        claims: claims of this launcher, which get that to the router.

    Returns:
        The address of the router for services; and whether it runs already.

    Raises:
        StartError: the router can't be started, or the services can't join the one that runs.
    """
    if ROUTER not in services and not router_is_up(instance.router):
        return socket_of(folder.path), False
    own = ROUTER not in services or claims.take(instance.router)
    if own and not router_is_up(instance.router):
        _check_router(instance)
        return socket_of(folder.path), False
    if not own and not _appears(instance.router):  # another launcher starts it now
        raise StartError(f"another launcher starts the router at {shown_router(instance.router)}, which doesn't reply")
    bus = bus_of_router(instance.router)
    if not bus or not router_is_up(bus):
        raise StartError(
            f"a router runs at {shown_router(instance.router)}, but it is none that `jezero up` of this user started, "
            "so that services can't join it: choose another address with JEZERO_ROUTER"
        )
    return bus, True


def _appears(router: str) -> bool:
    """Whether a router replies within `ROUTER_TIMEOUT_S`."""
    deadline_s = time.monotonic() + ROUTER_TIMEOUT_S
    while not router_is_up(router):
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.1)
    return True


def _check_router(instance: Instance) -> None:
    """Raise StartError if no router can listen at its address, which doesn't reply."""
    try:
        check_local(instance.router)
    except ListenError as error:
        raise StartError(str(error)) from None
    if instance.router.startswith(PREFIX):
        raise StartError(f"no router replies at {instance.router}, the socket for services of another stack")
    # After the claim, as two launchers that try the port at the same time would find it taken by each other.
    if problem := router_problem(instance.router):
        raise StartError(f"{problem} (no Zenoh router replies at {shown_router(instance.router)})")


# -- the services ----------------------------------------------------------------------------------------


def check_start(
    services: Mapping[str, ComposeService], instance: Instance, bus: str, claims: Claims, *, router_runs: bool
) -> None:
    """Check everything that the services need from this machine.

    The ports of a program that isn't jezero's own, which a compose file may name for a service, aren't known.

    Args:
        services: services to start, by name.
        instance: the stack.
        bus: address of the router for services.
        claims: claims of this launcher, which get those to the services.
        router_runs: whether other services may be there.

    Raises:
        StartError: something is missing, or taken by another program.
        AlreadyUpError: one of the services runs already for this vehicle, or another launcher starts it now.
    """
    _check_interpreter()
    _raise_open_files_limit()
    if not config_directory().is_dir():
        raise StartError(f"{config_directory()} is no folder: JEZERO_CONFIG_DIR must name the folder of the settings")
    others = [name for name in services if name not in OF_COMPUTER]
    if router_runs:
        _check_nobody_runs([*others, REPLAY], replace(instance, router=bus))
    claims.take_services(others, instance.vehicle, instance.router)
    listening = links_from_environment().listen if GATE in services else ()
    if problem := next(filter(None, (router_problem(each, LISTEN_VARIABLE) for each in listening)), ""):
        raise StartError(problem)
    own = [row.name for row in SERVICES if row.name in services and services[row.name].command[-1] == row.module]
    for protocol, host, port in ports_of(own, instance):
        if problem := listen_problem(protocol, host, port, "JEZERO_INSTANCE"):
            raise StartError(problem)


def _check_interpreter() -> None:
    if not os.access(sys.executable, os.X_OK):
        raise StartError(
            f"the Python interpreter {sys.executable or '(unknown)'} can't be executed, so no service can start: "
            "install jezero again, or check the permissions"
        )


def _raise_open_files_limit() -> None:
    """Raise this process' limit of open files, which its services inherit, as far as it may.

    Raises:
        StartError: that is not enough.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if resource.RLIM_INFINITY in (soft, hard) or soft >= OPEN_FILES_MIN:
        return
    if hard < OPEN_FILES_MIN:
        raise StartError(
            f"a process may open {hard} files only, a stack needs {OPEN_FILES_MIN}: raise the limit with `ulimit -n`"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES_MIN, hard))


def _check_nobody_runs(services: Collection[str], instance: Instance) -> None:
    """Raise AlreadyUpError if one of the services is alive on the bus: two with one name never run."""
    changed = threading.Event()
    start_s = time.monotonic()
    with HealthWatcher(instance, changed.set) as watcher:
        while True:
            alive = [name for name in services if watcher.report(name).alive]
            known = next((name for name in alive if watcher.report(name).process), None)
            waited_s = time.monotonic() - start_s
            if known or waited_s > (HEALTH_TIMEOUT_S if alive else TOKENS_TIMEOUT_S):
                break
            changed.wait(0.05)
            changed.clear()
        if alive:
            name = known or alive[0]
            raise AlreadyUpError(_already_runs(name, instance, watcher.report(name).process))


def _already_runs(service: str, instance: Instance, process: str) -> str:
    """A sentence about a service that runs: its process, and the folder of its launcher."""
    what = f"{service} of vehicle {instance.vehicle} runs already as {process or 'an unknown process'}"
    folder = _run_folder_of(process)
    state = folder and folder.read()
    if not folder or not state:
        return f"{what}. Stop it, or choose another vehicle with JEZERO_VEHICLE"
    return (
        f"{what}, of launcher process {state.launcher_pid} in {folder.path}. Stop it with "
        f"`jezero down --run-dir {folder.path}`, or choose another vehicle with JEZERO_VEHICLE"
    )


def _run_folder_of(process: str) -> RunFolder | None:
    """The run folder of a process of this machine, as `<host> pid <id>`; None if it can't be known."""
    host, _, pid = process.rpartition(" pid ")
    if host != socket.gethostname():
        return None
    try:
        variables = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:  # it has ended, or belongs to another user
        return None
    found = [value for name, _, value in (entry.partition(b"=") for entry in variables) if name == b"JEZERO_RUN_DIR"]
    return RunFolder(Path(os.fsdecode(found[0]))) if found else None
