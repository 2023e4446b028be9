"""The loop of one process, without a bus: its clock is the test's, and messages are put into its queue."""

from collections.abc import Iterable, Iterator
from types import SimpleNamespace

import pytest

from jezero.runtime import zenoh_bus
from jezero.runtime.codec import encode
from jezero.runtime.config import Instance
from jezero.runtime.service import Inbox, Output, Spec
from jezero.schemas import topics
from jezero.schemas.state import Clock

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
