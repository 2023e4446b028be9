"""Free ports, so that several stacks can run on one machine."""

import fcntl
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jezero.runtime.config import Instance

HOST = "127.0.0.1"


@contextmanager
def reserved_instance(vehicle: str = "uav1") -> Iterator[Instance]:
    """Reserve a free instance number and router port until the context ends.

    Raises:
        RuntimeError: all 249 instances are in use.
    """
    for number in range(1, 250):
        lock = Path(tempfile.gettempdir()) / f"jezero-{os.getuid()}-instance-{number}.lock"
        with lock.open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            instance = Instance(vehicle=vehicle, router=f"tcp/{HOST}:{_free_tcp_port()}", number=number)
            if _is_free(instance):
                yield instance
                return
    raise RuntimeError("no free instance: 249 stacks run on this machine already")


def instance_environment(instance: Instance) -> dict[str, str]:
    """Environment variables that make a process part of this stack."""
    return {
        "JEZERO_VEHICLE": instance.vehicle,
        "JEZERO_ROUTER": instance.router,
        "JEZERO_INSTANCE": str(instance.number),
    }


def _free_tcp_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _is_free(instance: Instance) -> bool:
    udp = (instance.bridge_port, instance.autopilot_offboard_port, instance.autopilot_gcs_port)
    try:
        socket.create_server((HOST, instance.hil_port)).close()
        for port in udp:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind((HOST, port))
    except OSError:
        return False
    return True
