"""A viewer who does not read what is sent to him costs nobody anything."""

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("websockets", reason="the extra jezero[ground] is not installed")

from benchmarks.speed.page_viewer import PageViewer
from jezero.services.ground_station.web.elements import UNREAD_MAX
from tests.services.ground_station.serving import NO_ROUTER, serving
from tests.system.conftest import wait_for

pytestmark = pytest.mark.process

TRICKLE_MAX = 200
"""More than the messages that are sent to a stalled viewer during the test."""


@pytest.mark.long
def test_a_viewer_who_does_not_read_is_sent_a_bounded_number_of_messages_and_others_get_all_of_theirs() -> None:
    with (
        serving(NO_ROUTER, "rate_hz=30") as address,
        PageViewer(address, reads=False) as stalled,
        PageViewer(address) as reader,
    ):
        wait_for(lambda: reader.messages > 3 * UNREAD_MAX, 60, "the reader gets messages")
        waiting = stalled.drain()
        assert UNREAD_MAX / 2 < waiting < UNREAD_MAX + TRICKLE_MAX
        before = reader.messages
        wait_for(lambda: reader.messages > before + 100, 60, "the reader gets messages after the other has read")
        assert not reader.closed


@pytest.mark.long
def test_a_viewer_whose_acknowledgements_were_lost_is_sent_all_again_after_the_next_one() -> None:
    with serving(NO_ROUTER, "rate_hz=30") as address, PageViewer(address) as viewer:
        viewer.acknowledges = False
        wait_for(lambda: viewer.messages > UNREAD_MAX, 60, "the viewer has read more than may be unread")
        viewer.acknowledges = True
        before = viewer.messages
        wait_for(lambda: viewer.messages > before + 2 * UNREAD_MAX, 60, "the viewer gets all messages again")
