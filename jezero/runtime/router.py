"""The Zenoh router of one stack: `python -m jezero.runtime.router` listens on `JEZERO_ROUTER` until SIGTERM."""

import os
import re
import select
import signal
import socket
import sys
import threading
from collections.abc import Mapping
from typing import Any

import zenoh

from jezero.codec import encode
from jezero.router_address import parse_router
from jezero.runtime.config import ConfigError, Instance, instance_from_environment
from jezero.runtime.ports import listen_problem
from jezero.runtime.zenoh_bus import new_boot_id
from jezero.schemas.health import ServiceHealth
from jezero.schemas.topics import health_of, key, liveliness_key
from jezero.zenoh_client import LINK_SETTINGS, config_of

NAME = "router"
CLOSE_TIMEOUT_S = 0.7
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)
ROUTER_SETTINGS: Mapping[str, Any] = {
    **LINK_SETTINGS,
    "mode": "router",
    "listen/timeout_ms": 0,  # a port that is taken is an error at once
    "listen/exit_on_failure": True,
    "scouting/delay": 0,  # nothing is scouted; the default waits 0.5 s for it
}
"""Zenoh's settings of the router, but for its endpoint."""


class ListenError(RuntimeError):
    """The router can't listen on its endpoint; the message names it and the reason."""


def open_router(endpoint: str) -> zenoh.Session:
    """Start listening.

    Raises:
        ListenError: the port is taken or forbidden for this user, or this machine doesn't have the address.
    """
    try:
        return zenoh.open(config_of({**ROUTER_SETTINGS, "listen/endpoints": [endpoint]}))
    except zenoh.ZError as error:
        raise ListenError(router_problem(endpoint) or f"cannot listen on {endpoint}: {_reason(error)}") from error


def router_problem(endpoint: str) -> str:
    """Why no router can listen on an endpoint now, in one sentence, or "".

    Raises:
        ValueError: the endpoint's syntax is wrong.
    """
    protocol, host, port = parse_router(endpoint)
    if not host:
        return ""
    return listen_problem("udp" if protocol == "udp" else "tcp", host, port, "JEZERO_ROUTER")


def _reason(error: zenoh.ZError) -> str:
    """Zenoh's reason without the places in its source."""
    known = re.search(r"([A-Z][\w ]+) \(os error \d+\)", str(error))
    return known[1] if known else str(error).split(" at /", maxsplit=1)[0]


def run(instance: Instance) -> None:
    """Route until SIGTERM or SIGINT, and publish health once a second.

    Raises:
        ListenError: see `open_router`.
    """
    stop_read, stop_write = socket.socketpair()
    stop_write.setblocking(False)
    signal.set_wakeup_fd(stop_write.fileno())  # works in whichever thread the signal arrives
    for number in STOP_SIGNALS:
        signal.signal(number, lambda _number, _frame: None)
    session = open_router(instance.router)
    alive = session.liveliness().declare_token(liveliness_key(instance.vehicle, "service", NAME))
    publisher = session.declare_publisher(
        key(instance.vehicle, health_of(NAME).name), encoding=zenoh.Encoding.APPLICATION_JSON
    )
    boot_id, process = new_boot_id(), f"{socket.gethostname()} pid {os.getpid()}"
    stopping = False
    while not stopping:
        sessions = len(list(session.info.transports()))
        report = ServiceHealth(
            t_ns=0,
            service=NAME,
            boot_id=boot_id,
            process=process,
            state="ok",
            text=f"listening on {instance.router}, {sessions} sessions",
        )
        publisher.put(encode(report))
        stopping = bool(select.select([stop_read], [], [], 1.0)[0])
    alive.undeclare()  # type: ignore[no-untyped-call]
    _close(session)


def _close(session: zenoh.Session) -> None:
    """Close the session; end the process if a client delays that."""
    closer = threading.Thread(target=session.close, daemon=True)
    closer.start()
    closer.join(CLOSE_TIMEOUT_S)
    if closer.is_alive():
        sys.stderr.flush()
        os._exit(0)


def main() -> int:
    """Run the router of the instance in the environment."""
    try:
        run(instance_from_environment())
    except (ConfigError, ListenError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return os.EX_CONFIG if isinstance(error, ConfigError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
