"""A connection with TLS that doesn't come about has its reason in one sentence: real routers, real handshakes."""

import os
import shutil
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from jezero import Unreachable, Vehicle
from jezero.keys.bundle import secured
from jezero.keys.diagnosis import connection_problem
from jezero.keys.team import Team
from jezero.runtime.instance import HostLinks, socket_of
from jezero.runtime.routing import ListenError, open_gate, open_router, router_problem
from tests.keys.rig import add_at, free_port, make_team, router

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Team:
    return make_team(tmp_path_factory.mktemp("a") / "team")


@pytest.fixture(scope="module")
def port(team: Team) -> Iterator[int]:
    with router(team.bundle("vehicle-uav1")) as (port, _):
        yield port


def refusal(port: int, bundle: Path | None, host: str = "127.0.0.1", protocol: str = "tls") -> str:
    """The error of a client of the SDK."""
    with pytest.raises(Unreachable) as caught:
        Vehicle.connect("uav1", router=f"{protocol}/{host}:{port}", keys=bundle, timeout_s=3.0)
    return str(caught.value)


def test_with_the_right_bundle_there_is_nothing_to_say(team: Team, port: int) -> None:
    with Vehicle.connect("uav1", router=f"tls/127.0.0.1:{port}", keys=team.bundle("pilot-ana")):
        pass
    assert connection_problem(secured(f"tls/127.0.0.1:{port}", team.bundle("pilot-ana"))) == ""


def test_the_bundle_may_be_named_in_the_environment(team: Team, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_KEYS", str(team.bundle("pilot-ana")))
    monkeypatch.setenv("JEZERO_ROUTER", f"tls/127.0.0.1:{port}")
    with Vehicle.connect() as vehicle:
        assert vehicle.client_id


def test_without_a_bundle_the_option_for_it_is_named(port: int) -> None:
    assert "name the folder of a bundle with --keys or JEZERO_KEYS" in refusal(port, None)


def test_an_address_without_tls_for_a_router_with_tls_is_named(port: int) -> None:
    assert f"the router at tcp/127.0.0.1:{port} speaks TLS only: write tls/" in refusal(port, None, protocol="tcp")


def test_an_expired_certificate_is_named_with_the_command_that_renews_it(team: Team, port: int) -> None:
    reason = refusal(port, add_at(team, -400, "pilot", "past"))
    assert reason.startswith("the certificate of pilot-past has expired on 20")
    assert "`jezero keys renew pilot-past`" in reason


def test_a_certificate_of_the_future_blames_the_clock_of_this_computer(team: Team, port: int) -> None:
    reason = refusal(port, add_at(team, 5, "pilot", "future"))
    assert "this computer's clock says" in reason and reason.endswith("set the clock")


def test_a_router_of_another_team_is_told_from_ones_own(port: int, tmp_path: Path) -> None:
    others = make_team(tmp_path / "others")
    assert "is another team's" in refusal(port, others.bundle("pilot-ana"))


def test_a_bundle_of_two_teams_is_not_known_to_the_router(team: Team, port: int, tmp_path: Path) -> None:
    mixed = make_team(tmp_path / "others").bundle("pilot-ana")
    shutil.copy(team.bundle("pilot-ana") / "ca.pem", mixed)
    assert "doesn't know the authority that signed the certificate of pilot-ana" in refusal(port, mixed)


def test_an_address_that_is_not_in_the_certificate_gets_those_that_are(team: Team, port: int) -> None:
    reason = refusal(port, team.bundle("pilot-ana"), host="127.0.0.3")
    assert "the certificate of vehicle-uav1 is for localhost, 127.0.0.2, 127.0.0.1, ::1, not for 127.0.0.3" in reason
    assert "`jezero keys renew vehicle-uav1 --host 127.0.0.3" in reason


def test_a_name_that_no_host_has_is_named(team: Team, port: int) -> None:
    reason = refusal(port, team.bundle("pilot-ana"), host="nobody.invalid")
    assert "no host is called nobody.invalid" in reason


def test_a_revoked_member_is_told_so_by_its_own_list(tmp_path: Path, port: int, team: Team) -> None:
    team.add("pilot", "gone")
    team.revoke("pilot-gone")
    assert connection_problem(secured("tls/127.0.0.1:1", team.bundle("pilot-gone"))).startswith("pilot-gone is revoked")


def test_an_expired_router_is_named_with_the_command_that_renews_it(team: Team) -> None:
    with router(add_at(team, -400, "vehicle", "past")) as (port, _):
        reason = refusal(port, team.bundle("pilot-ana"))
    assert "the certificate of vehicle-past has expired" in reason and "`jezero keys renew vehicle-past`" in reason


def test_who_plays_a_router_with_a_viewers_key_is_named(team: Team) -> None:
    with router(team.bundle("viewer-eye")) as (port, _):
        assert "uses the certificate of viewer-eye, who runs none: don't trust it" in refusal(
            port, team.bundle("pilot-ana")
        )


def test_a_router_without_tls_is_named(team: Team, tmp_path: Path) -> None:
    port = free_port()
    with open_router(f"tcp/127.0.0.1:{port}", socket_of(tmp_path)):
        assert "is the stack up, with a tls/… address?" in refusal(port, team.bundle("pilot-ana"))


def test_another_program_at_the_address_is_named(team: Team) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]

        def greet() -> None:
            while True:
                try:
                    link, _ = other.accept()
                except OSError:  # the test has ended
                    return
                with link, suppress(OSError):
                    link.sendall(b"220 welcome\r\n")
                    while link.recv(65536):
                        pass

        threading.Thread(target=greet, daemon=True).start()
        assert "is no router with TLS" in refusal(port, team.bundle("pilot-ana"))


