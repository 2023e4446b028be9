"""Which readers' links end."""

import socket
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from jezero.runtime.router import LinkGuard, unsent_bytes
from tests.system.conftest import wait_for

pytestmark = pytest.mark.process

PERIOD_S = 0.1
Ends = tuple[socket.socket, socket.socket]


@pytest.fixture
def ends() -> Iterator[Ends]:
    """Both ends of a TCP connection of this process: the writing one, and the reading one."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        reader = socket.create_connection(listener.getsockname())
        writer, _ = listener.accept()
    with reader, writer:
        writer.setblocking(False)
        yield writer, reader


def fill(writer: socket.socket) -> None:
    """Write until the other end would have to read."""
    with suppress(BlockingIOError):
        while True:
            writer.send(bytes(65536))


def address(reader: socket.socket) -> str:
    return "{}:{}".format(*reader.getsockname())


def test_the_connection_of_a_stopped_reader_is_closed_and_named_once(ends: Ends) -> None:
    writer, reader = ends
    guard = LinkGuard()
    assert guard.update() == []
    fill(writer)
    wait_for(lambda: unsent_bytes(writer) > 0, 5.0, "bytes that wait")
    ended: list[str] = []

    def has_ended() -> bool:
        ended.extend(guard.update())
        return bool(ended)

    wait_for(has_ended, 10.0, "the stopped reader")
    assert ended == [address(reader)]
    assert guard.update() == []
    with pytest.raises(OSError, match=r"timed out|Broken pipe"):
        writer.send(b"more")


def test_a_reader_that_takes_a_little_is_only_slow(ends: Ends) -> None:
    writer, reader = ends
    guard = LinkGuard()
    guard.update()
    end_s = time.monotonic() + 2.5
    while time.monotonic() < end_s:
        fill(writer)
        time.sleep(PERIOD_S)
        assert guard.update() == []
        reader.recv(200_000)
    fill(writer)


def test_a_reader_for_which_nothing_waits_may_be_silent(ends: Ends) -> None:
    writer, reader = ends
    guard = LinkGuard()
    writer.send(b"some bytes")  # the kernel of the reader has taken them
    for _ in range(15):
        assert guard.update() == []
        time.sleep(PERIOD_S)
    assert reader.recv(100) == b"some bytes"


def test_a_reader_that_ends_by_itself_is_not_named(ends: Ends) -> None:
    writer, reader = ends
    guard = LinkGuard()
    guard.update()
    writer.send(b"some bytes")
    reader.close()
    time.sleep(PERIOD_S)
    assert guard.update() == [] and guard.update() == []
