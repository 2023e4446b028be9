"""The bus in virtual time: ordered, deterministic, and as strict as the real one."""

import hashlib
import json
import math
from collections.abc import Iterable
from functools import partial
from operator import add, mul, truediv
from typing import Any

import pytest

from jezero.base.codec import NotFiniteError, decode, encode
from jezero.runtime.memory_bus import BACKGROUND_TASK_S, BUS_DELAY, LinkDelay, MemoryBus
from jezero.runtime.node import FAILED_STEPS_MAX
from jezero.runtime.service import (
    BackgroundTask,
    Call,
    CancelTask,
    Health,
    Inbox,
    Output,
    Publish,
    Reply,
    Response,
    Send,
    SetRate,
    Spec,
    Subscribe,
    UndeclaredError,
)
from jezero.schemas import topics
from jezero.schemas.commands import Abort, AbortReply, Kill
from jezero.schemas.health import ServiceHealth, ServiceState
from jezero.schemas.sensors import Altimeter, Uwb, UwbRange
from jezero.schemas.state import Clock


class Talker:
    """Publishes the time as a clock at 10 Hz."""

    spec = Spec(name="talker", outputs=(topics.CLOCK,), rate_hz=10)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield Publish(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=1, wall_ns=t_ns))


class Moody:
    """Changes the state of its health at given times, at 20 Hz."""

    spec = Spec(name="moody", rate_hz=20)

    def __init__(self, states: dict[int, ServiceState]) -> None:
        self._states = states

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        if state := self._states.get(t_ns):
            yield Health(state, "")


class Listener:
    """Records clock messages with the times of their arrival, replies to aborts, and may send requests."""

    def __init__(self, ask: bool = False) -> None:
        self.spec = Spec(
            name="asker" if ask else "listener",
            inputs=(topics.CLOCK,),
            on_demand=(topics.ALTIMETER,),
            serves=() if ask else (topics.ABORT,),
            calls=(topics.ABORT, topics.KILL),
            links=("pipe",),
            triggers=(topics.CLOCK.name, topics.ABORT.name, "pipe"),
            rate_hz=1,
        )
        self.ask = ask
        self.heard: list[tuple[int, int]] = []
        self.responses: list[Response] = []
        self.bytes = b""

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self.heard += [(t_ns, clock.t_ns) for clock in inbox.new(topics.CLOCK)]
        self.responses += inbox.responses
        self.bytes += inbox.received("pipe")
        for request in inbox.requests(topics.ABORT):
            yield Reply(request.request_id, AbortReply(hovering=True, reason=request.payload.reason))
        if self.ask:
            self.ask = False
            yield Call(topics.ABORT, Abort(reason="please"), "abort")
            yield Call(topics.KILL, Kill(), "kill")
            yield Send("pipe", b"hello")


def test_messages_arrive_in_order_after_the_links_delay() -> None:
    bus, listener = MemoryBus(seed=3, delay=LinkDelay(0.5, sigma=1.0, longest_s=5.0)), Listener()
    bus.add(Talker())
    bus.add(listener)
    bus.run_for(20.0)
    sent = [t for _, t in listener.heard]
    assert sent == sorted(sent) and len(sent) > 100
    assert all(heard > t for heard, t in listener.heard)


def test_a_question_is_answered_and_one_without_a_server_says_so() -> None:
    bus, asker, listener = MemoryBus(), Listener(ask=True), Listener()
    bus.wire(("asker", "pipe"), ("listener", "pipe"))
    bus.add(asker)
    bus.add(listener)
    bus.run_for(2.0)
    assert {(r.tag, r.error) for r in asker.responses} == {("abort", None), ("kill", "no server")}
    assert listener.bytes == b"hello"


def test_an_outside_client_gets_every_reply() -> None:
    bus = MemoryBus()
    bus.add(Listener())
    answers = bus.send_request(topics.ABORT, Abort(reason="now"))
    assert bus.run_for(1.0, stop=lambda: answers.ended)
    assert answers.replies == [AbortReply(hovering=True, reason="now")]


