"""A viewer who does not read what is sent to him costs nobody anything."""

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("websockets", reason="the extra jezero[ground] is not installed")

from benchmarks.speed.page_viewer import PageViewer
from jezero.services.ground_station.web.backpressure import UNREAD_MAX
from tests.services.ground_station.serving import NO_ROUTER, serving
from tests.system.conftest import wait_for

PER_REFRESH = 30
"""More than the messages of one refresh."""


def test_a_viewer_who_does_not_read_is_sent_a_bounded_number_of_messages_and_others_get_all_of_theirs() -> None:
    with (
        serving(NO_ROUTER, "rate_hz=30") as address,
        PageViewer(address, reads=False) as stalled,
        PageViewer(address) as reader,
    ):
        wait_for(lambda: reader.messages > 2 * UNREAD_MAX, 60, "the reader gets messages")
        waiting = stalled.drain()
        assert UNREAD_MAX / 2 < waiting < UNREAD_MAX + PER_REFRESH
        before = reader.messages
        wait_for(lambda: reader.messages > before + 100, 60, "the reader gets messages after the other has read")
        assert not reader.closed
