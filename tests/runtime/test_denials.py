"""What a router denied, and to whom, from Zenoh's log: as a member's attempts make it, and from lines of it."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import zenoh

from jezero.keys.bundle import secured
from jezero.keys.team import Team
from jezero.runtime.denials import DENIALS_MAX, NAMED_FOR_S, SHOWN_MAX, Denials
from jezero.schemas.topics import CLOCK, HOVER, KILL, STATUS, key
from jezero.zenoh_client import client_config
from tests.keys.rig import add_at, free_port, make_team

VEHICLE = "uav1"
LATEST_S = 10.0
MEMBERS = {"80a6": "viewer-eye", "0b0b": "ground-lab"}
BEGIN = "2026-11-28T08:52:25.930486Z TRACE  rx-0 ThreadId(08) zenoh::net::routing::interceptor::access_control: "
TLS = "2026-11-28T08:52:27.444629Z  WARN acc-0 ThreadId(04) zenoh_link_tls::unicast: "
PUT = BEGIN + "Using cached result: 80a6 is unauthorized to Put (ingress) on uav1/odometry"


@pytest.fixture
def denials() -> Denials:
    return Denials(lambda session: MEMBERS.get(session, ""))


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


def test_a_denial_that_goes_on_is_logged_once_a_minute(denials: Denials, capsys: pytest.CaptureFixture[str]) -> None:
    for second in range(90):
        read(denials, PUT, PUT, now_s=float(second))
    own = "router: viewer-eye may not publish on uav1/odometry"
    assert capsys.readouterr().err.splitlines() == [own, f"{own} (122 times since the last line)"]
    assert denials.text(89.0 + NAMED_FOR_S + 1.0) == ""


def test_a_member_that_tries_any_number_of_keys_fills_neither_memory_nor_log(
    denials: Denials, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(3 * DENIALS_MAX):
        text = read(denials, f"{PUT}{number}", now_s=0.001 * number)
    newest = f"viewer-eye may not publish on uav1/odometry{3 * DENIALS_MAX - 1}"
    assert text.startswith(f"; denied: {newest}, ") and text.endswith(f", and {DENIALS_MAX - SHOWN_MAX} more")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == DENIALS_MAX and lines[-1].endswith("; more of this within a minute is not logged")


def test_nobody_hides_what_others_try_behind_many_attempts(
    denials: Denials, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(3 * DENIALS_MAX):
        read(denials, f"{PUT}{number}", now_s=0.001 * number)
    text = read(denials, PUT.replace("80a6", "0b0b"), now_s=1.0)
    own = "ground-lab may not publish on uav1/odometry"
    assert own in text and f"router: {own}" in capsys.readouterr().err


@contextmanager
def router_process(team: Team, folder: Path) -> Iterator[tuple[str, Path]]:
    """The process of a vehicle's router; its address for others and its log."""
    address, log = f"tls/127.0.0.1:{free_port()}", folder / "router.log"
    environment = {
        **os.environ,
        "JEZERO_ROUTER": f"tcp/127.0.0.1:{free_port()}",
        "JEZERO_LISTEN": address,
        "JEZERO_KEYS": str(team.bundle("vehicle-uav1")),
    }
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "jezero.runtime.router"], env=environment, stdout=out, stderr=out
        )
        try:
            yield address, log
        finally:
            process.terminate()
            process.wait(LATEST_S)


def test_what_members_and_strangers_try_is_logged_with_the_name_of_the_certificate(tmp_path: Path) -> None:
    team, others = make_team(tmp_path / "team"), make_team(tmp_path / "others")
    team.add("viewer", "gone")
    team.revoke("viewer-gone")
    with router_process(team, tmp_path) as (address, log):
        with zenoh.open(client_config(secured(address, team.bundle("viewer-eye")), LATEST_S)) as viewer:
            viewer.put(key(VEHICLE, CLOCK.name), b"{}")
            for endpoint in (HOVER, KILL):
                list(viewer.get(key(VEHICLE, endpoint.name), timeout=0.5))
            viewer.declare_queryable(key(VEHICLE, STATUS.name), lambda _query: None)
            with zenoh.open(client_config(secured(address, team.bundle("viewer-gone")), LATEST_S)) as gone:
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
    assert sorted(lines) == sorted(f"router: {words}" for words in expected)