def test_a_service_that_dies_takes_its_links_down_and_ends_its_questions() -> None:
    bus, asker = MemoryBus(), Listener(ask=True)
    bus.wire(("asker", "pipe"), ("listener", "pipe"))
    bus.add(asker)
    bus.add(Listener())
    bus.run_until(0)
    bus.remove("listener")
    bus.run_for(2.0)
    assert {r.error for r in asker.responses} == {"no server"} or "timeout" in {r.error for r in asker.responses}


def run_hash(seed: int) -> str:
    bus, digest = MemoryBus(seed=seed, delay=BUS_DELAY), hashlib.sha256()
    listener = Listener()
    bus.add(Talker())
    bus.add(listener)
    bus.observe(lambda t_ns, topic, data: digest.update(f"{t_ns}{topic}".encode() + data))
    bus.run_for(5.0)
    digest.update(str(listener.heard).encode())
    return digest.hexdigest()


def test_the_same_seed_gives_the_same_bytes_and_another_does_not() -> None:
    assert run_hash(1) == run_hash(1)
    assert run_hash(1) != run_hash(2)


class Wrong:
    """Yields one output that it must not."""

    def __init__(self, output: Output) -> None:
        self.spec = Spec(name="wrong", outputs=(topics.ALTIMETER,), links=())
        self.output = output

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield self.output


@pytest.mark.parametrize(
    "output",
    [
        Publish(topics.CLOCK, Clock(t_ns=0, epoch_id=0, wall_ns=0)),
        Call(topics.KILL, Kill(), "k"),
        Send("pipe", b""),
        Subscribe((topics.ALTIMETER,)),
    ],
)
def test_what_is_not_declared_raises(output: Output) -> None:
    bus = MemoryBus()
    bus.add(Wrong(output))
    with pytest.raises(UndeclaredError, match="wrong"):
        bus.run_for(0.1)


def test_a_message_of_another_type_raises() -> None:
    bus = MemoryBus()
    bus.add(Wrong(Publish(topics.ALTIMETER, Clock(t_ns=0, epoch_id=0, wall_ns=0))))
    with pytest.raises(TypeError, match="altimeter"):
        bus.run_for(0.1)


def test_what_is_not_finite_raises_in_tests_and_is_counted_in_flight() -> None:
    output = Publish(topics.ALTIMETER, Altimeter(t_ns=0, range_m=math.nan))
    strict = MemoryBus()
    strict.add(Wrong(output))
    with pytest.raises(NotFiniteError):
        strict.run_for(0.1)
    health: list[bytes] = []
    flying = MemoryBus(strict=False)
    flying.add(Wrong(output))
    flying.observe(lambda _t, topic, data: health.append(data) if topic == "health/wrong" else None)
    flying.run_for(1.5)
    assert b'"not_sent":1' in health[0]


class Ranging:
    """Publishes one UWB round whose second range has a given value."""

    spec = Spec(name="ranging", outputs=(topics.UWB,), rate_hz=1.0)

    def __init__(self, range_m: float) -> None:
        ranges_m = (2.0, range_m, 3.0)
        self._ranges = tuple(
            UwbRange(t_ns=0, anchor=anchor, pos_anchor_rover_body_m=(0.0, 0.0, 0.0), range_m=each_m)
            for anchor, each_m in enumerate(ranges_m)
        )

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield Publish(topics.UWB, Uwb(t_ns=t_ns, ranges=self._ranges))


class RangeReader:
    """Keeps the anchors of the newest UWB round."""

    spec = Spec(name="reader", inputs=(topics.UWB,), rate_hz=10.0)

    def __init__(self) -> None:
        self.anchors: list[int] = []

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for message in inbox.new(topics.UWB):
            self.anchors = [each.anchor for each in message.ranges]
        return ()


