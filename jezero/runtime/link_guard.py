"""Ends the links of readers that stopped reading, in the process of the router.

A program that subscribes and then stands still (a laptop asleep, a debugger, SIGSTOP) fills the buffers of its
connection. Nobody waits for it: everything is published with Zenoh's congestion control DROP. But the router would
keep its link for as long as the program's own lease says. So the kernel ends a connection that has bytes to send and
gets none acknowledged for a second. A client of Zenoh connects again when it continues.
"""

import contextlib
import os
import socket
import stat
import struct
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping

STUCK_MAX_MS = 1000
TCP_INFO_BYTES, UNSENT_OFFSET = 148, 144
"""Size of the kernel's `struct tcp_info`, and the offset of `tcpi_notsent_bytes` in it (linux/tcp.h)."""

CLOSE_IN_BACKGROUND = struct.pack("ii", 0, 0)
"""`struct linger`. Zenoh asks for 10 s of lingering: closing a connection with unsent bytes would stop a thread that
routes for so long, and a few such connections at once would stop the whole bus."""
CLOSE_WITH_RESET = struct.pack("ii", 1, 0)
"""`struct linger`: discards the unsent bytes at once."""


class LinkGuard:
    """Lets the kernel end the TCP connections of this process whose readers stopped reading. Source: tcp(7)."""

    def __init__(self) -> None:
        self._waiting: dict[str, int] = {}
        """For how many updates in a row bytes have waited for the other end, by its address."""

    def update(self) -> list[str]:
        """Set the options of all connections.

        Returns:
            Addresses, host:port, of the connections that ended since the last update while bytes waited.
        """
        with contextlib.ExitStack() as ends:
            connections = {address: ends.enter_context(end) for address, end in _connections()}
            ended = [address for address, count in self._waiting.items() if count > 1 and address not in connections]
            for end in connections.values():
                with contextlib.suppress(OSError):  # it has ended just now
                    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, CLOSE_IN_BACKGROUND)
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, STUCK_MAX_MS)
            waiting = [address for address, end in connections.items() if unsent_bytes(end)]
        self._waiting = {address: self._waiting.get(address, 0) + 1 for address in waiting}
        return ended

    def close(self, addresses: Collection[str]) -> None:
        """Close the connections with these addresses."""
        with contextlib.ExitStack() as ends:
            _close({address: ends.enter_context(end) for address, end in _connections()}, addresses)


def _close(connections: Mapping[str, socket.socket], addresses: Iterable[str]) -> None:
    for address in addresses:
        with contextlib.suppress(KeyError, OSError):  # it has ended by itself
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
        address = _address(connection)
        if address is None:
            connection.close()
        else:
            yield address, connection


def _address(connection: socket.socket) -> str | None:
    """The other end as Zenoh has it: host:port, an IPv6 host in brackets. None for anything but a TCP connection."""
    if connection.type != socket.SOCK_STREAM or connection.family not in (socket.AF_INET, socket.AF_INET6):
        return None
    try:
        host, port = connection.getpeername()[:2]
    except OSError:  # it listens, or the other end has gone
        return None
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
