"""The loop of one process, without a bus: its clock is the test's, and messages are put into its queue."""

import os
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from jezero.base.codec import encode, split_attachment
from jezero.runtime import zenoh_bus
from jezero.runtime.instance import Instance
from jezero.runtime.node import FAILED_STEPS_MAX
from jezero.runtime.service import Call, Inbox, Output, Publish, Reply, Response, Spec
from jezero.schemas import topics
from jezero.schemas.commands import AbortReply, Release, ReleaseReply
from jezero.schemas.sensors import CameraFrame
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
        """Stall of the process in each of its next sleeps."""
        clock = SimpleNamespace(monotonic_ns=lambda: self.wall_ns, sleep=self._sleep)
        monkeypatch.setattr(zenoh_bus, "time", clock)
        self.runner = zenoh_bus.ServiceLoop(Idle(), Instance(), 1, {})

    def _sleep(self, seconds: float) -> None:
        self.wall_ns += round(seconds * 1000 * MS + (self.stalls_ms.pop(0) if self.stalls_ms else 0) * MS)

    def receive_clock(self, sent_ms: int, pace: float = 1.0) -> None:
        """Receive a message of a master with the same monotonic clock and vehicle time."""
        clock = Clock(t_ns=sent_ms * MS, epoch_id=1, wall_ns=sent_ms * MS, pace=pace)
        self.runner._enqueue("sample", topics.CLOCK.name, encode(clock))

    @property
    def t_ms(self) -> float:
        return self.runner._clock.now_ns(self.wall_ns) / MS

    def collect(self) -> tuple[float, float]:
        """Wall time of the inbox in ms, and what it leaves out, after a turn of the loop."""
        self.runner._collect(self.wall_ns)
        inbox = self.runner._node.inbox
        return inbox.wall_ns / MS, inbox.stalled_ns / MS


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[Host]:
    host = Host(monkeypatch)
    yield host
    host.runner.close()


def test_a_message_that_came_while_the_others_were_read_does_not_make_its_master_seem_ahead(host: Host) -> None:
    host.receive_clock(sent_ms=1150)
    host.wall_ns = 1160 * MS
    host.runner._collect(1000 * MS)  # the process stood still between reading its clock and the queue
    assert host.t_ms == pytest.approx(1150)
    for sent_ms in range(1250, 2051, 100):
        host.receive_clock(sent_ms)
        host.wall_ns = (sent_ms + 1) * MS
        host.runner._collect(host.wall_ns)
    assert host.t_ms == pytest.approx(2050, abs=0.1)


