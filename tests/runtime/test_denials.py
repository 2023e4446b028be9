"""What a router denied, and to whom, from Zenoh's log: as a member's attempts make it, and from lines of it."""

import time
from contextlib import suppress
from pathlib import Path

import pytest
import zenoh

from jezero.base.zenoh_client import client_config
from jezero.keys.bundle import secured
from jezero.runtime.denials import (
    DENIALS_MAX,
    EXCLUDED_FOR_S,
    KEY_MAX,
    MESSAGES_BURST,
    MESSAGES_MAX_HZ,
    NAMED_FOR_S,
    SHOWN_MAX,
    Denials,
)
from jezero.schemas.topics import CLOCK, HOVER, KILL, STATUS, key
from tests.keys.rig import add_at, make_team
from tests.runtime.computers import computer

pytestmark = pytest.mark.process

VEHICLE = "uav1"
LATEST_S = 10.0
MEMBERS = {"80a6": "viewer-eye", "0b0b": "ground-lab", "7e1c": "vehicle-uav1"}
BEGIN = "2026-11-28T08:52:25.930486Z TRACE  rx-0 ThreadId(08) zenoh::net::routing::interceptor::access_control: "
TLS = "2026-11-28T08:52:27.444629Z  WARN acc-0 ThreadId(04) zenoh_link_tls::unicast: "
PUT = BEGIN + "Using cached result: 80a6 is unauthorized to Put (ingress) on uav1/odometry"


@pytest.fixture
def denials() -> Denials:
    denials = Denials()
    denials.name_by(lambda session: MEMBERS.get(session, ""))
    return denials


def read(denials: Denials, *lines: str, now_s: float = 0.0) -> str:
    denials.add("\n".join(lines).encode(), now_s)
    return denials.text(now_s)


def test_nothing_denied_is_nothing_to_tell(denials: Denials) -> None:
    assert read(denials) == ""
    assert read(denials, BEGIN + "80a6 on Interface(lo) is authorized to Put (ingress) on uav1/rover/command") == ""


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (PUT, "viewer-eye may not publish on uav1/odometry"),
        (PUT.replace("Put", "Delete"), "viewer-eye may not delete uav1/odometry"),
        (BEGIN + "80a6 on Interface(lo) is unauthorized to Query (ingress) on uav1/@action/takeoff",
         "viewer-eye may not send a request to uav1/@action/takeoff"),
        (PUT.replace("Put", "Declare Queryable"), "viewer-eye may not take requests on uav1/odometry"),
        (BEGIN + "7777 on Interface(lo)+CertCommonName(pilot-bo)+7777 is unauthorized to Query (ingress) on uav1/a",
         "pilot-bo may not send a request to uav1/a"),
        (PUT.replace("80a6", "7777"), "session 7777 may not publish on uav1/odometry"),
        (BEGIN + "80a6 did not match any configured ACL subject. Default permission `Deny` will be applied",
         "viewer-eye is revoked, or not in this computer's list of members, and may do nothing"),
        (TLS + "invalid peer certificate: certificate expired: verification time 1 (UNIX). Hint: increase the limit.",
         "a connection was refused: its certificate has expired"),
        (TLS + "received corrupt message of type InvalidContentType. Hint: increase the system open file limit.",
         "a connection was refused: it speaks no TLS"),
        (TLS + "something new \x1b[31m happened. Hint: increase the system open file limit.",
         "a connection was refused: something new \ufffd[31m happened"),
    ],
)  # fmt: skip
def test_a_denial_is_told_in_words(denials: Denials, line: str, words: str) -> None:
    assert read(denials, line) == f"; denied: {words}"


def test_what_a_computers_router_declares_for_its_programs_is_no_attempt(denials: Denials) -> None:
    assert read(denials, PUT.replace("Put", "Liveliness Token").replace("80a6", "0b0b")) == ""
    assert read(denials, PUT.replace("80a6", "0b0b")) != ""


def test_what_zenoh_works_out_in_advance_is_no_attempt(denials: Denials) -> None:
    decision = BEGIN + "80a6 on Interface(lo) is unauthorized to {} (ingress) on uav1/a"
    block = [BEGIN + "ACL (ingress): caching permissions for `uav1/a` ..."]
    block += [decision.format(what) for what in ("Query", "Reply", "Put", "Delete", "Declare Liveliness Subscriber")]
    assert read(denials, *block) == ""
    assert "may not publish on uav1/a" in read(denials, decision.format("Put"))


def test_what_the_router_itself_leaves_out_is_no_attempt(denials: Denials) -> None:
    assert read(denials, PUT.replace("ingress", "egress")) == ""


def test_a_denial_that_goes_on_is_logged_once(denials: Denials, capsys: pytest.CaptureFixture[str]) -> None:
    own = "gate: viewer-eye may not publish on uav1/odometry"
    for second in range(90):
        read(denials, PUT, PUT, now_s=float(second))
    assert capsys.readouterr().err.splitlines() == [own]
    assert denials.text(89.0 + NAMED_FOR_S + 1.0) == ""
    read(denials, PUT, now_s=89.0 + NAMED_FOR_S + 1.0)
    assert capsys.readouterr().err.splitlines() == [own]


