"""What a client's questions and subscriptions bring, from Zenoh's threads to the caller's."""

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

from jezero.client.errors import TimedOut
from jezero.client.session import ARRIVALS_MAX, ReplyArrivals


def reply(data: bytes, header: bytes | None = None) -> Any:
    attachment = None if header is None else SimpleNamespace(to_bytes=lambda: header)
    return SimpleNamespace(ok=SimpleNamespace(attachment=attachment, payload=SimpleNamespace(to_bytes=lambda: data)))


def refusal(text: bytes) -> Any:
    return SimpleNamespace(ok=None, err=SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: text)))


def test_replies_are_taken_in_order_and_then_the_end() -> None:
    arrivals = ReplyArrivals()
    arrivals.on_reply(reply(b"one"))
    arrivals.on_reply(reply(b"pixels", b"header"))
    arrivals.on_end()
    assert arrivals.ended
    assert [arrivals.take(None) for _ in range(4)] == [b"one", b"header\npixels", None, None]


def test_whoever_waits_is_woken_by_a_reply() -> None:
    arrivals = ReplyArrivals()
    threading.Timer(0.05, arrivals.on_reply, [reply(b"late")]).start()
    assert arrivals.take(time.monotonic() + 5.0) == b"late"


def test_an_error_is_kept_and_ends_nothing() -> None:
    arrivals = ReplyArrivals()
    arrivals.on_reply(refusal(b"Timeout"))
    with pytest.raises(TimedOut):
        arrivals.take(time.monotonic())
    assert arrivals.error == "Timeout"


def test_what_is_there_is_taken_even_after_the_deadline() -> None:
    arrivals = ReplyArrivals()
    arrivals.on_reply(reply(b"there"))
    assert arrivals.take(time.monotonic() - 1.0) == b"there"
    with pytest.raises(TimedOut):
        arrivals.take(time.monotonic() - 1.0)


def test_of_more_than_are_kept_the_oldest_are_dropped() -> None:
    arrivals = ReplyArrivals()
    for number in range(ARRIVALS_MAX + 3):
        arrivals.on_reply(reply(b"%d" % number))
    assert arrivals.take(None) == b"3"
