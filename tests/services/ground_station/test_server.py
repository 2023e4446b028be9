"""Where the web server listens, and whom it refuses."""

import asyncio
import socket
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from jezero.services.ground_station.web.server import HOST, OwnPagesOnly, listening_socket


def status_of(headers: dict[str, str]) -> int:
    """The status of the reply to a GET with these headers."""
    sent: list[dict[str, Any]] = []

    async def inner(scope: Any, receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request"}

    encoded = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
    asyncio.run(OwnPagesOnly(inner)({"type": "http", "headers": encoded}, receive, send))
    return int(sent[0]["status"])


def test_a_busy_port_is_left_and_the_next_free_one_is_taken() -> None:
    with listening_socket(0) as first:
        port = first.getsockname()[1]
        with listening_socket(port) as second:
            assert second.getsockname() != first.getsockname()
            assert second.getsockname()[0] == HOST


def test_it_listens_on_the_loopback_address_only() -> None:
    with listening_socket(0) as listening:
        assert listening.family == socket.AF_INET
        assert listening.getsockname()[0] == "127.0.0.1"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "127.0.0.1:8080"}, 200),
        ({"Host": "localhost:8080", "Origin": "http://localhost:8080"}, 200),
        ({"Host": "127.0.0.1:8080", "Origin": "https://example.org"}, 403),
        ({"Host": "127.0.0.1:8080", "Origin": "null"}, 403),
        ({"Host": "example.org:8080"}, 403),
        ({}, 403),
    ],
)
def test_pages_of_other_sites_are_refused(headers: dict[str, str], status: int) -> None:
    assert status_of(headers) == status