def test_a_member_that_tries_any_number_of_keys_fills_neither_memory_nor_log(
    denials: Denials, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(3 * DENIALS_MAX):
        text = read(denials, f"{PUT}{number}", now_s=0.001 * number)
    newest = f"viewer-eye may not publish on uav1/odometry{3 * DENIALS_MAX - 1}"
    assert text.startswith(f"; denied: {newest}, ") and text.endswith(f", and {DENIALS_MAX - SHOWN_MAX} more")
    assert len(capsys.readouterr().err.splitlines()) == DENIALS_MAX


def test_a_key_without_end_is_cut(denials: Denials) -> None:
    text = read(denials, PUT + "x" * 10_000)
    assert KEY_MAX < len(text) < 2 * KEY_MAX


def sent(denials: Denials, count: int, at_s: float, session: str = "80a6") -> None:
    """The member with a session sends some messages, which it may send."""
    line = BEGIN + f"Using cached result: {session} is authorized to Query (ingress) on uav1/status"
    denials.add("\n".join([line] * count).encode(), at_s)


def test_a_member_that_sends_as_people_do_is_not_excluded(denials: Denials) -> None:
    sent(denials, int(MESSAGES_BURST), 0.0)
    for second in range(1, 60):
        sent(denials, int(MESSAGES_MAX_HZ), float(second))
        assert denials.excluded(float(second)) == []


def test_a_member_that_sends_more_is_excluded_until_it_has_been_quiet(denials: Denials) -> None:
    sent(denials, int(MESSAGES_BURST) + 1, 0.0)
    assert denials.excluded(0.0) == ["viewer-eye"]
    assert "viewer-eye sends more than 300 requests, messages and declarations a second" in denials.text(0.0)
    sent(denials, 1, EXCLUDED_FOR_S - 1.0)
    assert denials.excluded(2 * EXCLUDED_FOR_S - 2.0) == ["viewer-eye"]
    assert denials.excluded(2 * EXCLUDED_FOR_S) == []
    sent(denials, 100, 2 * EXCLUDED_FOR_S)
    assert denials.excluded(2 * EXCLUDED_FOR_S) == []


def test_the_vehicles_own_messages_are_not_counted(denials: Denials) -> None:
    sent(denials, 10 * int(MESSAGES_BURST), 0.0, "7e1c")
    assert denials.excluded(0.0) == []


def test_nobody_hides_what_others_try_behind_many_attempts(
    denials: Denials, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(3 * DENIALS_MAX):
        read(denials, f"{PUT}{number}", now_s=0.001 * number)
    text = read(denials, PUT.replace("80a6", "0b0b"), now_s=1.0)
    own = "ground-lab may not publish on uav1/odometry"
    assert own in text and f"gate: {own}" in capsys.readouterr().err


def test_what_members_and_strangers_try_is_logged_with_the_name_of_the_certificate(tmp_path: Path) -> None:
    team, others = make_team(tmp_path / "team"), make_team(tmp_path / "others")
    team.add("viewer", "gone")
    team.revoke("viewer-gone")
    with computer(team, tmp_path) as vehicle:
        address, log = vehicle.address, vehicle.log
        with vehicle.visitor("viewer-eye") as viewer:
            viewer.put(key(VEHICLE, CLOCK.name), b"{}")
            for endpoint in (HOVER, KILL):
                list(viewer.get(key(VEHICLE, endpoint.name), timeout=0.5))
            viewer.declare_queryable(key(VEHICLE, STATUS.name), lambda _query: None)
            with vehicle.visitor("viewer-gone") as gone:
                gone.put(key(VEHICLE, CLOCK.name), b"{}")
                time.sleep(1.0)
            for bundle in (add_at(team, -400, "pilot", "past"), others.bundle("pilot-ana")):
                with suppress(zenoh.ZError):
                    zenoh.open(client_config(secured(address, bundle), 0.3))
        expected = [
            f"viewer-eye may not publish on {key(VEHICLE, CLOCK.name)}",
            f"viewer-eye may not send a request to {key(VEHICLE, HOVER.name)}",
            f"viewer-eye may not send a request to {key(VEHICLE, KILL.name)}",
            f"viewer-eye may not take requests on {key(VEHICLE, STATUS.name)}",
            "viewer-gone is revoked, or not in this computer's list of members, and may do nothing",
            "a connection was refused: its certificate has expired",
            "a connection was refused: its bundle is another team's",
        ]
        deadline_s = time.monotonic() + LATEST_S
        while any(words not in log.read_text() for words in expected) and time.monotonic() < deadline_s:
            time.sleep(0.1)
        lines = log.read_text().splitlines()
    assert sorted(lines) == sorted(f"gate: {words}" for words in expected)
