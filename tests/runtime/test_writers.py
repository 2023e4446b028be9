"""A topic's messages are taken of its writer alone while that is there, on a router without keys."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh

from jezero.codec import encode
from jezero.runtime.config import Instance
from jezero.runtime.routing import open_router
from jezero.runtime.service import Spec
from jezero.runtime.writers import writers_of
from jezero.runtime.zenoh_session import BusSession
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.state import Clock
from jezero.zenoh_client import client_config
from tests.client.rig import free_endpoint

VEHICLE = "uav1"
LATEST_S = 3.0
TOPIC = topics.RELATIVE
"""The estimator writes it."""
Event = tuple[str, str, Any]


@pytest.fixture
def router() -> Iterator[str]:
    endpoint = free_endpoint()
    with open_router(endpoint, VEHICLE):
        yield endpoint


class Bus:
    """Services and strangers at one router; `events` has what arrives at a service that reads `TOPIC`."""

    def __init__(self, router: str, ends: ExitStack) -> None:
        self.events: list[Event] = []
        self._router, self._ends = router, ends
        self.service(Spec(name="reader", inputs=(TOPIC,)), self._on_event)

    def _on_event(self, kind: str, name: str, value: Any) -> None:
        if name == TOPIC.name:
            self.events.append((kind, name, value))

    def service(self, spec: Spec, enqueue: Callable[[Any, str, Any], None] = lambda *_: None) -> BusSession:
        session = BusSession(Instance(vehicle=VEHICLE, router=self._router), spec, enqueue)
        session.open_in_background().join()
        self._ends.callback(session.close)
        session.claim_name(lambda: False)
        session.declare()
        time.sleep(0.3)
        return session

    def stranger(self) -> zenoh.Session:
        return self._ends.enter_context(zenoh.open(client_config(self._router, LATEST_S)))

    def arrives(self, publish: Callable[[], None]) -> tuple[str, Any]:
        """Kind and value of the event that a message causes."""
        self.events.clear()
        publish()
        deadline_s = time.monotonic() + LATEST_S
        while not self.events and time.monotonic() < deadline_s:
            time.sleep(0.01)
        assert len(self.events) == 1
        kind, _, value = self.events[0]
        return kind, value


@pytest.fixture
def bus(router: str) -> Iterator[Bus]:
    with ExitStack() as ends:
        yield Bus(router, ends)


def put(session: zenoh.Session, data: bytes = b"{}") -> Callable[[], None]:
    return lambda: session.put(topics.key(VEHICLE, TOPIC.name), data)


def test_the_writer_is_taken_and_anybody_else_is_refused_by_name(bus: Bus) -> None:
    estimator = bus.service(Spec(name="estimator", outputs=(TOPIC,)))
    tuner = bus.service(Spec(name="tuner", outputs=(TOPIC,)))
    stranger = bus.stranger()
    assert bus.arrives(lambda: estimator.put(TOPIC, b"{}")) == ("sample", b"{}")
    kind, reason = bus.arrives(put(stranger))
    assert kind == "refused" and reason == "a program publishes it, and is not its writer, estimator"
    kind, reason = bus.arrives(lambda: tuner.put(TOPIC, b"{}"))
    assert kind == "refused" and reason.startswith("session ") and reason.endswith("is not its writer, estimator")
    assert bus.arrives(lambda: estimator.put(TOPIC, b"{}")) == ("sample", b"{}")


def test_without_the_writer_somebody_else_takes_its_place_and_loses_it_when_it_comes(bus: Bus) -> None:
    stranger = bus.stranger()
    assert bus.arrives(put(stranger)) == ("sample", b"{}")
    estimator = bus.service(Spec(name="estimator", outputs=(TOPIC,)))
    assert bus.arrives(put(stranger))[0] == "refused"
    estimator.close()
    deadline_s = time.monotonic() + LATEST_S
    while bus.arrives(put(stranger))[0] == "refused" and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert bus.arrives(put(stranger)) == ("sample", b"{}")


def test_a_reader_that_starts_later_knows_the_writer(bus: Bus) -> None:
    estimator = bus.service(Spec(name="estimator", outputs=(TOPIC,)))
    events: list[Event] = []
    bus.service(Spec(name="late", inputs=(TOPIC,)), lambda *event: events.append(event))
    put(bus.stranger())()
    estimator.put(TOPIC, b"[]")
    deadline_s = time.monotonic() + LATEST_S
    while len([event for event in events if event[1] == TOPIC.name]) < 2 and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert sorted(event[0] for event in events if event[1] == TOPIC.name) == ["refused", "sample"]


def test_a_false_clock_does_not_even_reach_the_time_of_a_service(bus: Bus) -> None:
    events: list[Event] = []
    bus.service(Spec(name="simulator", outputs=(topics.CLOCK,)))
    bus.service(Spec(name="late", inputs=(TOPIC,)), lambda *event: events.append(event))
    clock = encode(Clock(t_ns=1, epoch_id=7, wall_ns=1))
    bus.stranger().put(topics.key(VEHICLE, topics.CLOCK.name), clock, congestion_control=zenoh.CongestionControl.BLOCK)
    deadline_s = time.monotonic() + LATEST_S
    while not any(event[1] == topics.CLOCK.name for event in events) and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert [event[0] for event in events if event[1] == topics.CLOCK.name] == ["refused"]


@pytest.mark.parametrize(
    ("topic", "writers"),
    [
        (topics.STATUS, {"vehicle_bridge"}),
        (topics.ROVER_ODOMETRY, {"simulator", "rover"}),
        (topics.ROVER_COMMAND, set()),
        (topics.SETPOINT, set()),
    ],
)
def test_the_writers_are_those_of_the_topic_table(topic: Topic[Any], writers: set[str]) -> None:
    assert writers_of(topic) == writers
