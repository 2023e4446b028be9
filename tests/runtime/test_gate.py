"""The gate to other computers follows the keys of its bundle, and the programs of its own computer notice nothing."""

import shutil
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh

from jezero.keys.bundle import CERTIFICATE, KEY, read_certificate, secured
from jezero.keys.members import MEMBERS
from jezero.keys.team import Team
from jezero.runtime.config import HostLinks
from jezero.runtime.gate import Gate
from jezero.runtime.routing import ListenError, open_router
from jezero.schemas.topics import ROVER_COMMAND, STATUS, key
from jezero.zenoh_client import client_config
from tests.keys.rig import add_at, free_port, make_team

VEHICLE = "uav1"
LATEST_S = 5.0
PERIOD_S, SENT = 0.005, 20
BLOCK = zenoh.CongestionControl.BLOCK


def wait_until(condition: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + LATEST_S
    while not condition() and time.monotonic() < deadline_s:
        time.sleep(0.02)
    return condition()


class Computer:
    """A vehicle's computer: router, gate with the bundle of `vehicle-uav1`, and two programs."""

    def __init__(self, team: Team) -> None:
        self.team, self.bundle = team, team.bundle("vehicle-uav1")
        self.port = free_port()
        router = f"tcp/127.0.0.1:{free_port()}"
        self.router = open_router(router, VEHICLE)
        links = HostLinks(listen=(secured(f"tls/127.0.0.1:{self.port}", self.bundle),))
        self.gate = Gate(router, VEHICLE, links)
        self.one, self.other = (zenoh.open(client_config(router, LATEST_S)) for _ in range(2))

    def connect(self, name: str) -> zenoh.Session:
        """The session of a member on another computer."""
        endpoint = secured(f"tls/127.0.0.1:{self.port}", self.team.bundle(name))
        return zenoh.open(client_config(endpoint, LATEST_S))

    def follow(self) -> bool:
        """Whether the gate is opened anew for files that have changed and rest."""
        return any(self.gate.update() for _ in range(2))

    def close(self) -> None:
        for session in (self.one, self.other):
            session.close()  # type: ignore[no-untyped-call]
        self.gate.close()
        self.router.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def computer(tmp_path: Path) -> Iterator[Computer]:
    computer = Computer(make_team(tmp_path / "team"))
    yield computer
    computer.close()


def heard_from(computer: Computer, name: str) -> bool:
    """Whether what a member publishes on `rover/command` arrives at a program of the vehicle."""
    heard: list[zenoh.Sample] = []
    subscriber = computer.one.declare_subscriber(key(VEHICLE, ROVER_COMMAND.name), heard.append)
    with computer.connect(name) as session:
        for _ in range(10):
            session.put(key(VEHICLE, ROVER_COMMAND.name), name, congestion_control=BLOCK)
            time.sleep(0.1)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    return bool(heard)


def test_without_changes_the_gate_stays(computer: Computer) -> None:
    session = computer.gate.session
    assert not computer.follow() and computer.gate.session is session and computer.gate.problem == ""


def test_a_renewed_certificate_is_shown_while_local_messages_go_on(computer: Computer) -> None:
    heard: list[zenoh.Sample] = []
    own = key(VEHICLE, STATUS.name)
    subscriber = computer.other.declare_subscriber(own, heard.append)
    publisher = computer.one.declare_publisher(own)
    wait_until(lambda: bool(publisher.matching_status.matching))  # type: ignore[attr-defined]
    before = read_certificate(computer.bundle / CERTIFICATE).serial_number
    Team(computer.team.folder, datetime.now(UTC) + timedelta(seconds=1)).renew("vehicle-uav1")
    assert read_certificate(computer.bundle / CERTIFICATE).serial_number != before
    sent, renewed = 0, False
    deadline_s = time.monotonic() + LATEST_S
    while not renewed and time.monotonic() < deadline_s:
        for _ in range(SENT):
            publisher.put(b"{}")
            time.sleep(PERIOD_S)
        sent += SENT
        renewed = computer.gate.update()
    assert wait_until(lambda: len(heard) == sent)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert renewed
    assert heard_from(computer, "pilot-ana")


def test_a_revocation_counts_without_a_restart(computer: Computer) -> None:
    assert heard_from(computer, "pilot-bo")
    computer.team.revoke("pilot-bo")
    shutil.copy(computer.team.folder / MEMBERS, computer.bundle / MEMBERS)
    assert computer.follow()
    assert not heard_from(computer, "pilot-bo")
    assert heard_from(computer, "pilot-ana")


def test_a_member_that_is_connected_comes_back_by_itself(computer: Computer) -> None:
    heard: list[zenoh.Sample] = []
    with computer.connect("viewer-eye") as viewer:
        viewer.declare_subscriber(key(VEHICLE, STATUS.name), heard.append)
        computer.team.add("pilot", "new")
        shutil.copy(computer.team.folder / MEMBERS, computer.bundle / MEMBERS)
        assert computer.follow()
        heard.clear()

        def arrives() -> bool:
            computer.one.put(key(VEHICLE, STATUS.name), b"{}")
            return bool(heard)

        assert wait_until(arrives)
    assert heard_from(computer, "pilot-new")


def test_keys_that_cannot_be_used_leave_the_links_as_they_are(computer: Computer) -> None:
    old = (computer.bundle / CERTIFICATE).read_bytes()
    session = computer.gate.session
    for damage, reason in (
        (lambda: (computer.bundle / CERTIFICATE).write_bytes(old[: len(old) // 2]), "damaged"),
        (
            lambda: shutil.copy(computer.team.bundle("pilot-ana") / CERTIFICATE, computer.bundle / CERTIFICATE),
            "is not the key of",
        ),
        (
            lambda: shutil.copy(
                add_at(computer.team, -400, "rover", "past") / CERTIFICATE, computer.bundle / CERTIFICATE
            ),
            "is not the key of",
        ),
        (lambda: (computer.bundle / MEMBERS).write_text("{"), "damaged"),
    ):
        damage()
        assert not computer.follow() and computer.gate.session is session
        assert "can't be used, the links go on with the old ones" in computer.gate.problem
        assert reason in computer.gate.problem
    shutil.copy(computer.team.folder / MEMBERS, computer.bundle / MEMBERS)
    (computer.bundle / CERTIFICATE).write_bytes(old)
    computer.follow()
    assert computer.gate.problem == ""
    assert heard_from(computer, "pilot-ana")


def test_files_that_are_still_being_copied_are_waited_for(computer: Computer) -> None:
    part = (computer.bundle / KEY).read_bytes()
    for size in (10, 20, len(part)):
        (computer.bundle / KEY).write_bytes(part[:size])
        assert not computer.gate.update() and computer.gate.problem == ""
    assert computer.gate.update()


def test_a_port_that_was_taken_meanwhile_is_named_until_it_is_free(
    computer: Computer, monkeypatch: pytest.MonkeyPatch
) -> None:
    computer.team.add("pilot", "new")
    shutil.copy(computer.team.folder / MEMBERS, computer.bundle / MEMBERS)

    def refuse(*_args: object) -> zenoh.Session:
        raise ListenError("the port is taken")

    with monkeypatch.context() as patched:
        patched.setattr("jezero.runtime.gate.open_gate", refuse)
        assert not computer.follow() and computer.gate.session is None
        assert computer.gate.problem == "the port is taken"
    assert computer.gate.update() and computer.gate.problem == ""
