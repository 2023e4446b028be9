"""Which readers count as stopped, and how their links end."""

import socket
import time
from collections.abc import Iterator

import pytest

from jezero.runtime.link_guard import LinkGuard, LinkSample, StoppedReaderDetector, sample_connection
from tests.system.conftest import wait_for

PERIOD_S = 0.25
READER, OTHER = "192.0.2.7:50000", "192.0.2.8:50000"


def stuck(acknowledged_bytes: int = 1000) -> LinkSample:
    return LinkSample(unsent_bytes=65536, acknowledged_bytes=acknowledged_bytes)


def idle() -> LinkSample:
    return LinkSample(unsent_bytes=0, acknowledged_bytes=1000)


def test_a_reader_that_takes_nothing_for_a_second_is_stopped_and_returned_once() -> None:
    detector = StoppedReaderDetector()
    stopped = [detector.update(PERIOD_S * number, {READER: stuck(), OTHER: idle()}) for number in range(9)]
    assert stopped == [[], [], [], [], [READER], [], [], [], []]


def test_a_reader_that_takes_a_little_within_each_second_is_only_slow() -> None:
    detector = StoppedReaderDetector()
    for number in range(40):
        assert detector.update(PERIOD_S * number, {READER: stuck(acknowledged_bytes=number // 3)}) == []


def test_a_reader_for_which_nothing_waits_may_be_silent_for_ever() -> None:
    detector = StoppedReaderDetector()
    for number in range(40):
        assert detector.update(PERIOD_S * number, {READER: idle()}) == []


def test_a_stuck_link_that_zenoh_ends_first_is_named_too() -> None:
    detector = StoppedReaderDetector()
    detector.update(0.0, {READER: stuck(), OTHER: idle()})
    detector.update(0.25, {READER: stuck(), OTHER: idle()})
    assert detector.update(0.5, {}) == [READER]


def test_time_in_which_the_router_itself_did_not_run_counts_for_no_reader() -> None:
    detector = StoppedReaderDetector()
    detector.update(0.0, {READER: stuck()})
    assert detector.update(3600.0, {READER: stuck()}) == []
    assert detector.update(3600.25, {READER: stuck(acknowledged_bytes=2000)}) == []


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Both ends of a TCP connection of this process: the writing one, and the reading one."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        reader = socket.create_connection(listener.getsockname())
        writer, _ = listener.accept()
    with reader, writer:
        yield writer, reader


def test_the_connection_of_a_stopped_reader_is_closed_and_others_are_left_alone(
    ends: tuple[socket.socket, socket.socket],
) -> None:
    writer, reader = ends
    host, port = reader.getsockname()
    guard = LinkGuard()
    writer.setblocking(False)
    assert guard.update(0.0) == []
    with pytest.raises(BlockingIOError):
        while True:
            writer.send(bytes(65536))
    wait_for(lambda: sample_connection(writer).unsent_bytes > 0, 5.0, "bytes that wait")
    stopped: list[str] = []

    def has_stopped() -> bool:
        stopped.extend(guard.update(time.monotonic()))
        return bool(stopped)

    wait_for(has_stopped, 10.0, "the stopped reader")
    assert stopped == [f"{host}:{port}"]
    with pytest.raises(BrokenPipeError):
        writer.send(b"more")
