"""Every response forbids that another site shows it in a frame, and that it loads from another host."""

import re
from collections.abc import Iterator

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from tests.services.ground_station.serving import ADDRESS, PASSWORD, ask, opened, serving

pytestmark = pytest.mark.process

STATIC_FILE = re.compile(r'/_nicegui/[^"]+/static/nicegui\.js')
UPGRADE = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
KEY = "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
WEBSOCKET = f"GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nHost: {ADDRESS}\r\n{UPGRADE}"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """The address of a server."""
    with serving() as pages:
        yield pages


def check(headers: dict[str, str]) -> None:
    """Compare the headers of a response, by their names in lower case, with those that each must have."""
    assert headers["x-frame-options"] == "DENY"
    assert headers["referrer-policy"] == "same-origin"
    assert headers["x-content-type-options"] == "nosniff"
    policy = dict(each.split(maxsplit=1) for each in headers["content-security-policy"].split("; "))
    assert policy["frame-ancestors"] == "'none'"
    assert policy["default-src"] == "'self'"
    own = {"'self'", "'none'", "'unsafe-inline'", "'unsafe-eval'", "blob:", "data:"}
    assert {source for sources in policy.values() for source in sources.split()} <= own


@pytest.mark.parametrize(
    ("method", "path", "fields", "sent", "status"),
    [
        ("GET", "/", None, {}, 200),
        ("GET", "/login", None, {}, 200),
        ("GET", "/recordings", None, {}, 200),
        ("GET", "/camera.jpg", None, {}, 204),
        ("GET", "/nothing", None, {}, 404),
        ("GET", "/recorded.jpg", None, {}, 422),
        ("GET", "/_nicegui_ws/socket.io/", None, {}, 400),
        ("POST", "/", None, {}, 405),
        ("GET", "/", None, {"Host": "example.org"}, 403),
        ("POST", "/login", {"password": "x" * 70_000}, {}, 413),
        ("POST", "/login", {"password": "a wrong password"}, {}, 401),
        ("POST", "/login", {"password": PASSWORD}, {}, 303),
    ],
)
def test_each_response_has_the_headers(
    address: str, method: str, path: str, fields: dict[str, str] | None, sent: dict[str, str], status: int
) -> None:
    reply = ask(address, method, path, fields, **sent)
    assert reply.status == status
    check({name.lower(): value for name, value in reply.headers.items()})


def test_static_files_have_the_headers(address: str) -> None:
    found = STATIC_FILE.search(ask(address, "GET", "/").text)
    assert found is not None
    reply = ask(address, "GET", found[0])
    assert reply.status == 200
    check({name.lower(): value for name, value in reply.headers.items()})


@pytest.mark.parametrize(
    ("request_text", "status"),
    [
        (f"{WEBSOCKET}{KEY}", 101),
        (f"{WEBSOCKET}Sec-WebSocket-Key: short\r\n\r\n", 400),
        (f"{WEBSOCKET}Origin: http://example.org\r\n{KEY}", 403),
        (f"GET /nothing HTTP/1.1\r\nHost: {ADDRESS}\r\n{UPGRADE}{KEY}", 403),
        ("this is no request\r\n\r\n", 400),
    ],
)
def test_websockets_and_what_is_no_request_get_responses_with_the_headers(
    address: str, request_text: str, status: int
) -> None:
    with opened(address, "127.0.0.1", request_text.encode()) as connection:
        received = b""
        while b"\r\n\r\n" not in received and (part := connection.recv(4096)):
            received += part
    first, *lines = received.partition(b"\r\n\r\n")[0].decode().split("\r\n")
    assert first.split()[1] == str(status)
    check({name.lower(): value for name, value in (line.split(": ", 1) for line in lines)})
