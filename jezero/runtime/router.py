"""The Zenoh router of one computer's own programs: `python -m jezero.runtime.router` routes until SIGTERM.

Services are its clients by a Unix socket in the run folder, people's programs by TCP at `JEZERO_ROUTER`. Other
computers never reach it: they speak with the gate, a process of its own.
"""

import os
import select
import signal
import socket
import stat
import struct
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, suppress

import zenoh

from jezero.base.codec import encode
from jezero.base.config import ConfigError
from jezero.base.files import describe_os_error, keep_private
from jezero.base.router_address import shown_router
from jezero.runtime.instance import Instance, instance_from_environment, run_folder_of, socket_of
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
STUCK_MAX_MS = 1000
TCP_INFO_BYTES, UNSENT_OFFSET = 148, 144
"""Size of the kernel's `struct tcp_info`, and the offset of `tcpi_notsent_bytes` in it (linux/tcp.h)."""
CLOSE_IN_BACKGROUND = struct.pack("ii", 0, 0)
"""`struct linger`. Zenoh asks for 10 s of lingering: closing a connection with unsent bytes would stop a thread that
routes for so long, and a few such connections at once would stop the whole bus."""
CLOSE_WITH_RESET = struct.pack("ii", 1, 0)
"""`struct linger`: discards the unsent bytes at once."""
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
        peers = {_address_of_link(link): _peer(link) for link in links}
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
            self._guard.close({_address_of_link(link) for link in links if link.auth_identifier in members})

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


def _address_of_link(link: zenoh.Link) -> str:
    """Address of the other end of a link."""
    return link.dst.partition("/")[2].partition("?")[0]


def _peer(link: zenoh.Link) -> str:
    """Who is at the other end of a link."""
    member = f"{link.auth_identifier}, " if link.auth_identifier else ""
    return f"{member}session {link.zid}"


class LinkGuard:
    """Lets the kernel end the TCP connections of this process whose readers stopped reading.

    A program that subscribes and then stands still (a laptop asleep, a debugger, SIGSTOP) fills the buffers of its
    connection. Nobody waits for it: everything is published with Zenoh's congestion control DROP. But the router would
    keep its link for as long as the program's own lease says. So the kernel ends a connection that has bytes to send
    and gets none acknowledged for a second. A client of Zenoh connects again when it continues. Source: tcp(7).
    """

    def __init__(self) -> None:
        self._waiting: dict[str, int] = {}
        """For how many updates in a row bytes have waited for the other end, by its address."""

    def update(self) -> list[str]:
        """Set the options of all connections.

        Returns:
            Addresses, host:port, of the connections that ended since the last update while bytes waited.
        """
        with ExitStack() as ends:
            connections = {address: ends.enter_context(end) for address, end in _connections()}
            ended = [address for address, count in self._waiting.items() if count > 1 and address not in connections]
            for end in connections.values():
                with suppress(OSError):  # it has ended just now
                    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, CLOSE_IN_BACKGROUND)
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, STUCK_MAX_MS)
            waiting = [address for address, end in connections.items() if unsent_bytes(end)]
        self._waiting = {address: self._waiting.get(address, 0) + 1 for address in waiting}
        return ended

    def close(self, addresses: Collection[str]) -> None:
        """Close the connections with these addresses."""
        with ExitStack() as ends:
            connections = {address: ends.enter_context(end) for address, end in _connections()}
            for address in addresses:
                with suppress(KeyError, OSError):  # it has ended by itself
                    connections[address].setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, CLOSE_WITH_RESET)
                    connections[address].shutdown(socket.SHUT_RDWR)


def unsent_bytes(connection: socket.socket) -> int:
    """Number of bytes of a TCP connection that wait in this computer because the other end takes none."""
    info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)
    return int.from_bytes(info[UNSENT_OFFSET : UNSENT_OFFSET + 4], sys.byteorder)


def _connections() -> Iterator[tuple[str, socket.socket]]:
    """Address of the other end and a duplicate of each of this process' TCP connections; the caller closes them.

    Zenoh's own descriptors are out of reach, and it may close one and reuse its number at any time. A duplicate keeps
    its connection.
    """
    for entry in os.listdir("/proc/self/fd"):
        try:
            descriptor = os.dup(int(entry))
        except OSError:  # closed since it was listed
            continue
        if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            continue
        connection = socket.socket(fileno=descriptor)
        address = _address_of_connection(connection)
        if address is None:
            connection.close()
        else:
            yield address, connection


def _address_of_connection(connection: socket.socket) -> str | None:
    """The other end as Zenoh has it: host:port, an IPv6 host in brackets. None for anything but a TCP connection."""
    if connection.type != socket.SOCK_STREAM or connection.family not in (socket.AF_INET, socket.AF_INET6):
        return None
    try:
        host, port = connection.getpeername()[:2]
    except OSError:  # it listens, or the other end has gone
        return None
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


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
