"""Ends the links of readers that stopped reading, in the process of the router.

A program that subscribes and then stands still (a laptop asleep, a debugger, SIGSTOP) fills the buffers of its
connection. Nobody waits for it: everything is published with Zenoh's congestion control DROP. But the router would
keep its link for as long as the program's own lease says. So a link whose connection has bytes to send and gets none
acknowledged for a second is closed, and named. A client of Zenoh connects again when it continues.
"""

import contextlib
import os
import socket
import stat
import struct
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

STUCK_MAX_S = 1.0
STEP_MAX_S = 0.5
"""The time between two samples counts as at most this: the router itself may have been stopped."""
TCP_INFO_BYTES = 148
ACKNOWLEDGED_OFFSET, UNSENT_OFFSET = 120, 144
"""Offsets of `tcpi_bytes_acked` and `tcpi_notsent_bytes` in the kernel's `struct tcp_info` (linux/tcp.h)."""

CLOSE_IN_BACKGROUND = struct.pack("ii", 0, 0)
"""`struct linger`. Zenoh asks for 10 s of lingering: closing a connection with unsent bytes would stop a thread that
routes for so long, and a few such connections at once would stop the whole bus."""
CLOSE_WITH_RESET = struct.pack("ii", 1, 0)
"""`struct linger`: discards the unsent bytes at once."""


@dataclass(frozen=True, kw_only=True)
class LinkSample:
    """State of one connection at one time.

    Attributes:
        unsent_bytes: bytes that wait in this host because the other end takes none.
        acknowledged_bytes: all bytes that the other end has acknowledged so far.
    """

    unsent_bytes: int
    acknowledged_bytes: int


@dataclass
class _Record:
    previous: LinkSample
    stuck_s: float = 0.0
    reported: bool = False

    def add(self, sample: LinkSample, step_s: float) -> None:
        progress = sample.acknowledged_bytes != self.previous.acknowledged_bytes
        self.stuck_s = 0.0 if progress or sample.unsent_bytes == 0 else self.stuck_s + step_s
        self.previous = sample


class StoppedReaderDetector:
    """Detects readers that stopped reading from samples of their connections."""

    def __init__(self) -> None:
        self._records: dict[str, _Record] = {}
        self._last_s: float | None = None

    def update(self, now_s: float, samples: Mapping[str, LinkSample]) -> list[str]:
        """Update with new samples; returns each stopped reader once.

        A link that ended while it was stuck is returned too, because Zenoh ends one itself when a reply can't be sent.

        Args:
            now_s: monotonic time.
            samples: samples by the address of the other end; a missing connection has ended.
        """
        step_s = 0.0 if self._last_s is None else min(now_s - self._last_s, STEP_MAX_S)
        self._last_s = now_s
        ended = {address: record for address, record in self._records.items() if address not in samples}
        self._records = {address: self._records.get(address) or _Record(sample) for address, sample in samples.items()}
        for address, sample in samples.items():
            self._records[address].add(sample, step_s)
        stopped = [address for address, record in ended.items() if record.stuck_s > 0.0 and not record.reported]
        for address, record in self._records.items():
            if record.stuck_s >= STUCK_MAX_S and not record.reported:
                record.reported = True
                stopped.append(address)
        return stopped


class LinkGuard:
    """Closes the connections of this process whose readers stopped reading."""

    def __init__(self) -> None:
        self._detector = StoppedReaderDetector()

    def update(self, now_s: float) -> list[str]:
        """Sample all connections, and close those of stopped readers; returns their addresses, host:port."""
        with contextlib.ExitStack() as ends:
            connections = {address: ends.enter_context(end) for address, end in _connections()}
            for end in connections.values():
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, CLOSE_IN_BACKGROUND)
            samples = {address: sample_connection(end) for address, end in connections.items()}
            stopped = self._detector.update(now_s, samples)
            _close(connections, stopped)
        return stopped

    def close(self, addresses: Collection[str]) -> None:
        """Close the connections with these addresses."""
        with contextlib.ExitStack() as ends:
            _close({address: ends.enter_context(end) for address, end in _connections()}, addresses)


def _close(connections: Mapping[str, socket.socket], addresses: Iterable[str]) -> None:
    for address in addresses:
        with contextlib.suppress(KeyError, OSError):  # it has ended by itself
            connections[address].setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, CLOSE_WITH_RESET)
            connections[address].shutdown(socket.SHUT_RDWR)


def sample_connection(connection: socket.socket) -> LinkSample:
    """Sample a TCP connection."""
    info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)
    (acknowledged_bytes,) = struct.unpack_from("=Q", info, ACKNOWLEDGED_OFFSET)
    (unsent_bytes,) = struct.unpack_from("=I", info, UNSENT_OFFSET)
    return LinkSample(unsent_bytes=unsent_bytes, acknowledged_bytes=acknowledged_bytes)


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
