"""The gate follows the keys of its bundle and bounds what members send; the programs of its computer notice nothing."""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event, Thread

import pytest
import zenoh

from jezero.keys.bundle import CERTIFICATE, KEY, secured
from jezero.keys.members import MEMBERS
from jezero.keys.team import Team
from jezero.runtime.gate import NICENESS, Bundles
from jezero.schemas.topics import HOVER, ROVER_COMMAND, STATUS, key, liveliness_key
from tests.keys.rig import add_at, make_team
from tests.runtime.computers import Computer, computer, wait_until

pytestmark = pytest.mark.process

VEHICLE = "uav1"
BLOCK = zenoh.CongestionControl.BLOCK
PERIOD_S = 0.02
STATUS_KEY, COMMAND_KEY, HOVER_KEY = (key(VEHICLE, each.name) for each in (STATUS, ROVER_COMMAND, HOVER))


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[Computer]:
    with computer(make_team(tmp_path / "team"), tmp_path) as vehicle:
        yield vehicle


class Traffic:
    """Status from one service of a computer to another, 50 times a second, as long as it is needed."""

    def __init__(self, vehicle: Computer) -> None:
        self.gaps_s: list[float] = []
        self._last_s: float | None = None
        self._ending = Event()
        vehicle.service().declare_subscriber(STATUS_KEY, self._on_status)
        self._writer = vehicle.service()
        self._thread = Thread(target=self._publish)
        self._thread.start()

    def _on_status(self, _sample: zenoh.Sample) -> None:
        now_s = time.monotonic()
        if self._last_s is not None:
            self.gaps_s.append(now_s - self._last_s)
        self._last_s = now_s

    def _publish(self) -> None:
        publisher = self._writer.declare_publisher(STATUS_KEY)
        while not self._ending.wait(PERIOD_S):
            publisher.put(b"{}")

    def end(self) -> None:
        """Stop publishing; `gaps_s` has the times between messages."""
        self._ending.set()
        self._thread.join()


def arrives_from(vehicle: Computer, name: str, latest_s: float = 10.0) -> bool:
    """Whether what a member publishes on `rover/command` arrives at a service of the vehicle."""
    heard: list[zenoh.Sample] = []
    subscriber = vehicle.service().declare_subscriber(COMMAND_KEY, heard.append)
    with vehicle.visitor(name) as session:

        def try_once() -> bool:
            session.put(COMMAND_KEY, name, congestion_control=BLOCK)
            time.sleep(0.1)
            return bool(heard)

        arrived = wait_until(try_once, latest_s)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    return arrived


def changes_noticed(vehicle: Computer) -> int:
    return vehicle.log.read_text().count("the keys have changed")


def test_a_change_of_keys_is_followed_while_local_messages_go_on(vehicle: Computer) -> None:
    assert arrives_from(vehicle, "pilot-bo") and arrives_from(vehicle, "pilot-ana")
    traffic = Traffic(vehicle)
    with vehicle.visitor("viewer-eye") as viewer:
        seen: list[zenoh.Sample] = []
        viewer.declare_subscriber(STATUS_KEY, seen.append)
        assert wait_until(lambda: len(seen) > 3)
        vehicle.team.revoke("pilot-bo")
        vehicle.team.add("pilot", "new")
        vehicle.copy_bundle()
        assert wait_until(lambda: changes_noticed(vehicle) == 1)
        seen.clear()
        assert wait_until(lambda: len(seen) > 3), "who is connected comes back by itself"
    traffic.end()
    assert arrives_from(vehicle, "pilot-new") and not arrives_from(vehicle, "pilot-bo", 2.0)
    assert vehicle.gate.poll() is None, "it is the same process, started anew"
    assert os.getpriority(os.PRIO_PROCESS, vehicle.gate.pid) == NICENESS
    assert max(traffic.gaps_s) < 1.0


