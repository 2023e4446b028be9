"""The ports of a stack, and free ones, so that several stacks can run on one machine."""

import errno
import socket
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from jezero.runtime.instance import Instance, socket_of
from jezero.runtime.linux_processes import Protocol, listen_problem
from jezero.services.table import SERVICES

HOST = "127.0.0.1"


def ports_of(services: Collection[str], instance: Instance) -> list[tuple[Protocol, str, int]]:
    """Protocol, host and port of everything that these services listen on, but for the router's."""
    return [
        (protocol, HOST, getattr(instance, port))
        for row in SERVICES
        if row.name in services
        for protocol, port in row.ports
    ]


@contextmanager
def reserved_instance(vehicle: str = "uav1") -> Iterator[Instance]:
    """Reserve a free instance number and router port until the context ends.

    The reservation is a Unix socket with an abstract name. Like the ports it belongs to the machine's network, ends
    with its process, and is no file that another user could have put there.

    Raises:
        OSError: all 249 instances are in use.
    """
    for number in range(1, 250):
        with socket.socket(socket.AF_UNIX) as reservation:
            try:
                reservation.bind(f"\0jezero-instance-{number}")
            except OSError:
                continue
            instance = Instance(vehicle=vehicle, router=f"tcp/{HOST}:{_free_tcp_port()}", number=number)
            if _is_free(instance):
                yield instance
                return
    raise OSError(errno.EADDRINUSE, "no free instance: 249 stacks run on this machine already")


def instance_environment(instance: Instance) -> dict[str, str]:
    """Environment variables that make a process part of this stack."""
    return {
        "JEZERO_VEHICLE": instance.vehicle,
        "JEZERO_ROUTER": instance.router,
        "JEZERO_INSTANCE": str(instance.number),
    }


def service_environment(instance: Instance, run_folder: Path) -> dict[str, str]:
    """Environment variables that make a process a service of this stack, which no launcher starts.

    Args:
        run_folder: of the stack; the router needs it in `JEZERO_RUN_DIR` too.
    """
    own = {"JEZERO_ROUTER": socket_of(run_folder), "JEZERO_RUN_DIR": str(run_folder)}
    return {**instance_environment(instance), **own}


def _free_tcp_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _is_free(instance: Instance) -> bool:
    ports = ports_of([row.name for row in SERVICES], instance)
    return not any(listen_problem(protocol, host, port, "") for protocol, host, port in ports)
