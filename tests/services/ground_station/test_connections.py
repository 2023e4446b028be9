"""Which connections and requests are served, and for how long; whose page is built, and when."""

import asyncio
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from jezero.services.ground_station.access import Listening
from jezero.services.ground_station.config import GroundStationConfig
from jezero.services.ground_station.web.connections import (
    BODY_MAX_BYTES,
    REPLY_TIMEOUT_S,
    REQUEST_TIMEOUT_S,
    WAITING_MAX,
    Connections,
    OwnPagesOnly,
    PageTurns,
    WholeBodies,
)


class Clients:
    """Clients of `Connections`, by their addresses and ports."""

    def __init__(self, stack: ExitStack) -> None:
        self.connections = Connections()
        self._stack = stack
        self._sockets: dict[tuple[str, int], tuple[socket.socket, socket.socket]] = {}

    def connect(self, address: str, port: int, now_s: float) -> tuple[str, int]:
        """Connect a client; returns its address and port."""
        near, far = socket.socketpair()
        self._stack.enter_context(near)
        self._stack.enter_context(far)
        far.setblocking(False)
        self._sockets[address, port] = (near, far)
        self.connections.add((address, port), near, now_s)
        return address, port

    def leave(self, peer: tuple[str, int]) -> None:
        """Close a connection, as the server's transport does."""
        self._sockets[peer][0].close()

    def is_open(self, peer: tuple[str, int]) -> bool:
        """Whether the connection of a client has not been ended."""
        try:
            return self._sockets[peer][1].recv(1) != b""
        except BlockingIOError:
            return True

    @property
    def number(self) -> int:
        """Number of the connections that are known."""
        return len(self.connections._connections)


@pytest.fixture
def clients() -> Iterator[Clients]:
    """Clients without connections."""
    with ExitStack() as stack:
        yield Clients(stack)


def test_a_connection_has_one_time_for_its_request_and_one_for_its_reply(clients: Clients) -> None:
    late, served, page = (clients.connect("192.0.2.1", port, 0.0) for port in (1, 2, 3))
    clients.connections.on_request(served, 5.0, lasts=False)
    clients.connections.on_request(page, 5.0, lasts=True)
    clients.connections.end_late(REQUEST_TIMEOUT_S - 0.1)
    assert clients.is_open(late)
    clients.connections.end_late(REQUEST_TIMEOUT_S)
    assert [clients.is_open(peer) for peer in (late, served, page)] == [False, True, True]
    clients.connections.on_reply(served, 20.0)
    clients.connections.end_late(20.0 + REQUEST_TIMEOUT_S - 0.1)
    assert clients.is_open(served)
    clients.connections.on_request(served, 30.0, lasts=False)
    clients.connections.end_late(30.0 + REPLY_TIMEOUT_S)
    assert [clients.is_open(peer) for peer in (late, served, page)] == [False, False, True]


def test_a_new_connection_takes_the_place_of_the_oldest_one_of_the_address_that_has_most(clients: Clients) -> None:
    first = clients.connect("192.0.2.9", 1, 0.0)
    held = [clients.connect("192.0.2.1", port, 1.0 + port / 1000) for port in range(WAITING_MAX - 1)]
    clients.connections.on_request(held[0], 2.0, lasts=True)
    one_more = clients.connect("192.0.2.1", 1000, 2.0)
    assert clients.is_open(held[1])
    others = [clients.connect("192.0.2.2", 1, 3.0), clients.connect("192.0.2.1", 1001, 3.0)]
    assert not clients.is_open(held[1])
    assert not clients.is_open(held[2])
    assert all(clients.is_open(peer) for peer in (first, held[0], held[3], one_more, *others))


def test_the_addresses_of_one_ipv6_network_are_one(clients: Clients) -> None:
    first = clients.connect("2001:db8:1::1", 1, 0.0)
    held = [clients.connect(f"2001:db8::{port}", port, 1.0 + port) for port in range(WAITING_MAX - 1)]
    clients.connect("2001:db8:2::1", 1, 500.0)
    assert clients.is_open(first)
    assert not clients.is_open(held[0])


