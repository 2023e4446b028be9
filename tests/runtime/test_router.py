"""The router drops messages that are larger than any of the contract."""

import time
from collections.abc import Iterator

import pytest
import zenoh

from jezero.runtime.routing import SIZE_MAX_BYTES, open_router
from jezero.schemas.topics import CAMERA, HOVER, STATUS, TAKEOFF, feedback_of, key
from jezero.zenoh_client import client_config
from tests.client.rig import free_endpoint

VEHICLE = "uav1"
LATEST_S = 2.0
BLOCK = zenoh.CongestionControl.BLOCK


@pytest.fixture
def sessions() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Two clients of a router."""
    endpoint = free_endpoint()
    with (
        open_router(endpoint, VEHICLE),
        zenoh.open(client_config(endpoint, LATEST_S)) as one,
        zenoh.open(client_config(endpoint, LATEST_S)) as other,
    ):
        yield one, other


@pytest.mark.parametrize(
    ("topic", "passes"), [(STATUS.name, False), (feedback_of(TAKEOFF).name, False), (CAMERA.name, True)]
)
def test_a_message_larger_than_any_of_the_contract_is_dropped(
    sessions: tuple[zenoh.Session, zenoh.Session], topic: str, passes: bool
) -> None:
    reader, writer = sessions
    sizes: list[int] = []
    subscriber = reader.declare_subscriber(key(VEHICLE, topic), lambda sample: sizes.append(len(sample.payload)))
    time.sleep(0.2)
    for size in (SIZE_MAX_BYTES + 2_000_000, SIZE_MAX_BYTES - 1000):
        writer.put(key(VEHICLE, topic), bytes(size), congestion_control=BLOCK)
    deadline_s = time.monotonic() + LATEST_S
    while SIZE_MAX_BYTES - 1000 not in sizes and time.monotonic() < deadline_s:
        time.sleep(0.02)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert (SIZE_MAX_BYTES - 1000 in sizes, SIZE_MAX_BYTES + 2_000_000 in sizes) == (True, passes)


@pytest.mark.parametrize("endpoint", [HOVER.name, TAKEOFF.endpoint.name])
def test_a_request_larger_than_any_of_the_contract_is_dropped(
    sessions: tuple[zenoh.Session, zenoh.Session], endpoint: str
) -> None:
    server, client = sessions

    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, "y")

    queryable = server.declare_queryable(key(VEHICLE, endpoint), reply, complete=True)
    time.sleep(0.2)
    answered = [
        any(reply.ok for reply in client.get(key(VEHICLE, endpoint), payload=bytes(size), timeout=LATEST_S))
        for size in (1000, SIZE_MAX_BYTES + 2_000_000)
    ]
    queryable.undeclare()  # type: ignore[no-untyped-call]
    assert answered == [True, False]