def test_keys_that_cannot_be_used_leave_the_links_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    team = make_team(tmp_path)
    bundle = team.bundle("vehicle-uav1")
    monkeypatch.setattr("jezero.runtime.gate.FILES_PERIOD_S", 0.0)
    bundles = Bundles((secured("tls/127.0.0.1:7448", bundle),))
    assert not bundles.changed() and bundles.problem == ""
    old = (bundle / CERTIFICATE).read_bytes()
    for damage, reason in (
        (lambda: (bundle / CERTIFICATE).write_bytes(old[: len(old) // 2]), "damaged"),
        (lambda: shutil.copy(team.bundle("pilot-ana") / CERTIFICATE, bundle / CERTIFICATE), "is not the key of"),
        (
            lambda: shutil.copy(add_at(team, -400, "rover", "past") / CERTIFICATE, bundle / CERTIFICATE),
            "is not the key",
        ),
        (lambda: (bundle / MEMBERS).write_text("{"), "damaged"),
    ):
        damage()
        assert not any(bundles.changed() for _ in range(3))
        assert "can't be used, the links go on with the old ones" in bundles.problem and reason in bundles.problem
    shutil.copy(team.folder / MEMBERS, bundle / MEMBERS)
    (bundle / CERTIFICATE).write_bytes(old)
    Team(team.folder, datetime.now(UTC) + timedelta(seconds=1)).renew("vehicle-uav1")
    assert [bundles.changed(), bundles.changed()] == [False, True] and bundles.problem == ""


def test_files_that_are_still_being_copied_are_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jezero.runtime.gate.FILES_PERIOD_S", 0.0)
    bundle = make_team(tmp_path).bundle("vehicle-uav1")
    bundles = Bundles((secured("tls/127.0.0.1:7448", bundle),))
    whole = (bundle / KEY).read_bytes()
    for size in (10, 20, len(whole)):
        (bundle / KEY).write_bytes(whole[:size])
        assert not bundles.changed() and bundles.problem == ""
    assert bundles.changed()


def test_a_gate_without_a_link_says_what_it_needs(tmp_path: Path) -> None:
    with computer(make_team(tmp_path / "team"), tmp_path) as vehicle:
        vehicle.gate.terminate()
        vehicle.gate.wait(10.0)
        with ExitStack() as ends:
            lonely = Computer(vehicle.team, "vehicle-uav1", tmp_path, ends, connect=(" ",))
            assert wait_until(lambda: "JEZERO_LISTEN and JEZERO_CONNECT are empty" in lonely.log.read_text())


def ask(session: zenoh.Session) -> None:
    for number in range(40):
        session.get(f"{STATUS_KEY}{number}", lambda _reply: None, timeout=1.0)


def publish(session: zenoh.Session) -> None:
    for number in range(200):
        session.put(f"{STATUS_KEY}{number % 40}", b"{}", congestion_control=BLOCK)


def register(session: zenoh.Session) -> None:
    for number in range(20):
        liveliness = session.liveliness()
        liveliness.declare_token(liveliness_key(VEHICLE, "client", f"x{number}")).undeclare()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("member", ["viewer-eye", "pilot-ana"])
@pytest.mark.parametrize("attack", [ask, publish, register])
def test_a_member_that_sends_without_end_is_excluded_and_holds_up_no_local_message(
    vehicle: Computer, attack: "object", member: str
) -> None:
    traffic = Traffic(vehicle)
    deadline_s = time.monotonic() + 30.0
    excluded = f"{member} sends more than 300 requests, messages and declarations a second: it is excluded"
    while excluded not in vehicle.log.read_text() and time.monotonic() < deadline_s:
        with suppress(zenoh.ZError), vehicle.visitor(member, 5.0) as session:
            begin_s = time.monotonic()
            while session.info.routers_zid() and time.monotonic() < min(deadline_s, begin_s + 5.0):
                attack(session)  # type: ignore[operator]
    assert excluded in vehicle.log.read_text()
    traffic.end()
    assert max(traffic.gaps_s) < 1.0
    with vehicle.visitor("pilot-bo") as other:
        vehicle.service().declare_queryable(HOVER_KEY, lambda query: query.reply(HOVER_KEY, b"{}"), complete=True)
        assert wait_until(lambda: any(reply.ok for reply in other.get(HOVER_KEY, timeout=1.0)), 10.0)
