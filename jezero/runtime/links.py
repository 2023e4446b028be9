"""Byte pipes over sockets, to the autopilot and to the rover's computer; they never block."""

import contextlib
import select
import socket
import sys
from typing import Protocol

from jezero.runtime.linux_processes import listen_error

RETRY_PERIOD_NS = 100_000_000
REFUSED_PERIOD_NS = 10_000_000_000
"""A program that is refused again and again is named once in this time."""
CHUNK = 65_536
READS_MAX = 16
"""Chunks that one poll reads: a peer that sends without end must not stop the loop."""
SILENCE_MAX_S = 5
"""Time without any sign of the other computer after which a link between two computers counts as lost."""
MOVED_BY = "JEZERO_INSTANCE"
"""Environment variable that moves the port of every link."""


class SocketLink(Protocol):
    """A link as the real-time runtime uses it.

    Attributes:
        up: whether it is connected.
        connections: number of connections so far.
    """

    up: bool
    connections: int

    def start(self) -> None:
        """Open it.

        Raises:
            OSError: it can't listen on its port; the message names the port and who holds it.
        """

    def sockets(self) -> list[socket.socket]:
        """Sockets to wait on for reading."""

    def poll(self, wall_ns: int) -> bytes:
        """Bytes that have arrived; also accepts and retries connections."""

    def send(self, data: bytes) -> None:
        """Send bytes, or drop them when there is no peer or its buffer is full."""

    def close(self) -> None: ...


class _Stream:
    """The connected half of a TCP link.

    Args:
        silence_max_s: time in seconds after which a peer that acknowledges nothing counts as gone, as its computer may
            have lost its network; None leaves that to the operating system, which takes minutes.
    """

    def __init__(self, silence_max_s: int | None) -> None:
        self._silence_max_s = silence_max_s
        self.up = False
        self.connections = 0
        self._connection: socket.socket | None = None

    def _adopt(self, connection: socket.socket) -> None:
        self._drop()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._silence_max_s is not None:
            _end_when_silent(connection, self._silence_max_s)
        self._connection = connection
        self.connections += 1
        self.up = True

    def _drop(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection = None
        self.up = False

    def _receive(self) -> bytes:
        parts: list[bytes] = []
        while self._connection is not None and len(parts) < READS_MAX:
            try:
                data = self._connection.recv(CHUNK)
            except BlockingIOError:
                break
            except OSError:
                self._drop()
                break
            if not data:
                self._drop()
                break
            parts.append(data)
            if len(data) < CHUNK:
                break
        return b"".join(parts)

    def send(self, data: bytes) -> None:
        if self._connection is not None:
            try:
                self._connection.sendall(data)
            except OSError:  # the peer is gone or its buffer is full
                self._drop()


def _end_when_silent(connection: socket.socket, silence_max_s: int) -> None:
    """Let the operating system end a connection whose other end is silent, whether there is data to send or not."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, silence_max_s * 1000)


class TcpServer(_Stream):
    """A server with one connection: while it stands, another program is refused, and named in the log."""

    def __init__(self, host: str, port: int, *, silence_max_s: int | None = None) -> None:
        super().__init__(silence_max_s)
        self._address = (host, port)
        self._listener: socket.socket | None = None
        self._named_ns = -REFUSED_PERIOD_NS
        """Wall time at which a refused program was last named."""

    def start(self) -> None:
        try:
            listener = socket.create_server(self._address, backlog=1)
        except OSError as error:
            raise OSError(error.errno, listen_error("tcp", *self._address, MOVED_BY, error)) from None
        listener.setblocking(False)
        self._listener = listener

    def sockets(self) -> list[socket.socket]:
        return [s for s in (self._listener, self._connection) if s is not None]

    def poll(self, wall_ns: int) -> bytes:
        data = self._receive()
        if self._listener is not None:
            with contextlib.suppress(BlockingIOError):
                connection, (host, port) = self._listener.accept()
                if self._connection is None:
                    self._adopt(connection)
                    return b""
                connection.close()
                if wall_ns - self._named_ns >= REFUSED_PERIOD_NS:
                    self._named_ns = wall_ns
                    own = "{}:{}".format(*self._address)
                    refusal = f"a second program ({host}:{port}) was refused: another one is connected to {own}"
                    print(refusal, file=sys.stderr, flush=True)
        return data

    def close(self) -> None:
        self._drop()
        if self._listener is not None:
            self._listener.close()


class TcpClient(_Stream):
    """A client that connects again whenever its connection is lost."""

    def __init__(self, host: str, port: int, *, silence_max_s: int | None = None) -> None:
        super().__init__(silence_max_s)
        self._address = (host, port)
        self._retry_ns = 0

    def start(self) -> None:
        self._retry_ns = 0

    def sockets(self) -> list[socket.socket]:
        return [] if self._connection is None else [self._connection]

    def poll(self, wall_ns: int) -> bytes:
        if self._connection is None and wall_ns >= self._retry_ns:
            self._retry_ns = wall_ns + RETRY_PERIOD_NS
            with contextlib.suppress(OSError):
                self._adopt(socket.create_connection(self._address, timeout=0.05))
        return self._receive()

    def close(self) -> None:
        self._drop()


class Udp:
    """Datagrams from a local port to one peer.

    Args:
        local: address to bind.
        peer: address to send to.
        only_from_peer: drops datagrams of anybody else.
    """

    def __init__(self, local: tuple[str, int], peer: tuple[str, int], *, only_from_peer: bool = False) -> None:
        self._local = local
        self._peer = peer
        self._only_from_peer = only_from_peer
        self._socket: socket.socket | None = None
        self._more = select.poll()
        self.up = True
        self.connections = 1

    def start(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(self._local)
        except OSError as error:
            raise OSError(error.errno, listen_error("udp", *self._local, MOVED_BY, error)) from None
        if self._only_from_peer:
            self._socket.connect(self._peer)
        self._more.register(self._socket, select.POLLIN)

    def sockets(self) -> list[socket.socket]:
        return [] if self._socket is None else [self._socket]

    def poll(self, wall_ns: int) -> bytes:
        parts: list[bytes] = []
        while self._socket is not None and len(parts) < 256:
            try:
                parts.append(self._socket.recv(CHUNK))
            except BlockingIOError:
                break
            except OSError:  # an earlier datagram was refused by the peer's host
                continue
            if not self._more.poll(0):  # cheaper than a BlockingIOError each time
                break
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def send(self, data: bytes) -> None:
        if self._socket is None:
            return
        try:  # contextlib.suppress() takes as long as sending
            if self._only_from_peer:
                self._socket.send(data)
            else:
                self._socket.sendto(data, self._peer)
        except OSError:
            pass

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
