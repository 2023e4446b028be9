"""The Zenoh router of one stack: `python -m jezero.runtime.router` routes until SIGTERM.

It listens to the programs of its own computer at `JEZERO_ROUTER` and to other computers at `JEZERO_LISTEN`. It connects
to the routers of others at `JEZERO_CONNECT`. So no radio delays messages between programs of one computer.
"""

import os
import re
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from typing import Any

import zenoh

from jezero.codec import encode
from jezero.keys.bundle import members_of
from jezero.keys.diagnosis import listening_problem
from jezero.keys.members import KeysError
from jezero.keys.rights import access_control
from jezero.router_address import insecurity, is_loopback, parse_router, shown_router
from jezero.runtime.config import (
    LISTEN_VARIABLE,
    NO_LINKS,
    ConfigError,
    HostLinks,
    Instance,
    instance_from_environment,
    links_from_environment,
)
from jezero.runtime.link_guard import LinkGuard
from jezero.runtime.link_rules import link_rules
from jezero.runtime.ports import listen_problem
from jezero.runtime.process import new_boot_id
from jezero.runtime.uplinks import Uplinks
from jezero.schemas.health import ServiceHealth
from jezero.schemas.topics import CAMERA, KEYS, TOPICS, health_of, key, liveliness_key
from jezero.zenoh_client import LINK_SETTINGS, RETRY, config_of

NAME = "router"
CLOSE_TIMEOUT_S = 0.7
HEALTH_PERIOD_S = 1.0
SAMPLE_PERIOD_S = 0.25
NAMED_FOR_S = 60.0
"""Time for which health names a reader whose link was closed."""
TEXT_MAX = 1000
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)
ROUTER_SETTINGS: Mapping[str, Any] = {
    **LINK_SETTINGS,
    "mode": "router",
    "listen/timeout_ms": 0,  # a port that is taken is an error at once
    "listen/exit_on_failure": True,
    "connect/timeout_ms": -1,  # a router works without the others, and goes on trying to connect to them
    "connect/exit_on_failure": False,
    "connect/retry": RETRY,
    # A reply waits this long in us for a reader that doesn't take it, then the reader's link is closed. The action
    # server that replies can't send setpoints meanwhile, and a setpoint counts for 0.3 s. The default is 5 s.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 200_000,
    # Room for a picture of 0.9 MB that waits for a slow radio, in batches of 64 kB. With the default of 2 the action
    # server that sends it would wait.
    "transport/link/tx/queue/size/data_low": 16,
    "scouting/delay": 0,  # nothing is scouted; the default waits 0.5 s for it
}
"""Zenoh's settings of every router."""
SIZE_MAX_BYTES = 8_000_000
"""A larger message is dropped. The largest of the contract is a result of 4 MB, besides frames of a large camera."""
SIZED = (
    *(topic.name for topic in TOPICS if topic is not CAMERA),
    *("action/**", "health/**", "journal/**", "viewer/**"),
    *(name for name in KEYS if name.startswith("@")),
)
"""Names of the keys on which the size of messages is limited."""


class ListenError(RuntimeError):
    """The router can't listen on its endpoint; the message names it and the reason."""


def open_router(endpoint: str, vehicle: str, links: HostLinks = NO_LINKS) -> zenoh.Session:
    """Start listening, with the rights of the team's members where an endpoint has a bundle.

    Args:
        endpoint: Zenoh's endpoint, with the files of the bundle for TLS.
        vehicle: name of the vehicle within the keys.
        links: links with other computers.

    Raises:
        ListenError: a port is taken or forbidden for this user, this machine doesn't have the address, nobody would
            take the certificate of the bundle, or the list of the team's members is missing.
    """
    listening, others = (endpoint, *links.listen), (*links.listen, *links.connect)
    if problem := next(filter(None, map(listening_problem, listening)), ""):
        raise ListenError(problem)
    size = {
        "id": "size",
        "messages": ["put", "query", "reply"],
        "flows": ["ingress"],
        "key_exprs": [key("*", name) for name in SIZED],
        "size_limit": SIZE_MAX_BYTES,
    }
    settings = {
        **ROUTER_SETTINGS,
        "listen/endpoints": list(listening),
        "connect/endpoints": list(links.connect),
        "low_pass_filter": [size],
    }
    if others:
        settings["downsampling"] = link_rules(vehicle, others)
    with_keys = [each for each in (endpoint, *others) if parse_router(each).protocol == "tls"]
    if with_keys:
        try:
            settings["access_control"] = access_control(vehicle, members_of(with_keys[0]))
        except KeysError as error:
            raise ListenError(str(error)) from None
    try:
        return zenoh.open(config_of(settings))
    except zenoh.ZError as error:
        problem = router_problem(endpoint) or next(filter(None, map(host_link_problem, links.listen)), "")
        raise ListenError(problem or f"cannot listen on {_shown(listening)}: {_reason(error)}") from error


def host_link_problem(endpoint: str) -> str:
    """Why no router can listen to other computers on an endpoint now, in one sentence, or ""; see `router_problem`."""
    return router_problem(endpoint, LISTEN_VARIABLE)


