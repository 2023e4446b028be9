"""The loop of one process, without a bus: its clock is the test's, and messages are put into its queue."""

import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from jezero.runtime import zenoh_bus
from jezero.runtime.codec import encode
from jezero.runtime.config import Instance
from jezero.runtime.service import Call, Inbox, Output, Publish, Reply, Response, SetRate, Spec, Subscribe
from jezero.runtime.zenoh_transport import HELD_NS
from jezero.schemas import topics
from jezero.schemas.commands import AbortReply, Release, ReleaseReply
from jezero.schemas.state import Clock, Status

MS = 1_000_000


class Idle:
    """Does nothing."""

    spec = Spec(name="idle", inputs=(topics.CLOCK,))

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        return ()


class Host:
    """One process and the monotonic clock of its host."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall_ns = 0
        self.stalls_ms: list[float] = []
        """How long the process stands still in each of its next sleeps."""
        clock = SimpleNamespace(monotonic_ns=lambda: self.wall_ns, sleep=self._sleep)
        monkeypatch.setattr(zenoh_bus, "time", clock)
        self.runner = zenoh_bus._Runner(Idle(), Instance(), 1, {})

    def _sleep(self, seconds: float) -> None:
        self.wall_ns += round(seconds * 1000 * MS + (self.stalls_ms.pop(0) if self.stalls_ms else 0) * MS)

    def told(self, sent_ms: int) -> None:
        """A message whose master has the same clock and vehicle time."""
        clock = Clock(t_ns=sent_ms * MS, epoch_id=1, wall_ns=sent_ms * MS)
        self.runner._enqueue("sample", topics.CLOCK.name, encode(clock))

    @property
    def t_ms(self) -> float:
        return self.runner._clock.now_ns(self.wall_ns) / MS


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[Host]:
    host = Host(monkeypatch)
    yield host
    host.runner.close()


def test_a_message_that_came_while_the_others_were_read_does_not_make_its_master_seem_ahead(host: Host) -> None:
    host.told(sent_ms=1150)
    host.wall_ns = 1160 * MS
    host.runner._collect(1000 * MS)  # the process stood still between looking at its clock and reading
    assert host.t_ms == pytest.approx(1150)
    for sent_ms in range(1250, 2051, 100):
        host.told(sent_ms)
        host.wall_ns = (sent_ms + 1) * MS
        host.runner._collect(host.wall_ns)
    assert host.t_ms == pytest.approx(2050, abs=0.1)


@pytest.mark.parametrize("where", ["waiting", "catching up", "reading"])
def test_no_step_counts_the_time_in_which_the_process_stood_still(
    host: Host, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    stepped_ms: list[float] = []
    runner, collect = host.runner, host.runner._collect
    runner._next_health_ns = runner._next_router_check_ns = 10**12

    def wait(until_ns: int) -> None:
        host.wall_ns += max(0, until_ns - runner._now_ns())
        if len(stepped_ms) == 3 and where != "reading":
            host.wall_ns += 700 * MS
            host.stalls_ms = [800, 150] if where == "catching up" else []

    def read(now_ns: int) -> bool:
        wanted = collect(now_ns)
        if len(stepped_ms) == 3 and where == "reading":
            host.wall_ns += 700 * MS
        return wanted

    def step(t_ns: int) -> None:
        stepped_ms.append(t_ns / MS)
        runner._stopping = len(stepped_ms) == 8

    monkeypatch.setattr(runner, "_wait", wait)
    monkeypatch.setattr(runner, "_collect", read)
    monkeypatch.setattr(runner._node, "step", step)
    host.told(sent_ms=0)
    runner._loop()
    assert all(90 < after - before < 200 for before, after in pairwise(stepped_ms))
    assert runner._late_ns >= 600 * MS


class Asked:
    """Changes its status at each step, and answers whoever asks; `fails` when it is told to."""

    spec = Spec(
        name="asked",
        on_demand=(topics.ODOMETRY,),
        outputs=(topics.STATUS,),
        last_value=(topics.STATUS,),
        serves=(topics.ABORT,),
        calls=(topics.RELEASE,),
        triggers=(topics.ABORT.name,),
    )

    def __init__(self) -> None:
        self.threads: list[threading.Thread] = []
        self.responses: list[Response] = []
        self.answers = True
        self.fails = False
        self.also: tuple[Output, ...] = ()

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self.threads.append(threading.current_thread())
        self.responses += inbox.responses
        if self.fails:
            raise RuntimeError("broken")
        if self.answers:
            for request in inbox.requests(topics.ABORT):
                yield Reply(request.request_id, AbortReply(hovering=False, reason=""))
        yield from self.also
        status = Status(
            t_ns=0,
            code=0,
            name="IDLE",
            armed=False,
            landed=True,
            in_charge="none",
            bridge_boot_id=1,
            ready=True,
            text=str(len(self.threads)),
        )
        yield Publish(topics.STATUS, status)


class Query:
    """Of a client."""

    key_expr = topics.key("uav1", topics.ABORT.name)
    payload = attachment = None
    parameters: tuple[tuple[str, str], ...] = ()

    def __init__(self) -> None:
        self.replies: list[bytes] = []

    def reply(self, key_expr: str, data: bytes, **_settings: Any) -> None:
        self.replies.append(data)

    def drop(self) -> None: ...


class Asking:
    """A process that is asked from another thread, as Zenoh does; its loop means to wake up at 20 ms."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall_ns = 10 * MS
        monkeypatch.setattr(zenoh_bus, "time", SimpleNamespace(monotonic_ns=lambda: self.wall_ns))
        self.service = Asked()
        self.runner = zenoh_bus._Runner(self.service, Instance(), 1, {})
        self.put: list[int] = []
        monkeypatch.setattr(self.runner._session, "put", lambda topic, data: self.put.append(self.wall_ns // MS))
        self.asked: list[str] = []
        monkeypatch.setattr(
            self.runner._session, "call", lambda _endpoint, _data, call_id, _s: self.asked.append(call_id)
        )
        self.runner._steps_where_received = True
        self.runner._until_ns = 20 * MS
        self.runner._next_health_ns = self.runner._next_router_check_ns = 10**12

    def receive(self, *what: Any) -> None:
        """As the session does with what triggers a step."""
        thread = threading.Thread(target=lambda: self.runner._step_here(*what) or self.runner._enqueue(*what))
        thread.start()
        thread.join()

    def ask(self) -> Query:
        query = Query()
        self.receive("query", topics.ABORT.name, query)
        return query


@pytest.fixture
def asking(monkeypatch: pytest.MonkeyPatch) -> Iterator[Asking]:
    asking = Asking(monkeypatch)
    yield asking
    asking.runner.close()


def test_the_thread_that_received_steps(asking: Asking) -> None:
    asking.service.answers = False  # else the status waits for the reply, and the loop for the status
    asking.ask()
    (thread,) = asking.service.threads
    assert thread is not threading.current_thread()
    assert asking.put == [10]
    assert not asking.runner._rung


def test_an_answer_is_stepped_by_the_thread_that_received_it(asking: Asking) -> None:
    asking.service.also = (Call(topics.RELEASE, Release(control_id="c", outcome="aborted"), "a tag"),)
    asking.ask()
    asking.service.also = ()
    asking.wall_ns += MS
    asking.receive("response", asking.asked[0], (encode(ReleaseReply(released=True, code=3)), None))
    assert [response.tag for response in asking.service.responses] == ["a tag"]
    assert threading.current_thread() not in asking.service.threads


def test_a_service_that_is_bound_to_its_thread_is_stepped_by_the_loop_only(monkeypatch: pytest.MonkeyPatch) -> None:
    asking = Asking(monkeypatch)
    runner = asking.runner
    runner._spec = replace(runner._spec, one_thread=True)
    monkeypatch.setattr(runner, "_wait", lambda until_ns: (asking.ask(), runner.stop()))
    runner._loop()
    assert set(asking.service.threads) == {threading.current_thread()}
    runner.close()


def test_while_somebody_steps_the_loop_is_rung(asking: Asking) -> None:
    with asking.runner._turn:
        assert not asking.ask().replies
    assert asking.runner._rung


def test_before_and_after_its_loop_a_process_does_not_step(asking: Asking) -> None:
    asking.runner._steps_where_received = False
    assert not asking.ask().replies
    asking.runner._steps_where_received = True
    asking.runner.stop()
    assert not asking.ask().replies


def test_after_the_process_stood_still_the_loop_catches_up_first(asking: Asking) -> None:
    asking.wall_ns = 20 * MS + zenoh_bus.STALL_NS + 1
    assert not asking.ask().replies
    assert asking.runner._rung


def test_what_has_piled_up_is_read_as_a_whole_before_the_next_step(asking: Asking) -> None:
    queries = [asking.ask() for _ in range(20)]
    assert len(asking.service.threads) == 1
    assert asking.runner._rung
    asking.runner._collect(asking.wall_ns)
    asking.runner._step(asking.wall_ns)
    assert all(query.replies for query in queries)
    assert len(asking.service.threads) == 2


@pytest.mark.parametrize("why", ["a quicker pace", "a topic to declare", "a status that is held back"])
def test_a_loop_that_has_to_wake_up_earlier_than_it_means_to_is_rung(asking: Asking, why: str) -> None:
    asking.service.answers = why == "a status that is held back"
    outputs: dict[str, Output] = {"a quicker pace": SetRate(200.0), "a topic to declare": Subscribe((topics.ODOMETRY,))}
    asking.service.also = (outputs[why],) if why in outputs else ()
    asking.ask()
    assert len(asking.service.threads) == 1
    assert asking.runner._rung


def test_a_step_that_fails_in_the_thread_that_received_ends_the_process(asking: Asking) -> None:
    asking.service.fails = True
    asking.ask()
    assert asking.runner._rung
    with pytest.raises(RuntimeError, match="broken"):
        asking.runner._loop()


def test_state_that_changes_with_a_reply_is_published_when_the_reply_has_gone(asking: Asking) -> None:
    assert asking.ask().replies
    assert b'"text":"1"' in asking.runner._session._last_value[topics.STATUS.name]  # a plain get sees it at once
    asking.runner._step(asking.wall_ns)  # what changes next waits as well, so that the order stays
    asking.runner._report(asking.wall_ns)
    assert asking.put == []
    asking.wall_ns += HELD_NS
    asking.runner._report(asking.wall_ns)
    asking.runner._step(asking.wall_ns)
    assert asking.put == [10 + HELD_NS // MS] * 3
