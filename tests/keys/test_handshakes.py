"""Why a handshake of TLS failed is said in words on both sides: real routers, and each way to fail that is known."""

import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh

from jezero import Unreachable, Vehicle
from jezero.base.zenoh_client import client_config
from jezero.keys.bundle import secured
from jezero.keys.diagnosis import connection_problem
from jezero.keys.team import Team
from tests.keys.rig import add_at, make_team, router
from tests.keys.strange_certificates import SERVER, strange_bundle
from tests.runtime.computers import computer

pytestmark = pytest.mark.process

LATEST_S = 30.0


@dataclass
class RouterProcess:
    """The process of a vehicle's router with its log, and somebody who fails to connect to it."""

    team: Team
    port: int
    log: Path
    folder: Path

    @property
    def address(self) -> str:
        return f"tls/127.0.0.1:{self.port}"

    def await_line(self, words: str) -> None:
        """Wait until the log has a line that a connection was refused, and why."""
        line = f"gate: a connection was refused: {words}\n"
        deadline_s = time.monotonic() + LATEST_S
        while line not in self.log.read_text():
            assert time.monotonic() < deadline_s, f"no {line!r} in {self.log.read_text()}"
            time.sleep(0.05)

    def send(self, data: bytes, *, reset: bool = False) -> None:
        """Send bytes, and end the connection when the router has replied to them."""
        with socket.create_connection(("127.0.0.1", self.port), LATEST_S) as link:
            link.sendall(data)
            if reset:
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            elif data:
                with suppress(OSError):
                    link.recv(1)

    def speak_tls(
        self, bundle: Path, change: Callable[[ssl.SSLContext], None] = lambda _: None, host: str = "127.0.0.1"
    ) -> None:
        """Shake hands as Python's own TLS does, with a bundle and other settings."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.load_verify_locations(bundle / "ca.pem")
        context.load_cert_chain(bundle / "certificate.pem", bundle / "key.pem")
        change(context)
        with (
            suppress(OSError),
            socket.create_connection(("127.0.0.1", self.port), LATEST_S) as link,
            context.wrap_socket(link, server_hostname=host) as secured_link,
        ):
            secured_link.recv(1)

    def connect(self, endpoint: str) -> None:
        """Try to connect as Zenoh does."""
        with suppress(zenoh.ZError):
            zenoh.open(client_config(endpoint, 0.5)).close()  # type: ignore[no-untyped-call]


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RouterProcess]:
    folder = tmp_path_factory.mktemp("router")
    team = make_team(folder / "team")
    add_at(team, -400, "pilot", "past")  # before the router starts, which begins anew when its list changes
    add_at(team, 5, "pilot", "future")
    with computer(team, folder) as vehicle:
        address, log = vehicle.address, vehicle.log
        Vehicle.connect("uav1", router=address, keys=team.bundle("pilot-ana"), timeout_s=LATEST_S).close()
        yield RouterProcess(team, int(address.rpartition(":")[2]), log, folder)


def test_a_client_without_a_certificate(process: RouterProcess) -> None:
    authority = process.team.bundle("pilot-ana") / "ca.pem"
    process.connect(f"{process.address}#root_ca_certificate_file={authority}")
    process.await_line("it shows no certificate")


def test_certificates_that_no_member_has(process: RouterProcess, tmp_path: Path) -> None:
    made = (
        ({"uses": (SERVER,)}, "its certificate is not that of a member who connects to routers"),
        ({"is_authority": True}, "it shows the certificate of an authority in the place of its own"),
        ({"has_unknown_extension": True}, "its certificate is none that `jezero keys` makes"),
    )
    for number, (strange, words) in enumerate(made):
        process.speak_tls(strange_bundle(process.team, tmp_path / str(number), **strange))  # type: ignore[arg-type]
        process.await_line(words)


def test_certificates_of_another_time_or_team(process: RouterProcess, tmp_path: Path) -> None:
    process.speak_tls(process.team.bundle("pilot-past"))
    process.await_line("its certificate has expired")
    process.speak_tls(process.team.bundle("pilot-future"))
    process.await_line("its certificate is not valid yet, or this computer's clock is behind")
    process.connect(secured(process.address, make_team(tmp_path / "others").bundle("pilot-ana")))
    process.await_line("its bundle is another team's")


def test_a_client_that_uses_another_address(process: RouterProcess) -> None:
    process.speak_tls(process.team.bundle("pilot-ana"), host="127.0.0.3")
    process.await_line("it uses an address that is not in this computer's certificate")


def test_an_older_tls(process: RouterProcess) -> None:
    def older(context: ssl.SSLContext) -> None:
        context.maximum_version = ssl.TLSVersion.TLSv1_2

    process.speak_tls(process.team.bundle("pilot-ana"), older)
    process.await_line("it has no TLS 1.3")


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x10\x00\x01\x02",
        b"\x16\x03\x01\xff\xff" + bytes(66_000),
        b"\x16\x03\x01\x00\x00",
        b"\x16\x03\x03\x00\x04\x63\x00\x00\x00",
        b"\x17\x03\x03\x00\x04abcd",
    ],
)
def test_what_is_no_tls(process: RouterProcess, data: bytes) -> None:
    process.send(data)
    process.await_line("it speaks no TLS")


def test_who_goes_away_early_or_falls_silent(process: RouterProcess) -> None:
    with socket.create_connection(("127.0.0.1", process.port)):
        process.send(b"")
        process.send(b"\x16", reset=True)
        process.await_line("it went away before it showed a certificate")
        process.await_line("it began TLS, and fell silent")


@pytest.mark.parametrize(
    ("alert", "words"),
    [
        (42, "it uses an address that is not in this computer's certificate"),
        (43, "it takes this computer's certificate for none of a router"),
        (45, "it takes this computer's certificate for expired: renew it, or its clock is wrong"),
        (46, "it doesn't take this computer's certificate"),
        (48, "its bundle is another team's, or it has none"),
        (70, "it has no TLS 1.3"),
    ],
)
def test_the_alerts_of_a_client_that_does_not_take_the_router(process: RouterProcess, alert: int, words: str) -> None:
    process.send(b"\x15\x03\x03\x00\x02\x02" + bytes([alert]))
    process.await_line(words)


def test_no_reason_of_all_these_is_in_the_words_of_the_tls_library(process: RouterProcess) -> None:
    process.speak_tls(process.team.bundle("pilot-past"))
    process.await_line("its certificate has expired")
    raw = ("peer", "alert", "received", "eof", "os error", "invalid", "Hint")
    lines = [line for line in process.log.read_text().splitlines() if "a connection was refused" in line]
    assert lines and not [line for line in lines if any(word in line for word in raw)]


# -- the client's side --


@pytest.fixture(scope="module")
def port(process: RouterProcess) -> Iterator[int]:
    with router(process.team.bundle("vehicle-uav1")) as (port, _):
        yield port


@pytest.mark.parametrize(
    ("strange", "words"),
    [
        ({"uses": (SERVER,)}, "it isn't that of a member, who connects to routers"),
        ({"is_authority": True}, "it isn't one that `jezero keys` makes for a member"),
        ({"has_unknown_extension": True}, "it isn't one that `jezero keys` makes for a member"),
    ],
)
def test_a_client_with_a_certificate_that_no_member_has_reads_why(
    process: RouterProcess, port: int, tmp_path: Path, strange: dict[str, object], words: str
) -> None:
    bundle = strange_bundle(process.team, tmp_path / "strange", **strange)  # type: ignore[arg-type]
    with pytest.raises(Unreachable) as caught:
        Vehicle.connect("uav1", router=f"tls/127.0.0.1:{port}", keys=bundle, timeout_s=3.0)
    assert f"refuses the certificate of pilot-ana: {words}. Ask the one who has the team" in str(caught.value)


def test_a_server_with_an_older_tls_is_named(process: RouterProcess) -> None:
    bundle = process.team.bundle("vehicle-uav1")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(bundle / "certificate.pem", bundle / "key.pem")
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    link, _ = server.accept()
                    with link, suppress(OSError):
                        context.wrap_socket(link, server_side=True).close()

        threading.Thread(target=serve, daemon=True).start()
        address = f"tls/127.0.0.1:{server.getsockname()[1]}"
        said = connection_problem(secured(address, process.team.bundle("pilot-ana")))
    assert said == f"what listens at {address} has no TLS 1.3, which Zenoh's routers speak: check the address"
