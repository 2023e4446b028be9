"""What would end a stack within seconds of its start: checked first, and refused in one sentence."""

import os
import resource
import socket
import sys
import threading
import time
from collections.abc import Collection, Mapping
from pathlib import Path

from jezero.deploy.launcher.claims import Claims
from jezero.deploy.launcher.compose import Service
from jezero.deploy.launcher.health import HealthWatcher, router_is_up
from jezero.deploy.launcher.ports import ports_of
from jezero.deploy.launcher.state import AlreadyUpError, RunFolder, StartError
from jezero.replay import NAME as REPLAY
from jezero.router_address import shown_router
from jezero.runtime.config import HostLinks, Instance, config_directory, links_from_environment
from jezero.runtime.ports import listen_problem
from jezero.runtime.routing import ListenError, check_local, host_link_problem, router_problem

OPEN_FILES_MIN = 256
"""The launcher of the shipped stack has 63 files open, its router 49 and 3 more for each client."""
ROUTER = "router"
TOKENS_TIMEOUT_S = 0.5
"""Duration after which the tokens of all services that live have arrived."""
HEALTH_TIMEOUT_S = 1.2
"""Health is published once a second."""


def check_start(services: Mapping[str, Service], instance: Instance, claims: Claims) -> bool:
    """Check everything that the services need from this machine.

    The ports of a program that isn't jezero's own, which a compose file may name for a service, aren't known.

    Args:
        services: services to start, by name.
        claims: claims of this launcher, which get those to the services.

    Returns:
        Whether the router runs already, or another launcher starts it now, so that it must not be started.

    Raises:
        StartError: something is missing, or taken by another program.
        AlreadyUpError: one of the services runs already for this vehicle, or another launcher starts it now.
    """
    _check_interpreter()
    _raise_open_files_limit()
    if not config_directory().is_dir():
        raise StartError(f"{config_directory()} is no folder: JEZERO_CONFIG_DIR must name the folder of the settings")
    others = [name for name in services if name != ROUTER]
    router_runs = ROUTER in services and router_is_up(instance.router)
    if router_runs:
        _check_nobody_runs([*others, REPLAY], instance)
    claims.take_services(others, instance.vehicle, instance.router)
    if ROUTER in services and not router_runs:
        router_runs = not _claim_router(instance, links_from_environment(), claims)
    own = [name for name, service in services.items() if service.command[-1] == f"jezero.services.{name}"]
    for protocol, host, port in ports_of(own, instance):
        if problem := listen_problem(protocol, host, port, "JEZERO_INSTANCE"):
            raise StartError(problem)
    return router_runs


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


def _claim_router(instance: Instance, links: HostLinks, claims: Claims) -> bool:
    """Claim the router, which doesn't reply; False if another launcher starts it now.

    Raises:
        StartError: it can't be started.
    """
    if not claims.take(instance.router):
        return False
    try:
        check_local(instance.router)
    except ListenError as error:
        raise StartError(str(error)) from None
    # After the claim, as two launchers that try the port at the same time would find it taken by each other.
    if problem := router_problem(instance.router):
        raise StartError(f"{problem} (no Zenoh router replies at {shown_router(instance.router)})")
    if problem := next(filter(None, map(host_link_problem, links.listen)), ""):
        raise StartError(problem)
    return True


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
