"""What comes between the network and the pages: which connections and requests are served, and for how long.

Each connection must bring its requests in time, and nobody can hold so many that others get none: uvicorn itself waits
without an end for a request's headers and body, and for a TLS handshake. A request then passes `OwnPagesOnly`,
`WholeBodies`, `RequestPlaces` and `PageTurns`, in this order.
"""

import asyncio
import socket
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit
from weakref import WeakValueDictionary

import uvicorn
from fastapi import Response
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets import http11

from jezero.services.ground_station.access import network_of

REQUEST_TIMEOUT_S = 10.0
"""Longest time from the start of a connection, or from its last reply, to the end of the next request's body."""
REPLY_TIMEOUT_S = 120.0
"""Until the client has read a reply. A page without a websocket is sent a reply after 48 s at the latest."""
WAITING_MAX = 128
"""Connections whose next request is not there yet."""
BACKLOG = 2048
ACCEPT_RETRY_S = 0.1
BODY_MAX_BYTES = 64_000
"""Greatest size of a request's body, and of one message that a page sends."""
TOO_LARGE = f"a request has at most {BODY_MAX_BYTES} bytes"
PLACES = {"watching": (256, 64), "logging in": (32, 4), "logged in": (64, 64)}
"""Requests and websockets that are served at the same time: of all, and of one address. A page that is loaded has up to
seven, later two."""
REST_FACTOR, REST_MAX_S = 8.0, 1.0
"""The rest after a page, for the time that it took to build: its forms, made when it connects, take thrice as long."""
CONTENT_SECURITY_POLICY = {
    "default-src": "'self'",
    # NiceGUI writes its start script and styles into the page; Vue compiles the components' templates in the browser.
    "script-src": "'self' 'unsafe-inline' 'unsafe-eval'",
    "style-src": "'self' 'unsafe-inline'",
    "img-src": "'self' blob: data:",
    "font-src": "'self' data:",
    "object-src": "'none'",
    "base-uri": "'none'",
    "form-action": "'self'",
    "frame-ancestors": "'none'",
}
RESPONSE_HEADERS = [
    ("Content-Security-Policy", "; ".join(f"{name} {sources}" for name, sources in CONTENT_SECURITY_POLICY.items())),
    ("X-Frame-Options", "DENY"),
    # With `no-referrer`, browsers send forms with the origin "null", which `OwnPagesOnly` refuses.
    ("Referrer-Policy", "same-origin"),
    ("X-Content-Type-Options", "nosniff"),
]
"""Headers of every response: no other site may show a page in a frame, and no page may load from another host."""

Peer = tuple[str, int]
"""Address and port of a client."""
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
Inner = Callable[[Any, Receive, Send], Awaitable[None]]


# -- connections --


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

        def send_with_headers(response: http11.Response) -> None:
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


# -- requests --


class OwnPagesOnly:
    """Refuses what another site's page sends: a browser would pass it on with the user's own address and log-in.

    A page of another site names itself in `Origin`; one that has pointed its own name at this machine in `Host`.

    Args:
        serves: whether a `Host` names this machine.
    """

    def __init__(self, inner: Inner, serves: Callable[[str], bool]) -> None:
        self._inner = inner
        self._serves = serves

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
            host, origin = headers.get(b"host", ""), headers.get(b"origin")
            if not self._serves(host) or (origin is not None and not _is_same(origin, host)):
                await _refuse(scope, receive, send, 403, "only this machine's own pages are served")
                return
        await self._inner(scope, receive, send)


def _is_same(origin: str, host: str) -> bool:
    return urlsplit(origin).netloc.lower() == host.lower()


class WholeBodies:
    """Reads a request's body before the request takes a place; refuses one that is larger than any of a page.

    A client that does not send the body in time is disconnected by `Connections`.
    """

    def __init__(self, inner: Inner) -> None:
        self._inner = inner

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._inner(scope, receive, send)
            return
        length = next((value for name, value in scope["headers"] if name == b"content-length"), b"0")
        if not length.isdigit() or int(length) > BODY_MAX_BYTES:
            await _refuse(scope, receive, send, 413, TOO_LARGE)
            return
        body, more = b"", True
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            body += message.get("body", b"")
            if len(body) > BODY_MAX_BYTES:  # a body without a length
                await _refuse(scope, receive, send, 413, TOO_LARGE)
                return
            more = message.get("more_body", False)
        whole = [{"type": "http.request", "body": body, "more_body": False}]

        async def receive_whole() -> Any:
            return whole.pop() if whole else await receive()

        await self._inner(scope, receive_whole, send)


class RequestPlaces:
    """Bounds the requests that are served at the same time, for all and for each address.

    Requests to log in have places of their own, and so have those of people who have logged in, also at an address that
    they share with others.

    Args:
        has_login: returns whether the request of a scope is one of somebody who has logged in.
    """

    def __init__(self, inner: Inner, connections: Connections, has_login: Callable[[Any], bool]) -> None:
        self._inner = inner
        self._connections = connections
        self._has_login = has_login
        self._taken: Counter[str | tuple[str, str]] = Counter()

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._inner(scope, receive, send)
            return
        peer = scope["client"]
        kind = "logged in" if self._has_login(scope) else "logging in" if scope["path"] == "/login" else "watching"
        address = (kind, network_of(peer[0]))
        number, number_of_address = PLACES[kind]
        if self._taken[kind] >= number or self._taken[address] >= number_of_address:
            await _refuse(scope, receive, send, 503, "too many requests at the same time: try again")
            return
        self._taken.update((kind, address))
        self._connections.on_request(peer, time.monotonic(), lasts=scope["type"] == "websocket")
        try:
            await self._inner(scope, receive, send)
        finally:
            self._taken.subtract((kind, address))
            self._taken = +self._taken  # without the addresses that have no request any more
            self._connections.on_reply(peer, time.monotonic())


class PageTurns:
    """Builds the pages of people who have not logged in one after the other, and the addresses take turns.

    The server's thread does nothing else while it builds a page. So the next page waits for some time: else all other
    requests, and the pages that are open, would wait for all new pages whenever several are loaded.

    Args:
        has_login: as in `RequestPlaces`.
    """

    def __init__(self, inner: Inner, has_login: Callable[[Any], bool]) -> None:
        self._inner = inner
        self._has_login = has_login
        self._turn = asyncio.Lock()
        self._turns: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        """The locks of the addresses that have a page to build: one page of each waits for its turn among all."""

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not _is_page(scope["path"]) or self._has_login(scope):
            await self._inner(scope, receive, send)
            return
        async with self._turns.setdefault(network_of(scope["client"][0]), asyncio.Lock()):
            await self._build(scope, receive, send)

    async def _build(self, scope: Any, receive: Receive, send: Send) -> None:
        await self._turn.acquire()
        start_s, ends = time.monotonic(), True

        def end_turn() -> None:
            nonlocal ends
            if ends:
                ends = False
                rest_s = min(REST_FACTOR * (time.monotonic() - start_s), REST_MAX_S)
                asyncio.get_running_loop().call_later(rest_s, self._turn.release)

        async def send_built(message: Any) -> None:
            end_turn()  # the page is built: the turn does not last until a slow client has read it
            await send(message)

        try:
            await self._inner(scope, receive, send_built)
        finally:
            end_turn()


def _is_page(path: str) -> bool:
    return path == "/" or path.startswith("/recording/")


async def _refuse(scope: Any, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
    else:
        await Response(f"{reason}\n", status_code=status, media_type="text/plain")(scope, receive, send)
