"""Callbacks in Zenoh's own threads, over a router on loopback."""

import threading
from collections.abc import Iterator
from queue import SimpleQueue

import pytest
import zenoh

from jezero.client.session import client_config
from jezero.runtime.zenoh_threads import where_received
from tests.client.rig import free_endpoint, open_router, wait_for


@pytest.fixture
def sessions() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    endpoint = free_endpoint()
    config = client_config(endpoint)
    with open_router(endpoint), zenoh.open(config) as one, zenoh.open(config) as other:
        yield one, other


def test_a_thread_that_calls_back_stays_known_to_python(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    receiver, sender = sessions
    own = threading.local()
    calls: SimpleQueue[tuple[int, bool]] = SimpleQueue()

    def note(sample: zenoh.Sample) -> None:
        remembered = hasattr(own, "been_here")  # Python forgets it together with the thread
        own.been_here = True
        calls.put((threading.get_ident(), remembered))

    receiver.declare_subscriber("what", where_received(note))
    publisher = sender.declare_publisher("what")
    wait_for(lambda: publisher.matching_status.matching)
    threads, remembered = [], []
    for _ in range(20):
        publisher.put(b"x")
        thread, known = calls.get(timeout=5.0)
        threads.append(thread)
        remembered.append(known)
    assert threading.get_ident() not in threads
    assert remembered.count(False) == len(set(threads))


def test_the_end_of_the_replies_is_told(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    replies, ends = list[zenoh.Reply](), list[bool]()
    sessions[0].get("nobody/serves/this", where_received(replies.append, lambda: ends.append(True)), timeout=1.0)
    wait_for(lambda: ends)
    assert ends == [True]