@pytest.mark.parametrize("where", ["waiting", "catching up", "reading"])
def test_no_step_counts_the_time_in_which_the_process_stood_still(
    host: Host, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    stepped_ms: list[float] = []
    runner, collect = host.runner, host.runner._collect
    runner._node._health_ns = runner._next_router_check_ns = 10**12

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
    host.receive_clock(sent_ms=0)
    runner._loop()
    assert all(90 < after - before < 200 for before, after in pairwise(stepped_ms))
    assert runner._late_ns >= 600 * MS


class Asked:
    """Changes its status at each step and replies to aborts.

    Attributes:
        threads: of its steps.
        responses: all that it has got.
        answers: whether it replies.
        fails: whether its step raises.
        also: further outputs of each step.
    """

    spec = Spec(
        name="asked",
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
    """A client's query."""

    key_expr = topics.key("uav1", topics.ABORT.name)
    payload = attachment = None
    parameters: tuple[tuple[str, str], ...] = ()

    def __init__(self) -> None:
        self.replies: list[bytes] = []

    def reply(self, key_expr: str, data: bytes, **_settings: Any) -> None:
        self.replies.append(data)

    def drop(self) -> None: ...


class Asking:
    """A process that receives in another thread, as from Zenoh, and whose loop is turned by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall_ns = 10 * MS
        monkeypatch.setattr(zenoh_bus, "time", SimpleNamespace(monotonic_ns=lambda: self.wall_ns))
        self.service = Asked()
        self.runner = zenoh_bus.ServiceLoop(self.service, Instance(), 1, {})
        self.put: list[int] = []
        publisher = SimpleNamespace(put=lambda data: self.put.append(self.wall_ns // MS))
        monkeypatch.setattr(self.runner._session, "_publishers", defaultdict(lambda: publisher))
        self.asked: list[str] = []
        monkeypatch.setattr(
            self.runner._session, "call", lambda _endpoint, _data, call_id, _s: self.asked.append(call_id)
        )
        self.wakeups = 0
        monkeypatch.setattr(self.runner, "_wake", self._wake)
        self.runner._node._health_ns = self.runner._next_router_check_ns = 10**12

    def _wake(self) -> None:
        self.wakeups += 1
        os.eventfd_write(self.runner._wakeup_fd, 1)

    def receive(self, *what: Any) -> None:
        """Receive something in another thread."""
        thread = threading.Thread(target=lambda: self.runner._enqueue(*what))
        thread.start()
        thread.join()

    def ask(self) -> Query:
        query = Query()
        self.receive("query", topics.ABORT.name, query)
        return query

    def turn(self) -> None:
        """One turn of the loop."""
        if self.runner._collect(self.wall_ns):
            self.runner._step(self.wall_ns)
            self.runner._report(self.wall_ns)


@pytest.fixture
def asking(monkeypatch: pytest.MonkeyPatch) -> Iterator[Asking]:
    asking = Asking(monkeypatch)
    yield asking
    asking.runner.close()


def test_a_service_is_stepped_by_the_thread_of_its_loop_only(asking: Asking, monkeypatch: pytest.MonkeyPatch) -> None:
    queries: list[Query] = []

    def wait(until_ns: int) -> None:
        queries.append(asking.ask())
        asking.receive("response", "of an unknown call", (None, "timeout"))
        if len(queries) == 2:
            asking.runner.stop()

    monkeypatch.setattr(asking.runner, "_wait", wait)
    asking.runner._loop()
    assert set(asking.service.threads) == {threading.current_thread()}
    assert all(query.replies for query in queries)


def test_an_answer_to_a_call_makes_a_step(asking: Asking) -> None:
    asking.service.also = (Call(topics.RELEASE, Release(control_id="c", outcome="aborted"), "a tag"),)
    asking.ask()
    asking.turn()
    asking.service.also = ()
    asking.receive("response", asking.asked[0], (encode(ReleaseReply(released=True, code=3)), None))
    asking.turn()
    assert [response.tag for response in asking.service.responses] == ["a tag"]


def test_what_arrives_between_two_turns_of_the_loop_wakes_it_once(asking: Asking) -> None:
    for _ in range(20):
        asking.ask()
    assert asking.wakeups == 1
    asking.runner._wait(asking.wall_ns)
    asking.ask()
    assert asking.wakeups == 2


def test_what_has_piled_up_is_read_as_a_whole_before_the_next_step(asking: Asking) -> None:
    queries = [asking.ask() for _ in range(20)]
    asking.turn()
    assert all(query.replies for query in queries)
    assert len(asking.service.threads) == 1


def test_of_pictures_that_pile_up_the_newest_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    class Viewer:
        spec = Spec(name="viewer", inputs=(topics.CAMERA,), triggers=(topics.CAMERA.name,))

        def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
            seen.extend(frame.sequence for frame in inbox.new(topics.CAMERA))
            return ()

    runner = zenoh_bus.ServiceLoop(Viewer(), Instance(), 1, {})
    try:
        for number in range(3):
            header, pixels = split_attachment(encode(picture(number)))
            payload, attachment = (SimpleNamespace(to_bytes=lambda data=data: data) for data in (pixels, header))
            runner._enqueue("newest", topics.CAMERA.name, SimpleNamespace(payload=payload, attachment=attachment))
        assert len(runner._newest) == 1
        assert runner._collect(0)
        runner._step(0)
    finally:
        runner.close()
    assert seen == [2]


def picture(number: int) -> CameraFrame:
    return CameraFrame(
        t_ns=1, sequence=number, width_px=1, height_px=1, pitch_camera_rad=0.0, exposure_s=0.01, pixels=b"rgb"
    )


def test_a_step_that_fails_ends_nothing_and_many_in_a_row_end_the_process(asking: Asking) -> None:
    asking.service.fails = True
    for _ in range(FAILED_STEPS_MAX):
        asking.ask()
        asking.turn()
    assert len(asking.service.threads) == FAILED_STEPS_MAX
    asking.ask()
    with pytest.raises(RuntimeError, match="broken"):
        asking.runner._loop()


def test_state_that_changes_with_a_reply_is_published_in_the_same_step(asking: Asking) -> None:
    query = asking.ask()
    asking.turn()
    assert query.replies
    last = asking.runner._session._last_value[topics.STATUS.name]  # for a plain get
    assert last is not None and b'"text":"1"' in last
    assert asking.put == [10]


def test_nobody_grows_old_by_the_inbox_while_the_simulator_is_paused(host: Host) -> None:
    host.wall_ns = 1000 * MS
    host.receive_clock(sent_ms=1000)
    assert host.collect() == (1000, 0)
    host.receive_clock(sent_ms=1000, pace=0.0)
    host.collect()
    for wall_ms in range(1100, 3001, 100):
        host.wall_ns = wall_ms * MS
        clock = Clock(t_ns=1000 * MS, epoch_id=1, wall_ns=host.wall_ns, pace=0.0)
        host.runner._enqueue("sample", topics.CLOCK.name, encode(clock))
        wall, left_out = host.collect()
        assert wall == pytest.approx(1000)
        assert wall + left_out == pytest.approx(wall_ms)
    host.receive_clock(sent_ms=3000)
    host.collect()
    host.wall_ns = 3100 * MS
    assert host.collect() == pytest.approx((1100, 2000))


def test_at_a_tenth_of_the_speed_the_inbox_grows_old_at_a_tenth(host: Host) -> None:
    host.wall_ns = 1000 * MS
    host.receive_clock(sent_ms=1000, pace=0.1)
    host.collect()
    host.wall_ns = 2000 * MS
    assert host.collect() == pytest.approx((1100, 900))
