"""Byte pipes over sockets and serial lines, to autopilot, modules and the rover's computer; they never block."""

import contextlib
import re
import select
import socket
import sys
from collections.abc import Sequence
from errno import EACCES, EAGAIN, EBUSY, ENOENT, EPERM
from typing import TYPE_CHECKING, Protocol

from jezero.base.config import ConfigError
from jezero.runtime.instance import checked_host
from jezero.runtime.linux_processes import listen_error

if TYPE_CHECKING:
    from serial import Serial

RETRY_PERIOD_NS = 100_000_000
LINE_RETRY_PERIOD_NS = 1_000_000_000
LINE_BACKLOG_S = 0.05
"""Time of a serial line that bytes to send may wait for: what is later is dropped, as a setpoint would be too old."""
LINE_BACKLOG_MIN_BYTES = 600
"""Waiting bytes that even the slowest line permits: two of MAVLink's longest messages."""
PEER_SILENCE_MAX_NS = 5_000_000_000
"""Time after which another program may take the place of a silent sender of datagrams."""
REFUSED_PERIOD_NS = 10_000_000_000
"""A program that is refused again and again is named once in this time."""
OWN_PORT_ABOVE = 10_000
CHUNK = 65_536
READS_MAX = 16
"""Chunks that one poll reads: a peer that sends without end must not stop the loop."""
SILENCE_MAX_S = 5
"""Time without any sign of the other computer after which a link between two computers counts as lost."""
MOVED_BY = "JEZERO_INSTANCE"
"""Environment variable that moves the port of every link."""


class HasFileno(Protocol):
    """What can be waited on for reading."""

    def fileno(self) -> int: ...


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

    def sockets(self) -> Sequence[HasFileno]:
        """Sockets or lines to wait on for reading."""

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

    def sockets(self) -> Sequence[HasFileno]:
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

    def sockets(self) -> Sequence[HasFileno]:
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
        self._socket = _bound(self._local)
        if self._only_from_peer:
            self._socket.connect(self._peer)
        self._more.register(self._socket, select.POLLIN)

    def sockets(self) -> Sequence[HasFileno]:
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


def _bound(address: tuple[str, int]) -> socket.socket:
    """A socket for datagrams to an address.

    Raises:
        OSError: another program has the address; the message names it.
    """
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bound.setblocking(False)
    try:
        bound.bind(address)
    except OSError as error:
        bound.close()
        raise OSError(error.errno, listen_error("udp", *address, MOVED_BY, error)) from None
    return bound