def router_problem(endpoint: str, variable: str = "JEZERO_ROUTER") -> str:
    """Why no router can listen on an endpoint now, in one sentence, or "".

    Args:
        endpoint: Zenoh's endpoint.
        variable: environment variable that has the address.

    Raises:
        ValueError: the endpoint's syntax is wrong.
    """
    protocol, host, port = parse_router(endpoint)
    if not host:
        return ""
    return listening_problem(endpoint) or listen_problem("udp" if protocol == "udp" else "tcp", host, port, variable)


def check_local(endpoint: str) -> None:
    """Check the address for the programs of the router's own computer, on which nothing is left out.

    Raises:
        ListenError: other computers reach it, or it has TLS.
    """
    protocol, host, _ = parse_router(endpoint)
    if host and (protocol == "tls" or not is_loopback(host)):
        raise ListenError(
            f"JEZERO_ROUTER is {shown_router(endpoint)}, but the programs of this computer need an address on its "
            "loopback, such as tcp/127.0.0.1:7447. Give the address for other computers with --listen or JEZERO_LISTEN"
        )


def _shown(endpoints: Iterable[str]) -> str:
    return " and ".join(map(shown_router, endpoints))


def _reason(error: zenoh.ZError) -> str:
    """Zenoh's reason without the places in its source."""
    known = re.search(r"([A-Z][\w ]+) \(os error \d+\)", str(error))
    return known[1] if known else str(error).split(" at /", maxsplit=1)[0]


def run(instance: Instance, links: HostLinks) -> None:
    """Route until SIGTERM or SIGINT, and publish health once a second.

    Raises:
        ListenError: see `open_router` and `check_local`.
    """
    check_local(instance.router)
    stop_read, stop_write = socket.socketpair()
    stop_write.setblocking(False)
    signal.set_wakeup_fd(stop_write.fileno())  # works in whichever thread the signal arrives
    for number in STOP_SIGNALS:
        signal.signal(number, lambda _number, _frame: None)
    session = open_router(instance.router, instance.vehicle, links)
    alive = session.liveliness().declare_token(liveliness_key(instance.vehicle, "service", NAME))
    publisher = session.declare_publisher(
        key(instance.vehicle, health_of(NAME).name), encoding=zenoh.Encoding.APPLICATION_JSON
    )
    boot_id, process = new_boot_id(), f"{socket.gethostname()} pid {os.getpid()}"
    readers = _Readers(session)
    uplinks = Uplinks(session, links.connect)
    warnings = "".join(f"; {warning}" for each in (*links.listen, *links.connect) if (warning := insecurity(each)))
    where = f"listening on {_shown((instance.router, *links.listen))}{warnings}"
    stopping, health_due_s = False, time.monotonic()
    while not stopping:
        readers.update()
        if time.monotonic() >= health_due_s:
            health_due_s = time.monotonic() + HEALTH_PERIOD_S
            sessions = len(list(session.info.transports()))
            report = ServiceHealth(
                t_ns=0,
                service=NAME,
                boot_id=boot_id,
                process=process,
                state="degraded" if uplinks.problem else "ok",
                text=(uplinks.problem or f"{where}, {sessions} sessions{readers.members}{readers.text}")[:TEXT_MAX],
            )
            publisher.put(encode(report))
        stopping = bool(select.select([stop_read], [], [], SAMPLE_PERIOD_S)[0])
    alive.undeclare()  # type: ignore[no-untyped-call]
    _close(session)


class _Readers:
    """Who is connected; ends the links of readers that stopped reading, and names them."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._guard = LinkGuard()
        self._peers: dict[str, str] = {}
        """Who is at each address: name of the member with keys, and Zenoh's id of the session."""
        self._members: set[str] = set()
        self._named: dict[str, tuple[str, float]] = {}
        """Stopped readers by member and session: the name of each, and the time until which health names it."""

    def update(self) -> None:
        """Check all links; to be called every `SAMPLE_PERIOD_S`."""
        now_s = time.monotonic()
        links = list(self._session.info.links())
        self._members = {link.auth_identifier for link in links if link.auth_identifier}
        peers = {link.dst.partition("/")[2].partition("?")[0]: _peer(link) for link in links}
        known = self._peers | peers  # a link may have ended since the last update
        self._peers = peers
        self._named = {session: named for session, named in self._named.items() if named[1] > now_s}
        for address in self._guard.update(now_s):
            peer = known.get(address, "unknown")
            name = f"{address} ({peer})"
            self._named[peer] = (name, now_s + NAMED_FOR_S)
            print(f"{NAME}: {name} stopped reading: its link is closed", file=sys.stderr, flush=True)

    @property
    def members(self) -> str:
        """For health: the members of the team on other computers that are connected, or ""."""
        return f", with {', '.join(sorted(self._members))}" if self._members else ""

    @property
    def text(self) -> str:
        """For health: the readers of the last minute, or ""."""
        names = ", ".join(name for name, _ in self._named.values())
        return f"; stopped reading, link closed: {names}" if names else ""


def _peer(link: zenoh.Link) -> str:
    """Who is at the other end of a link."""
    member = f"{link.auth_identifier}, " if link.auth_identifier else ""
    return f"{member}session {link.zid}"


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
        run(instance_from_environment(), links_from_environment())
    except (ConfigError, ListenError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return os.EX_CONFIG if isinstance(error, ConfigError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