def test_a_connection_that_has_ended_by_itself_is_forgotten(clients: Clients) -> None:
    clients.leave(clients.connect("192.0.2.1", 1, 0.0))
    clients.connect("192.0.2.1", 2, 0.0)
    clients.connections.end_late(1.0)
    assert clients.number == 1


def test_pages_are_built_one_after_the_other_in_turns_of_the_addresses_and_nothing_else_waits_for_them() -> None:
    asyncio.run(_build_pages())


async def _build_pages() -> None:
    built: list[str] = []
    may_build = asyncio.Event()

    async def site(scope: Any, receive: Any, send: Any) -> None:
        built.append(scope["name"])
        if scope["path"] == "/":
            await may_build.wait()
        await send({"type": "http.response.start"})

    async def send(message: Any) -> None:
        pass

    turns = PageTurns(site, lambda scope: bool(scope["name"] == "pilot"))

    def load(name: str, address: str, path: str = "/") -> asyncio.Task[None]:
        scope = {"type": "http", "path": path, "name": name, "client": (address, 1)}
        return asyncio.create_task(turns(scope, None, send))  # type: ignore[arg-type]

    flood = [load(f"flood {number}", "192.0.2.1") for number in range(3)]
    pages = [load("watcher", "192.0.2.2"), load("pilot", "192.0.2.1")]
    await load("login", "192.0.2.1", "/login")
    assert built == ["flood 0", "pilot", "login"]
    may_build.set()
    await asyncio.gather(*flood, *pages)
    assert built == ["flood 0", "pilot", "login", "watcher", "flood 1", "flood 2"]


LISTENING = Listening(GroundStationConfig())


async def _pages(scope: Any, receive: Any, send: Any) -> None:
    """Pages that get the whole body at once."""
    assert not (await receive())["more_body"]
    await send({"type": "http.response.start", "status": 200, "headers": []})


def sent_for(guard: Any, headers: dict[str, str], kind: str = "http", body: list[bytes] | None = None) -> Any:
    """The first message that is sent for a request."""
    sent: list[dict[str, Any]] = []
    parts = list(body or [b""])

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": parts.pop(0), "more_body": bool(parts)}

    encoded = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
    asyncio.run(guard({"type": kind, "headers": encoded}, receive, send))
    return sent[0]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "127.0.0.1:8080"}, 200),
        ({"Host": "localhost:8080", "Origin": "http://localhost:8080"}, 200),
        ({"Host": "127.0.0.1:8080", "Origin": "https://example.org"}, 403),
        ({"Host": "127.0.0.1:8080", "Origin": "null"}, 403),
        ({"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:9090"}, 403),
        ({"Host": "example.org:8080"}, 403),
        ({}, 403),
    ],
)
def test_pages_of_other_sites_are_refused(headers: dict[str, str], status: int) -> None:
    assert sent_for(OwnPagesOnly(_pages, LISTENING.serves), headers)["status"] == status


def test_a_websocket_of_another_site_is_closed() -> None:
    headers = {"Host": "127.0.0.1:8080", "Origin": "https://example.org"}
    closed = sent_for(OwnPagesOnly(_pages, LISTENING.serves), headers, "websocket")
    assert closed == {"type": "websocket.close", "code": 1008}


@pytest.mark.parametrize(
    ("length", "status"), [(str(BODY_MAX_BYTES), 200), (str(BODY_MAX_BYTES + 1), 413), ("-1", 413), ("many", 413)]
)
def test_a_large_body_is_refused_before_it_is_read(length: str, status: int) -> None:
    assert sent_for(WholeBodies(_pages), {"Content-Length": length})["status"] == status


def test_a_large_body_without_a_length_is_refused() -> None:
    parts = [b"x" * (BODY_MAX_BYTES // 2)] * 2
    assert sent_for(WholeBodies(_pages), {}, body=parts)["status"] == 200
    assert sent_for(WholeBodies(_pages), {}, body=[*parts, b"x", b"x"])["status"] == 413
