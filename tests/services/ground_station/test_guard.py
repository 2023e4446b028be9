"""Which requests reach the pages at all."""

import asyncio
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from jezero.services.ground_station.listening import Listening
from jezero.services.ground_station.web.guard import BODY_MAX_BYTES, OwnPagesOnly, WholeBodies

LISTENING = Listening("127.0.0.1", "", "", "", frozenset())


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