def test_without_a_router_the_stack_is_named(team: Team) -> None:
    with pytest.raises(Unreachable, match="is the stack up"):
        Vehicle.connect("uav1", router="tls/127.0.0.1:1", keys=team.bundle("pilot-ana"), timeout_s=0.3)


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_server_that_never_replies_gives_no_reason_and_holds_nobody_up(team: Team, protocol: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"{protocol}/127.0.0.1:{silent.getsockname()[1]}"
        endpoint = secured(address, team.bundle("pilot-ana")) if protocol == "tls" else address
        found: list[str] = []
        thread = threading.Thread(target=lambda: found.append(connection_problem(endpoint)), daemon=True)
        thread.start()
        thread.join(10.0)
        assert found == [""]


def test_a_key_of_another_certificate_is_named(team: Team, port: int, tmp_path: Path) -> None:
    mixed = Path(shutil.copytree(team.bundle("pilot-ana"), tmp_path / "mixed"))
    shutil.copy(team.bundle("pilot-bo") / "key.pem", mixed)
    assert "is not the key of" in refusal(port, mixed)


def test_a_damaged_certificate_is_named(team: Team, port: int, tmp_path: Path) -> None:
    damaged = Path(shutil.copytree(team.bundle("pilot-ana"), tmp_path / "damaged"))
    (damaged / "certificate.pem").write_text("nothing")
    assert "certificate.pem is damaged" in refusal(port, damaged)


def test_a_key_that_this_user_may_not_read_is_named(team: Team) -> None:
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        bundle = Path(shutil.copytree(team.bundle("pilot-ana"), Path(folder) / "keys"))
        (bundle / "key.pem").chmod(0)
        is_root = os.geteuid() == 0
        if is_root:
            for path in (bundle, *bundle.iterdir()):
                os.chown(path, 65534, -1)
            os.seteuid(65534)  # root may read everything
        try:
            reason = refusal(1, bundle)
        finally:
            if is_root:
                os.seteuid(0)
    assert "key.pem: Permission denied" in reason and "belong to the user that starts jezero" in reason


def test_a_gate_does_not_listen_with_a_certificate_that_nobody_takes(team: Team, tmp_path: Path) -> None:
    team.add("ground", "gone")
    team.revoke("ground-gone")
    expired = add_at(team, -400, "rover", "past")
    for bundle, expected in (
        (expired, "rover-past has expired"),
        (team.bundle("ground-gone"), "ground-gone is revoked"),
        (team.bundle("pilot-ana"), "pilot-ana runs no router"),
    ):
        endpoint = secured(f"tls/127.0.0.1:{free_port()}", bundle)
        assert expected in router_problem(endpoint)
        with pytest.raises(ListenError, match=expected):
            open_gate(socket_of(tmp_path), "uav1", HostLinks(listen=(endpoint,)))
    endpoint = secured(f"tls/127.0.0.1:{free_port()}", team.bundle("vehicle-uav1"))
    assert router_problem(endpoint) == ""
    open_gate(socket_of(tmp_path), "uav1", HostLinks(listen=(endpoint,))).close()  # type: ignore[no-untyped-call]


def test_the_sdk_connects_to_another_computer_without_tls_only_when_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JEZERO_INSECURE", raising=False)
    with pytest.raises(Unreachable, match="without TLS whoever is on the network"):
        Vehicle.connect("uav1", router="tcp/no-such-host.invalid:7447")
    with pytest.raises(Unreachable, match="no router at"):
        Vehicle.connect("uav1", router="tcp/no-such-host.invalid:7447", insecure=True, timeout_s=0.2)
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    with pytest.raises(Unreachable, match="no router at"):
        Vehicle.connect("uav1", router="tcp/no-such-host.invalid:7447", timeout_s=0.2)