@pytest.mark.parametrize(("range_m", "sender"), [(-0.05, False), (math.nan, True), (math.inf, True)])
def test_a_message_with_one_bad_reading_keeps_its_good_ones_and_counts_the_bad_one(
    range_m: float, sender: bool
) -> None:
    bus, read = MemoryBus(strict=False), RangeReader()
    healths: dict[str, list[ServiceHealth]] = {"ranging": [], "reader": []}
    bus.observe(
        lambda _t, topic, data: (
            healths[topic.removeprefix("health/")].append(decode(ServiceHealth, data))
            if topic.startswith("health/")
            else None
        )
    )
    bus.add(Ranging(range_m))
    bus.add(read)
    bus.run_for(2.5)
    assert read.anchors == [0, 2]
    own, other = healths["ranging"][-1], healths["reader"][-1]
    assert (own.not_sent > 0) == sender
    assert "ranges[1]" in (own if sender else other).last_error
    assert (other.inputs[topics.UWB.name].dropped > 0) == (not sender)
    assert other.inputs[topics.UWB.name].rejected == 0


def test_what_is_under_way_can_be_tampered_with() -> None:
    bus, listener = MemoryBus(), Listener()
    seen: list[tuple[str, str, str]] = []

    def double_late(sender: str, receiver: str, name: str, t_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        seen.append((sender, receiver, name))
        return [(t_ns, data), (t_ns + 250_000_000, data)]

    bus.add(Talker())
    bus.add(listener)
    bus.tamper = double_late
    bus.run_for(0.05)
    bus.tamper = None
    bus.run_for(0.4)
    assert seen == [("talker", "listener", "clock")]
    assert [sent for _, sent in listener.heard].count(0) == 2
    assert max(at - sent for at, sent in listener.heard) > 250_000_000


def test_a_frozen_service_finds_everything_when_it_goes_on() -> None:
    bus, listener = MemoryBus(), Listener()
    bus.add(Talker())
    bus.add(listener)
    bus.run_for(1.0)
    bus.freeze("listener", 1.0)
    heard = len(listener.heard)
    bus.run_for(0.95)
    assert not bus.runs("listener") and len(listener.heard) == heard
    bus.run_for(0.1)
    assert bus.runs("listener") and len(listener.heard) >= heard + 9


class Planner:
    """Steps at 10 Hz, starts two background tasks at once, and steps at 100 Hz when the second is done."""

    spec = Spec(name="planner", rate_hz=10)

    def __init__(self) -> None:
        self.steps: list[int] = []
        self.outcomes: list[tuple[int, str, Any]] = []

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        if not self.steps:
            yield BackgroundTask(partial(mul, 6, 7), "first")
            yield BackgroundTask(partial(add, 6, 7), "second")
        self.steps.append(t_ns)
        self.outcomes += [(t_ns, response.tag, response.payload) for response in inbox.responses]
        if inbox.responses and len(self.outcomes) == 2:
            yield SetRate(100.0)


def test_work_goes_on_beside_the_steps_and_takes_its_time_one_after_the_other() -> None:
    bus, planner = MemoryBus(), Planner()
    bus.add(planner)
    bus.run_for(2.5 * BACKGROUND_TASK_S)
    assert planner.outcomes == [
        (int(BACKGROUND_TASK_S * 1e9), "first", 42),
        (int(2 * BACKGROUND_TASK_S * 1e9), "second", 13),
    ]
    assert len(planner.steps) > 4


class Failing:
    """Starts background tasks that give no value, and cancels the last of them in its second step."""

    spec = Spec(name="failing", rate_hz=10)

    def __init__(self) -> None:
        self.steps = 0
        self.errors: dict[str, str | None] = {}

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self.steps += 1
        if self.steps == 1:
            yield BackgroundTask(partial(truediv, 1, 0), "raises")
            yield BackgroundTask(lambda: 1, "lambda")
            yield BackgroundTask(partial(mul, 6, 7), "canceled")
        if self.steps == 2:
            yield CancelTask("canceled")
        self.errors |= {response.tag: response.error for response in inbox.responses}


def test_a_task_that_gives_no_value_responds_with_the_reason() -> None:
    bus, service = MemoryBus(), Failing()
    bus.add(service)
    bus.run_for(4.0 * BACKGROUND_TASK_S)
    assert list(service.errors) == ["canceled", "raises", "lambda"]
    assert service.errors["canceled"] == "canceled"
    assert str(service.errors["raises"]).startswith("ZeroDivisionError: division by zero")
    assert "can't be sent to a process of its own" in str(service.errors["lambda"])


def test_a_service_that_asks_for_it_steps_more_often() -> None:
    bus, planner = MemoryBus(), Planner()
    bus.add(planner)
    bus.run_for(2.0 * BACKGROUND_TASK_S)
    slow = len(planner.steps)
    bus.run_for(1.0)
    assert slow < 8 and len(planner.steps) - slow == 100


def test_health_is_published_once_a_second_and_at_once_when_its_state_changes() -> None:
    reported: list[tuple[float, str]] = []
    bus = MemoryBus()
    bus.add(Moody({1_250_000_000: "degraded", 1_400_000_000: "ok"}))
    bus.observe(lambda t_ns, topic, data: reported.append((t_ns / 1e9, json.loads(data)["state"])))
    bus.run_for(2.5)
    assert reported == [(0.0, "ok"), (1.0, "ok"), (1.25, "degraded"), (1.4, "ok"), (2.4, "ok")]


def test_a_state_that_changes_in_each_step_is_reported_ten_times_a_second_at_most() -> None:
    states: list[ServiceState] = ["ok", "degraded"]
    reports: list[int] = []
    bus = MemoryBus()
    bus.add(Moody({number * 50_000_000: states[number % 2] for number in range(1, 20)}))
    bus.observe(lambda t_ns, _topic, _data: reports.append(t_ns))
    bus.run_for(0.95)
    assert 5 <= len(reports) <= 10


class Divider:
    """Divides by the time of each clock message, and publishes the quotient."""

    spec = Spec(name="divider", inputs=(topics.CLOCK,), outputs=(topics.ALTIMETER,), triggers=(topics.CLOCK.name,))

    def __init__(self) -> None:
        self.divisors: list[int] = []

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for clock in inbox.new(topics.CLOCK):
            self.divisors.append(clock.wall_ns)
            yield Publish(topics.ALTIMETER, Altimeter(t_ns=t_ns, range_m=1.0 / clock.wall_ns))


def send_clock(bus: MemoryBus, wall_ns: int) -> None:
    bus.publish("master", topics.CLOCK, encode(Clock(t_ns=bus.t_ns, epoch_id=1, wall_ns=wall_ns)))
    bus.run_for(0.02)


def test_a_message_that_a_service_fails_on_fails_one_step_and_is_named_in_health(
    capfd: pytest.CaptureFixture[str],
) -> None:
    bus, divider = MemoryBus(strict=False), Divider()
    published: list[float] = []
    health: list[ServiceHealth] = []

    def observe(t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.ALTIMETER.name:
            published.append(json.loads(data)["range_m"])
        elif topic == "health/divider":
            health.append(decode(ServiceHealth, data))

    bus.observe(observe)
    bus.add(divider)
    for wall_ns in (1, 0, 0, 2):
        send_clock(bus, wall_ns)
    bus.run_for(1.2)
    assert divider.divisors == [1, 0, 0, 2]
    assert published == [1.0, 0.5]
    assert (health[-1].failed_steps, health[-1].state) == (2, "degraded")
    assert health[-1].last_error == "step failed: ZeroDivisionError: float division by zero"
    assert "2 steps failed" in health[-1].text
    assert capfd.readouterr().err.count("Traceback") == 1
    bus.run_for(1.2)
    assert health[-1].state == "ok"


def test_a_service_whose_steps_all_fail_ends_after_many_of_them() -> None:
    bus = MemoryBus(strict=False)
    bus.add(Divider())
    for _ in range(FAILED_STEPS_MAX):
        send_clock(bus, 0)
    with pytest.raises(ZeroDivisionError):
        send_clock(bus, 0)


def test_a_failed_step_raises_in_tests() -> None:
    bus = MemoryBus()
    bus.add(Divider())
    with pytest.raises(ZeroDivisionError):
        send_clock(bus, 0)
