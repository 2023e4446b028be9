"""The Zenoh router of one computer's own programs: `python -m jezero.runtime.router` routes until SIGTERM.

Services are its clients by a Unix socket in the run folder, people's programs by TCP at `JEZERO_ROUTER`. Other
computers never reach it: they speak with the gate, a process of its own.
"""

import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress

import zenoh

from jezero.codec import encode
from jezero.os_errors import describe_os_error
from jezero.private_files import keep_private
from jezero.router_address import shown_router
from jezero.runtime.bus_address import run_folder_of, socket_of
from jezero.runtime.config import ConfigError, Instance, instance_from_environment
from jezero.runtime.link_guard import LinkGuard
from jezero.runtime.linux_processes import process_in_words
from jezero.runtime.process import new_boot_id
from jezero.runtime.routing import ListenError, open_router
from jezero.runtime.zenoh_bus import close_or_exit
from jezero.schemas.health import ServiceHealth, ServiceState
from jezero.schemas.topics import health_of, key, liveliness_key

NAME = "router"
HEALTH_PERIOD_S = 1.0
SAMPLE_PERIOD_S = 0.25
NAMED_FOR_S = 60.0
"""Time for which health names a reader whose link was closed."""
TEXT_MAX = 1000
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)
Health = tuple[ServiceState, str]
"""State of a router, and its sentence for people."""


class Readers:
    """Who is connected to a router of this process; ends the links of readers that stopped reading, and names them.

    Args:
        name: of the router, for the log.
        session: session of the router.

    Attributes:
        sessions: number of sessions with others.
    """

    def __init__(self, name: str, session: zenoh.Session) -> None:
        self.sessions = 0
        self._due_s = 0.0
        self._name = name
        self._session = session
        self._guard = LinkGuard()
        self._peers: dict[str, str] = {}
        """Who is at each address: name of the member with keys, and Zenoh's id of the session."""
        self._members: dict[str, str] = {}
        """Name of the member by Zenoh's id of its session, of those that are connected with keys."""
        self._named: dict[str, tuple[str, float]] = {}
        """Closed links by member and session: a sentence about each, and the time until which health has it."""

    def update(self) -> None:
        """Check all links when that is due."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        self._due_s = now_s + SAMPLE_PERIOD_S
        links = list(self._session.info.links())
        self._members = _members_of(links)
        self.sessions = len({str(link.zid) for link in links})
        peers = {_address(link): _peer(link) for link in links}
        known = self._peers | peers  # a link may have ended since the last update
        self._peers = peers
        self._named = {session: named for session, named in self._named.items() if named[1] > now_s}
        for address in self._guard.update():
            peer = known.get(address, "unknown")
            self._named[peer] = (f"{address} ({peer})", now_s + NAMED_FOR_S)
            text = f"{address} ({peer}) stopped reading: its link is closed"
            print(f"{self._name}: {text}", file=sys.stderr, flush=True)

    def close(self, members: Collection[str]) -> None:
        """Close the links of some members."""
        if members:
            links = self._session.info.links()
            self._guard.close({_address(link) for link in links if link.auth_identifier in members})

    def member_of(self, session: str) -> str:
        """Name of the member that has a session, by Zenoh's id of it, or "" for one that isn't known."""
        if session not in self._members:  # it has begun since the last update
            with suppress(zenoh.ZError):  # the router was closed just now
                self._members |= _members_of(self._session.info.links())
        return self._members.get(session, "")

    @property
    def members(self) -> str:
        """For health: the members of the team on other computers that are connected, or ""."""
        return f", with {', '.join(sorted(set(self._members.values())))}" if self._members else ""

    @property
    def text(self) -> str:
        """For health: the readers of the last minute that stopped reading, or ""."""
        names = ", ".join(name for name, _ in self._named.values())
        return f"; stopped reading, link closed: {names}" if names else ""


def _members_of(links: Iterable[zenoh.Link]) -> dict[str, str]:
    """Name of the member by Zenoh's id of its session, of the links with keys."""
    return {str(link.zid): link.auth_identifier for link in links if link.auth_identifier}


def _address(link: zenoh.Link) -> str:
    """Address of the other end of a link."""
    return link.dst.partition("/")[2].partition("?")[0]


def _peer(link: zenoh.Link) -> str:
    """Who is at the other end of a link."""
    member = f"{link.auth_identifier}, " if link.auth_identifier else ""
    return f"{member}session {link.zid}"


def serve(
    name: str,
    session: zenoh.Session,
    vehicle: str,
    update: Callable[[], None],
    health: Callable[[], Health],
    period_s: float = SAMPLE_PERIOD_S,
) -> None:
    """Route until SIGTERM or SIGINT, and publish health once a second.

    Args:
        name: of the router, for its health.
        session: session of the router; closed at the end.
        vehicle: name of the vehicle within the keys.
        update: called every `period_s`.
        health: returns the health of the router.
        period_s: period of `update`.
    """
    stop_read, stop_write = socket.socketpair()
    stop_write.setblocking(False)
    signal.set_wakeup_fd(stop_write.detach())
    for number in STOP_SIGNALS:
        signal.signal(number, lambda _number, _frame: None)
    alive = session.liveliness().declare_token(liveliness_key(vehicle, "service", name))
    publisher = session.declare_publisher(key(vehicle, health_of(name).name), encoding=zenoh.Encoding.APPLICATION_JSON)
    boot_id, process = new_boot_id(), process_in_words()
    health_due_s = time.monotonic()
    while not select.select([stop_read], [], [], period_s)[0]:
        update()
        if time.monotonic() >= health_due_s:
            health_due_s = time.monotonic() + HEALTH_PERIOD_S
            state, text = health()
            report = ServiceHealth(
                t_ns=0, service=name, boot_id=boot_id, process=process, state=state, text=text[:TEXT_MAX]
            )
            publisher.put(encode(report))
    alive.undeclare()  # type: ignore[no-untyped-call]
    close_or_exit(session)


def run(instance: Instance, bus: str) -> None:
    """Route between the programs of this computer until SIGTERM or SIGINT.

    Args:
        instance: its `router` is the address for people's programs.
        bus: Zenoh's endpoint of the socket for the services.

    Raises:
        ListenError: see `open_router`.
    """
    session = open_router(instance.router, bus)
    readers = Readers(NAME, session)
    where = f"listening on {shown_router(instance.router)}, and on {bus} for services"

    def health() -> Health:
        return "ok", f"{where}, {readers.sessions} sessions{readers.text}"

    serve(NAME, session, instance.vehicle, readers.update, health)


def main() -> int:
    """Run the router of the instance in the environment."""
    keep_private()
    try:
        instance = instance_from_environment()
        run(instance, socket_of(run_folder_of(instance.vehicle)))
    except (ConfigError, ListenError, OSError) as error:
        text = describe_os_error(error) if isinstance(error, OSError) else str(error)
        print(f"{NAME}: {text}", file=sys.stderr)
        return os.EX_CONFIG if isinstance(error, ConfigError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
