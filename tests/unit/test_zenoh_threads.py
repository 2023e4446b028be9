"""Callbacks in Zenoh's own threads, over a router on loopback."""

import threading
import time
from collections.abc import Iterator

import pytest
import zenoh

from jezero.client.session import client_config
from jezero.runtime.zenoh_threads import where_received

from .client_rig import free_endpoint, open_router


@pytest.fixture
def sessions() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    endpoint = free_endpoint()
    config = client_config(endpoint)
    with open_router(endpoint), zenoh.open(config) as one, zenoh.open(config) as other:
        yield one, other


def wait_until(true: object) -> None:
    deadline_s = time.monotonic() + 5.0
    while not true() and time.monotonic() < deadline_s:  # type: ignore[operator]
        time.sleep(0.01)


def test_a_thread_that_calls_back_stays_known_to_python(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    receiver, sender = sessions
    own, calls, remembered = threading.local(), list[int](), list[bool]()

    def note(sample: zenoh.Sample) -> None:
        remembered.append(hasattr(own, "been_here"))  # Python forgets it together with the thread
        own.been_here = True
        calls.append(threading.get_ident())

    receiver.declare_subscriber("what", where_received(note))
    time.sleep(0.2)
    for number in range(20):
        sender.put("what", b"x")
        wait_until(lambda number=number: len(calls) > number)
    assert len(calls) == 20
    assert threading.get_ident() not in calls
    assert remembered.count(False) == len(set(calls))


def test_the_end_of_the_replies_is_told(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    replies, ends = list[zenoh.Reply](), list[bool]()
    sessions[0].get("nobody/serves/this", where_received(replies.append, lambda: ends.append(True)), timeout=1.0)
    wait_until(lambda: ends)
    assert ends == [True]