class UdpListener:
    """Datagrams from whoever sends first to a local port, until that sender is silent; replies go to it.

    Args:
        host: address to bind.
        port: port to bind.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._peer: tuple[str, int] | None = None
        self._heard_ns = 0
        self.up = False
        self.connections = 0

    def start(self) -> None:
        self._socket = _bound(self._address)

    def sockets(self) -> Sequence[HasFileno]:
        return [] if self._socket is None else [self._socket]

    def poll(self, wall_ns: int) -> bytes:
        parts: list[bytes] = []
        while self._socket is not None and len(parts) < 256:
            try:
                data, sender = self._socket.recvfrom(CHUNK)
            except BlockingIOError:
                break
            except OSError:  # an earlier datagram was refused by the peer's host
                continue
            if sender != self._peer:
                if self._peer is not None and wall_ns - self._heard_ns < PEER_SILENCE_MAX_NS:
                    continue
                self._peer = sender
                self.connections += 1
                self.up = True
            self._heard_ns = wall_ns
            parts.append(data)
        return b"".join(parts)

    def send(self, data: bytes) -> None:
        if self._socket is not None and self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._peer)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


class SerialLine:
    """A serial line, which is opened again when it was unplugged.

    Args:
        path: the device, e.g. `/dev/ttyACM0`.
        baud: bits per second.
    """

    def __init__(self, path: str, baud: int) -> None:
        self._path = path
        self._baud = baud
        self._backlog_max = max(LINE_BACKLOG_MIN_BYTES, int(baud / 10 * LINE_BACKLOG_S))
        self._line: Serial | None = None
        self._retry_ns = 0
        self._named = ""
        """The last error, which is printed once."""
        self.up = False
        self.connections = 0

    def start(self) -> None:
        self._retry_ns = 0

    def sockets(self) -> Sequence[HasFileno]:
        return [] if self._line is None else [self._line]

    def poll(self, wall_ns: int) -> bytes:
        if self._line is None and wall_ns >= self._retry_ns:
            self._retry_ns = wall_ns + LINE_RETRY_PERIOD_NS
            self._open()
        if self._line is None:
            return b""
        try:
            return self._line.read(CHUNK)
        except OSError as error:  # pyserial's errors are such
            self._drop(f"it was unplugged ({error})")
            return b""

    def send(self, data: bytes) -> None:
        if self._line is None:
            return
        try:
            if self._line.out_waiting + len(data) <= self._backlog_max:
                self._line.write(data)
        except OSError as error:
            self._drop(f"it was unplugged ({error})")

    def close(self) -> None:
        if self._line is not None:
            self._line.close()
        self._line, self.up = None, False

    def _open(self) -> None:
        from serial import Serial, SerialException

        try:
            line = Serial(self._path, self._baud, timeout=0, write_timeout=0, exclusive=True)
            line.reset_input_buffer()
        except (SerialException, OSError, ValueError) as error:
            self._name(_line_error(error))
            return
        self._line, self.up, self._named = line, True, ""
        self.connections += 1

    def _drop(self, reason: str) -> None:
        self.close()
        self._name(reason)

    def _name(self, reason: str) -> None:
        if reason != self._named:
            self._named = reason
            print(f"serial line {self._path}: {reason}; it is tried again every second", file=sys.stderr, flush=True)


def _line_error(error: Exception) -> str:
    """Why a line can't be opened, for people."""
    number = getattr(error, "errno", None)
    if number == ENOENT:
        return "there is no such device: is it plugged in?"
    if number in (EACCES, EPERM):
        return "this user may not open it: add the user to the group `dialout`, and log in again"
    if number in (EBUSY, EAGAIN):
        return "another program has opened it: end that one first"
    return f"it can't be opened: {error}"


def own_port(peer_port: int) -> int:
    """Port from which `udpout` sends to a peer's port: the same after a restart.

    PX4 sends for ever to the port that it has first heard something from; a new port would be deaf.
    """
    return peer_port + OWN_PORT_ABOVE if peer_port + OWN_PORT_ABOVE <= 65_535 else peer_port - OWN_PORT_ABOVE


ADDRESSES = "serial:DEVICE:BAUD, udpin:ADDRESS:PORT, udpout:HOST:PORT or tcp:HOST:PORT"


def link_of(name: str, address: str, *, signed: bool = False, remedy: str = "") -> SocketLink:
    """The link that an address names.

    Args:
        name: of the setting, for the error.
        address: one of `ADDRESSES`.
        signed: whether its messages are signed, so that it may lead to another computer.
        remedy: what makes this kind of link safe, for the error; "" for nothing.

    Raises:
        ConfigError: the address is malformed, or leads to another computer without a person's permission.
    """
    if (line := re.fullmatch(r"serial:(/.+):(\d{3,7})", address)) is not None:
        return SerialLine(line[1], int(line[2]))
    found = re.fullmatch(r"(udpin|udpout|tcp):([^:]+):(\d{1,5})", address)
    if found is None or not 1 <= int(found[3]) <= 65535:
        raise ConfigError(f"{name} is {address!r}: write {ADDRESSES}")
    kind, port = found[1], int(found[3])
    host = checked_host(name, found[2], signed=signed, remedy=remedy)
    if kind == "udpin":
        return UdpListener(host, port)
    if kind == "udpout":
        return Udp(("0.0.0.0", own_port(port)), (host, port), only_from_peer=True)
    return TcpClient(host, port, silence_max_s=SILENCE_MAX_S)
