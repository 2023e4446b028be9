"""A client that holds connections, requests or websockets keeps nobody else from the pages of a real server."""

import select
import shutil
import socket
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from jezero.services.ground_station.web.connections import PLACES, REQUEST_TIMEOUT_S
from tests.services.ground_station.serving import ADDRESS, NO_ROUTER, PASSWORD, ask, make_certificate, opened, serving
from tests.system.conftest import wait_for

pytestmark = pytest.mark.process

WATCHING_MAX, WATCHING_ADDRESS_MAX = PLACES["watching"]
ATTACKER, PILOT = "127.0.0.3", "127.0.0.4"
HELD = 250
BODY_BYTES = 60_000
BEGUN_HEADERS = f"GET / HTTP/1.1\r\nHost: {ADDRESS}\r\nX-".encode()
BEGUN_BODY = f"POST /login HTTP/1.1\r\nHost: {ADDRESS}\r\nContent-Length: {BODY_BYTES}\r\n\r\npassword=".encode()
BEGUN_CHUNKS = f"POST /login HTTP/1.1\r\nHost: {ADDRESS}\r\nTransfer-Encoding: chunked\r\n\r\n1\r\nx".encode()
WEBSOCKET = (
    f"GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nHost: {ADDRESS}\r\nConnection: Upgrade\r\n"
    "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
).encode()


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """The address of a server without TLS."""
    with serving() as pages:
        yield pages


def is_open(connection: socket.socket) -> bool:
    """Whether the server has sent nothing, and has not ended a connection."""
    return not select.select([connection], [], [], 0)[0]


def ends(connection: socket.socket, trickle: bytes, deadline_s: float) -> None:
    """Wait until the server ends a connection, to which bytes are sent again and again."""

    def has_ended() -> bool:
        with suppress(OSError):
            connection.sendall(trickle)
        return not is_open(connection)

    wait_for(has_ended, deadline_s, "the server ends a connection that brings no request")


@pytest.mark.parametrize("begun", [b"", BEGUN_HEADERS, BEGUN_BODY, BEGUN_CHUNKS])
def test_requests_of_one_address_that_never_end_lock_out_nobody(address: str, begun: bytes) -> None:
    cookie = ask(address, "POST", "/login", {"password": PASSWORD}, source=PILOT).cookie
    with ExitStack() as stack:
        held = [stack.enter_context(opened(address, ATTACKER, begun)) for _ in range(HELD)]
        assert ask(address, "GET", "/login", source="127.0.0.5").status == 200
        assert ask(address, "GET", "/", source=PILOT, Cookie=cookie).status == 200
        assert ask(address, "GET", "/", source=ATTACKER, Cookie=cookie).status == 200
        assert sum(map(is_open, held)) > 100


@pytest.mark.long
def test_a_connection_ends_that_does_not_bring_its_headers_or_its_body_in_time_though_it_sends_bytes(
    address: str,
) -> None:
    with ExitStack() as stack:
        for begun, trickle in ((b"", b""), (BEGUN_HEADERS, b"x"), (BEGUN_BODY, b"x"), (BEGUN_CHUNKS, b"\r\n1\r\nx")):
            connection = stack.enter_context(opened(address, ATTACKER, begun))
            ends(connection, trickle, 6 * REQUEST_TIMEOUT_S)
            assert connection.recv(100) == b"", begun


def test_a_request_in_time_has_its_reply_though_its_body_comes_in_parts(address: str) -> None:
    with opened(address, ATTACKER, BEGUN_BODY) as connection:
        for part in (b"wrong&x=", b"y" * (BODY_BYTES - len(b"password=wrong&x="))):
            assert is_open(connection)
            connection.sendall(part)
        assert connection.recv(100).startswith(b"HTTP/1.1 401 ")


def test_headers_without_an_end_are_refused_before_they_fill_the_memory(address: str) -> None:
    with opened(address, ATTACKER, BEGUN_HEADERS) as connection:
        with suppress(OSError):  # the server has ended the connection
            connection.sendall(b"x" * 1_000_000)
        with suppress(ConnectionResetError):
            assert connection.recv(100).startswith(b"HTTP/1.1 400 ")


def test_who_has_logged_in_and_who_logs_in_have_places_when_watchers_have_taken_all_of_theirs() -> None:
    with serving() as address, ExitStack() as stack:
        for number in range(WATCHING_MAX):
            source = f"127.0.2.{1 + number // WATCHING_ADDRESS_MAX}"
            connection = stack.enter_context(opened(address, source, WEBSOCKET))
            assert connection.recv(100).startswith(b"HTTP/1.1 101 "), number
        with opened(address, "127.0.2.1", WEBSOCKET) as connection:
            assert connection.recv(100).startswith(b"HTTP/1.1 403 ")
        assert ask(address, "GET", "/", source="127.0.0.5").status == 503
        login = ask(address, "POST", "/login", {"password": PASSWORD}, source=PILOT)
        assert login.status == 303
        assert ask(address, "GET", "/", source=PILOT, Cookie=login.cookie).status == 200


def test_places_are_free_again_after_their_requests() -> None:
    with serving() as address:
        for _ in range(2):
            with ExitStack() as stack:
                for _ in range(WATCHING_ADDRESS_MAX):
                    connection = stack.enter_context(opened(address, ATTACKER, WEBSOCKET))
                    assert connection.recv(100).startswith(b"HTTP/1.1 101 ")
                assert ask(address, "GET", "/recordings", source=ATTACKER).status == 503
            wait_for(
                lambda: ask(address, "GET", "/recordings", source=ATTACKER).status == 200, 60, "a place becomes free"
            )


@pytest.mark.long
@pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no openssl on the path")
def test_a_tls_handshake_that_never_ends_locks_out_nobody_and_ends(tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path)
    with serving(NO_ROUTER, f"certificate={certificate}", f"key={key}") as address, ExitStack() as stack:
        held = [stack.enter_context(opened(address, ATTACKER, b"")) for _ in range(HELD)]
        assert ask(address, "GET", "/login", source=PILOT).status == 200
        assert ask(address, "GET", "/login", source=ATTACKER).status == 200
        assert sum(map(is_open, held)) > 100
        ends(held[-1], b"", 6 * REQUEST_TIMEOUT_S)
