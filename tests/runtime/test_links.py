"""A server's one connection can't be taken over, and its end leaves the place free."""

import socket
import time
from collections.abc import Callable, Iterator

import pytest

from jezero.runtime.links import TcpServer

HOST = "127.0.0.1"
WAIT_S = 5.0


@pytest.fixture
def server() -> Iterator[tuple[TcpServer, int]]:
    """A server and its port."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port: int = probe.getsockname()[1]
    server = TcpServer(HOST, port)
    server.start()
    yield server, port
    server.close()


def polled(server: TcpServer, condition: Callable[[], bool]) -> bool:
    """Whether a condition comes true while the server is polled."""
    deadline_s = time.monotonic() + WAIT_S
    while not condition() and time.monotonic() < deadline_s:
        server.poll(time.monotonic_ns())
    return condition()


def received_by(server: TcpServer) -> bytes:
    """The first bytes that arrive."""
    deadline_s = time.monotonic() + WAIT_S
    data = b""
    while not data and time.monotonic() < deadline_s:
        data = server.poll(time.monotonic_ns())
    return data


def is_closed(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


def test_a_second_program_is_refused_and_named_while_the_first_is_connected(
    server: tuple[TcpServer, int], capsys: pytest.CaptureFixture[str]
) -> None:
    link, port = server
    with socket.create_connection((HOST, port)) as first:
        assert polled(link, lambda: link.up)
        for _ in range(3):
            with socket.create_connection((HOST, port)) as second:
                second.setblocking(False)
                assert polled(link, lambda: is_closed(second))
        first.sendall(b"still here")
        assert received_by(link) == b"still here"
        assert (link.up, link.connections) == (True, 1)
    assert capsys.readouterr().err.count(f"was refused: another one is connected to {HOST}:{port}") == 1


def test_when_a_program_has_ended_the_next_one_is_taken(server: tuple[TcpServer, int]) -> None:
    link, port = server
    for number in (1, 2):
        with socket.create_connection((HOST, port)):
            assert polled(link, lambda: link.connections == number and link.up)  # noqa: B023 - called within this round
