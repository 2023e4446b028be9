"""Which requests are served at the same time: nobody can take all places, and who has logged in has some of his own."""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from typing import Any
from weakref import WeakValueDictionary

from jezero.services.ground_station.sessions import network_of
from jezero.services.ground_station.web.connections import Connections
from jezero.services.ground_station.web.guard import Inner, Receive, Send, refuse

PLACES = {"watching": (256, 64), "logging in": (32, 4), "logged in": (64, 64)}
"""Requests and websockets that are served at the same time: of all, and of one address. A page that is loaded has up to
seven, later two."""
REST_FACTOR, REST_MAX_S = 8.0, 1.0
"""The rest after a page, for the time that it took to build: its forms, made when it connects, take thrice as long."""


class Places:
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
            await refuse(scope, receive, send, 503, "too many requests at the same time: try again")
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
        has_login: as in `Places`.
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
