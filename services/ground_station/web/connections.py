"""The connections of the pages' server: each must bring its requests in time, and nobody can hold so many that others
get none.

uvicorn itself waits without an end for a request's headers and body, and for a TLS handshake.
"""

import asyncio
import socket
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.http11 import Response

from jezero.services.ground_station.sessions import network_of

REQUEST_TIMEOUT_S = 10.0
"""Longest time from the start of a connection, or from its last reply, to the end of the next request's body."""
REPLY_TIMEOUT_S = 120.0
"""Until the client has read a reply. A page without a websocket is sent a reply after 48 s at the latest."""
WAITING_MAX = 128
"""Connections whose next request is not there yet."""
BACKLOG = 2048
ACCEPT_RETRY_S = 0.1

Peer = tuple[str, int]
"""Address and port of a client."""


@dataclass
class _Connection:
    """One connection.

    Attributes:
        socket: the server's end.
        network: the client's, which counts as one address.
        waits: whether its next request is not there yet.
        end_s: time at which the connection ends; infinity for never.
    """

    socket: socket.socket
    network: str
    waits: bool
    end_s: float


class Connections:
    """The open connections, by the address and port of their clients.

    Times are seconds of a monotonic clock that the caller reads.
    """

    def __init__(self) -> None:
        self._connections: dict[Peer, _Connection] = {}

    def add(self, peer: Peer, accepted: socket.socket, now_s: float) -> None:
        """Add a connection. When too many wait, the oldest of the address that has most of them ends.

        So a new connection always finds a place, also from the address of somebody who holds many.
        """
        waiting = [each for each in self._connections.items() if each[1].waits]
        if len(waiting) >= WAITING_MAX:
            numbers = Counter(connection.network for _, connection in waiting)
            self._end(max(waiting, key=lambda each: (numbers[each[1].network], -each[1].end_s))[0])
        self._connections[peer] = _Connection(accepted, network_of(peer[0]), True, now_s + REQUEST_TIMEOUT_S)

    def on_request(self, peer: Peer, now_s: float, *, lasts: bool) -> None:
        """Note that a whole request has arrived; one that `lasts` opens a websocket."""
        if (connection := self._connections.get(peer)) is not None:
            connection.waits, connection.end_s = False, float("inf") if lasts else now_s + REPLY_TIMEOUT_S

    def on_reply(self, peer: Peer, now_s: float) -> None:
        """Note that a request has its whole reply."""
        if (connection := self._connections.get(peer)) is not None:
            connection.waits, connection.end_s = True, now_s + REQUEST_TIMEOUT_S

    def end_late(self, now_s: float) -> None:
        """End the connections whose time is over, and forget those that have ended."""
        for peer, connection in list(self._connections.items()):
            if connection.end_s <= now_s or connection.socket.fileno() == -1:
                self._end(peer)

    def _end(self, peer: Peer) -> None:
        """End a connection, in its TLS handshake too: whoever has the socket reads its end, and closes it."""
        with suppress(OSError):  # it has ended by itself
            self._connections.pop(peer).socket.shutdown(socket.SHUT_RDWR)


class _Http(H11Protocol):
    """uvicorn's protocol for HTTP, which also bounds the size of the headers; with the server's headers on errors."""

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no request."""
        lines = [b"HTTP/1.1 400 Bad Request", b"content-type: text/plain; charset=utf-8", b"connection: close"]
        lines += [b"%s: %s" % header for header in self.server_state.default_headers]
        self.transport.write(b"\r\n".join([*lines, b"", msg.encode("ascii")]))
        self.transport.close()


class WebSocket(WebSocketsSansIOProtocol):
    """uvicorn's protocol for websockets, with the server's headers on refusals too."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        send_response = self.conn.send_response

        def send_with_headers(response: Response) -> None:
            for name, value in self.default_headers:
                if name.decode() not in response.headers:
                    response.headers[name.decode()] = value.decode()
            send_response(response)

        self.conn.send_response = send_with_headers  # type: ignore[method-assign]


class BoundedServer(uvicorn.Server):
    """A server that accepts its connections itself, so that each is counted from its start.

    Args:
        listening: the socket on which it listens.
    """

    def __init__(self, config: uvicorn.Config, listening: socket.socket, connections: Connections) -> None:
        super().__init__(config)
        self._listening = listening
        self._connections = connections
        self._tasks: set[asyncio.Task[None]] = set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to accept."""
        await super().startup([])
        self._listening.setblocking(False)
        self._listening.listen(BACKLOG)
        self._start(self._accept())

    async def on_tick(self, counter: int) -> bool:
        """End late connections, ten times a second."""
        self._connections.end_late(time.monotonic())
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop to accept, and end all connections."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._listening.close()
        await super().shutdown()

    def _start(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)  # the event loop keeps no task from being deleted
        task.add_done_callback(self._tasks.discard)

    async def _accept(self) -> None:
        while True:
            try:
                accepted, address = await asyncio.get_running_loop().sock_accept(self._listening)
            except OSError:  # the client has gone, or this process has too many files open
                await asyncio.sleep(ACCEPT_RETRY_S)
                continue
            self._connections.add(address[:2], accepted, time.monotonic())
            self._start(self._open(accepted))

    async def _open(self, accepted: socket.socket) -> None:
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: _Http(self.config, self.server_state, self.lifespan.state),
                accepted,
                ssl=self.config.ssl if self.config.is_ssl else None,
            )
        except OSError:  # no TLS handshake
            accepted.close()
