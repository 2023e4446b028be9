"""Calls of a service that get every reply, on both buses."""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import pytest

from jezero.recording.writer import RecordingWriter
from jezero.replay.through import replay_through
from jezero.runtime.instance import Instance
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.service import Call, Inbox, Output, Publish, Reply, Response, Service, Spec
from jezero.runtime.zenoh_bus import ServiceLoop
from jezero.schemas import topics
from jezero.schemas.actions import Accepted
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.state import Clock
from jezero.schemas.struct import Payload
from tests.client.rig import ACCEPTED, a_feedback, a_result, close, free_endpoint, open_router, wait_for

REPLIES = (ACCEPTED, a_feedback(2.0), a_feedback(1.0), a_result())


class Takeoff:
    """Replies to each goal with one of the replies a step.

    Args:
        replies: all replies.
        ends: whether the last one ends the query.
    """

    def __init__(self, replies: tuple[Payload, ...], *, ends: bool) -> None:
        endpoint = topics.TAKEOFF.endpoint
        self.spec = Spec(name="takeoff", serves=(endpoint,), triggers=(endpoint.name,), rate_hz=50)
        self._replies = replies
        self._ends = ends
        self._waiting: dict[int, int] = {}
        """Number of replies that were sent, by request."""

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self._waiting |= {request.request_id: 0 for request in inbox.requests(topics.TAKEOFF.endpoint)}
        for request_id, sent in self._waiting.items():
            if sent < len(self._replies):
                last = sent + 1 == len(self._replies)
                self._waiting[request_id] += 1
                yield Reply(request_id, self._replies[sent], final=last and self._ends)


class Asker:
    """Sends a goal, and publishes the number of responses so far; the goal is sent again until a server is there.

    Attributes:
        responses: all but those of calls without a server.
    """

    def __init__(self, streamed: bool = True, timeout_s: float = 20.0) -> None:
        made_with = {"streamed": streamed, "timeout_s": timeout_s}
        calls = (topics.TAKEOFF.endpoint,)
        name = "asker" if streamed else "asker_of_one"
        self.spec = Spec(name=name, outputs=(topics.CLOCK,), calls=calls, rate_hz=10, made_with=made_with)
        self.responses: list[Response] = []
        self._streamed, self._timeout_s = streamed, timeout_s
        self._waits = False

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for response in inbox.responses:
            if response.error == "no server" and not self.responses:
                self._waits = False
            else:
                self.responses.append(response)
        if not self._waits:
            self._waits = True
            goal = TakeoffGoal(goal_id="g")
            yield Call(topics.TAKEOFF.endpoint, goal, "goal", self._timeout_s, streamed=self._streamed)
        yield Publish(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=len(self.responses), wall_ns=0))

    @property
    def outcomes(self) -> list[Any]:
        """Each reply, or the error that ended the call."""
        assert all(response.tag == "goal" for response in self.responses)
        return [response.error if response.payload is None else response.payload for response in self.responses]


class Bus(Protocol):
    """A bus of either kind."""

    def add(self, service: Service) -> None: ...
    def remove(self, name: str) -> None: ...
    def wait(self, condition: Callable[[], bool]) -> None: ...


class InMemory(MemoryBus):
    """The bus in virtual time."""

    def wait(self, condition: Callable[[], bool]) -> None:
        assert self.run_for(30.0, condition)


class OverZenoh:
    """The real bus: a router, and each service in a thread."""

    def __init__(self, endpoint: str) -> None:
        self._instance = Instance(vehicle="v", router=endpoint)
        self._running: dict[str, tuple[ServiceLoop, threading.Thread]] = {}

    def add(self, service: Service) -> None:
        loop = ServiceLoop(service, self._instance, 1, {})
        thread = threading.Thread(target=loop.run)
        thread.start()
        wait_for(lambda: loop._session.is_open, 10.0)
        self._running[service.spec.name] = (loop, thread)

    def remove(self, name: str) -> None:
        loop, thread = self._running.pop(name)
        loop.stop()
        thread.join()
        loop.close()

    def wait(self, condition: Callable[[], bool]) -> None:
        wait_for(condition, 30.0)

    def close(self) -> None:
        for name in list(self._running):
            self.remove(name)


@pytest.fixture(params=["memory", "zenoh"])
def bus(request: pytest.FixtureRequest) -> Iterator[Bus]:
    with ExitStack() as stack:
        if request.param == "memory":
            yield InMemory()
            return
        endpoint = free_endpoint()
        stack.callback(close, open_router(endpoint))
        zenoh_bus = OverZenoh(endpoint)
        stack.callback(zenoh_bus.close)
        yield zenoh_bus


def test_a_streamed_call_gets_every_reply_in_order_and_its_end(bus: Bus) -> None:
    asker = Asker()
    bus.add(Takeoff(REPLIES, ends=True))
    bus.add(asker)
    bus.wait(lambda: len(asker.responses) > len(REPLIES))
    assert asker.outcomes == [*REPLIES, "no server"]


def test_a_call_that_is_not_streamed_gets_the_first_reply_alone(bus: Bus) -> None:
    asker, streamed = Asker(streamed=False), Asker()
    for service in (Takeoff(REPLIES, ends=True), asker, streamed):
        bus.add(service)
    bus.wait(lambda: bool(asker.responses) and len(streamed.responses) > len(REPLIES))
    assert asker.outcomes == [ACCEPTED]


def test_a_stream_ends_with_its_server(bus: Bus) -> None:
    asker = Asker()
    bus.add(Takeoff(REPLIES[:2], ends=False))
    bus.add(asker)
    bus.wait(lambda: len(asker.responses) == 2)
    bus.remove("takeoff")
    bus.wait(lambda: len(asker.responses) == 3)
    assert asker.outcomes == [*REPLIES[:2], "no server"]


def test_a_stream_ends_after_its_time_out(bus: Bus) -> None:
    asker = Asker(timeout_s=2.0)
    bus.add(Takeoff(REPLIES[:2], ends=False))
    bus.add(asker)
    bus.wait(lambda: len(asker.responses) == 3)
    assert asker.outcomes == [*REPLIES[:2], "timeout"]


def test_a_wrong_reply_ends_a_stream_with_the_reason(bus: Bus) -> None:
    asker = Asker()
    bus.add(Takeoff((ACCEPTED, a_feedback(-1.0), a_result()), ends=True))
    bus.add(asker)
    bus.wait(lambda: len(asker.responses) == 2)
    accepted, wrong = asker.outcomes
    assert isinstance(accepted, Accepted)
    assert "takeoff sent a wrong reply on @action/takeoff" in str(wrong)


def test_a_service_with_a_stream_is_replayed_identically(tmp_path: Path) -> None:
    path, bus, asker = tmp_path / "flight.mcap", InMemory(), Asker()
    with RecordingWriter(path, {}) as writer:
        bus.read_journals(writer.write)
        bus.add(Takeoff(REPLIES, ends=True))
        bus.add(asker)
        bus.run_for(3.0)
        bus.end_journals()
    assert len(asker.responses) == len(REPLIES) + 1
    made: list[Asker] = []
    replay = replay_through(path, "asker", own=Asker, on_service=made.append)  # type: ignore[arg-type]
    assert replay.identical and replay.outputs > len(REPLIES)
    assert made[0].outcomes == asker.outcomes
