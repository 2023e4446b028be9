"""The loop of one process, without a bus: its clock is the test's, and messages are put into its queue."""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from types import SimpleNamespace

import pytest

from jezero.runtime import zenoh_bus
from jezero.runtime.codec import encode
from jezero.runtime.config import Instance
from jezero.runtime.service import Inbox, Output, Publish, Reply, Spec
from jezero.schemas import topics
from jezero.schemas.commands import AbortReply
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
    """Changes its status at each step, and answers whoever asks."""

    spec = Spec(
        name="asked",
        outputs=(topics.STATUS,),
        last_value=(topics.STATUS,),
        serves=(topics.ABORT,),
        triggers=(topics.ABORT.name,),
    )

    def __init__(self) -> None:
        self.steps = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self.steps += 1
        for request in inbox.requests(topics.ABORT):
            yield Reply(request.request_id, AbortReply(hovering=False, reason=""))
        status = Status(
            t_ns=0,
            code=0,
            name="IDLE",
            armed=False,
            landed=True,
            in_charge="none",
            bridge_boot_id=1,
            ready=True,
            text=str(self.steps),
        )
        yield Publish(topics.STATUS, status)


def test_state_that_changes_with_a_reply_is_published_when_the_reply_has_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_ns = 0
    monkeypatch.setattr(zenoh_bus, "time", SimpleNamespace(monotonic_ns=lambda: wall_ns))
    runner = zenoh_bus._Runner(Asked(), Instance(), 1, {})
    runner._next_health_ns = runner._next_router_check_ns = 10**12
    put: list[int] = []
    monkeypatch.setattr(runner._session, "put", lambda topic, data: put.append(wall_ns))
    runner.reply(1, None, final=True)
    runner._node.step(0)
    assert b'"text":"1"' in runner._session._last_value[topics.STATUS.name]  # a plain get sees it at once
    runner._replied = False
    runner._node.step(0)  # what changes next waits as well, so that the order stays
    runner._report(wall_ns)
    assert put == []
    wall_ns = zenoh_bus.HELD_NS
    runner._report(wall_ns)
    runner._node.step(0)
    assert put == [zenoh_bus.HELD_NS] * 3
    runner.close()
