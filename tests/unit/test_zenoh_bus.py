"""The loop of one process, without a bus: its clock is the test's, and messages are put into its queue."""

import threading
from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any

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
        monkeypatch.setattr(zenoh_bus, "time", SimpleNamespace(monotonic_ns=lambda: self.wall_ns))
        self.runner = zenoh_bus._Runner(Idle(), Instance(), 1, {})

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


class Asked:
    """Changes its status whenever it is asked; `fails` when it is told to."""

    spec = Spec(
        name="asked",
        outputs=(topics.STATUS,),
        last_value=(topics.STATUS,),
        serves=(topics.ABORT,),
        triggers=(topics.ABORT.name,),
        prompt=True,
    )

    def __init__(self) -> None:
        self.threads: list[threading.Thread] = []
        self.fails = False

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        self.threads.append(threading.current_thread())
        if self.fails:
            raise RuntimeError("broken")
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
    """A process that is asked from another thread, as Zenoh does; its loop waits until `wait_ms`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall_ns = 0
        monkeypatch.setattr(zenoh_bus.time, "monotonic_ns", lambda: self.wall_ns)
        self.service = Asked()
        self.runner = zenoh_bus._Runner(self.service, Instance(), 1, {})
        self.put: list[tuple[str, int]] = []
        monkeypatch.setattr(self.runner._session, "put", self._put)
        self.runner._looping = True
        self.runner._until_ns = 20 * MS
        self.runner._next_health_ns = self.runner._next_router_check_ns = 10**12

    def _put(self, topic: topics.Topic[Any], data: bytes) -> None:
        self.put.append((topic.name, self.wall_ns // MS))

    def ask(self) -> Query:
        query = Query()
        thread = threading.Thread(target=self.runner._enqueue, args=("query", topics.ABORT.name, query))
        thread.start()
        thread.join()
        return query


@pytest.fixture
def asking(monkeypatch: pytest.MonkeyPatch) -> Iterator[Asking]:
    asking = Asking(monkeypatch)
    yield asking
    asking.runner.close()


def test_a_prompt_service_answers_in_the_thread_that_received(asking: Asking) -> None:
    assert asking.ask().replies
    assert asking.service.threads[0] is not threading.current_thread()
    assert not asking.runner._rung


def test_while_the_loop_steps_it_is_rung_instead(asking: Asking) -> None:
    with asking.runner._turn:
        assert not asking.ask().replies
    assert asking.runner._rung


def test_after_the_process_stood_still_the_loop_catches_up_first(asking: Asking) -> None:
    asking.wall_ns = 20 * MS + zenoh_bus.STALL_NS + 1
    assert not asking.ask().replies
    assert asking.runner._rung


def test_a_step_that_fails_in_the_thread_that_received_ends_the_process(asking: Asking) -> None:
    asking.service.fails = True
    asking.ask()
    assert asking.runner._rung
    with pytest.raises(RuntimeError, match="broken"):
        asking.runner._loop()


def test_state_that_changes_with_a_reply_can_be_asked_for_at_once_but_is_published_when_the_reply_has_gone(
    asking: Asking,
) -> None:
    asking.ask()
    assert b'"text":"1"' in asking.runner._session._last_value[topics.STATUS.name]
    asking.runner._step(asking.wall_ns)  # what changes next waits as well, so that the order stays
    asking.runner._report(asking.wall_ns)
    assert asking.put == []
    asking.wall_ns = zenoh_bus.HELD_NS
    asking.runner._report(asking.wall_ns)
    assert asking.put == [("status", 10), ("status", 10)]
    asking.runner._step(asking.wall_ns)
    assert len(asking.put) == 3
