"""The router of a computer's own programs: who may reach it as what, and how large messages may be."""

import os
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from jezero.base.config import ConfigError
from jezero.base.zenoh_client import client_config
from jezero.runtime.instance import PATH_MAX_BYTES, PREFIX, service_instance, socket_of
from jezero.runtime.routing import SIZE_MAX_BYTES, bus_of_router, open_router
from jezero.schemas.topics import CAMERA, HOVER, STATUS, TAKEOFF, feedback_of, key
from tests.client.rig import free_endpoint

pytestmark = pytest.mark.process

VEHICLE = "uav1"
LATEST_S = 20.0
BLOCK = zenoh.CongestionControl.BLOCK


@pytest.fixture
def sessions(tmp_path: Path) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Two services at a router."""
    bus = socket_of(tmp_path)
    with (
        open_router(free_endpoint(), bus),
        zenoh.open(client_config(bus, LATEST_S)) as one,
        zenoh.open(client_config(bus, LATEST_S)) as other,
    ):
        yield one, other


@pytest.mark.parametrize(
    ("topic", "passes"), [(STATUS.name, False), (feedback_of(TAKEOFF).name, False), (CAMERA.name, True)]
)
def test_a_message_larger_than_any_of_the_contract_is_dropped(
    sessions: tuple[zenoh.Session, zenoh.Session], topic: str, passes: bool
) -> None:
    reader, writer = sessions
    sizes: list[int] = []
    subscriber = reader.declare_subscriber(key(VEHICLE, topic), lambda sample: sizes.append(len(sample.payload)))
    expected = {SIZE_MAX_BYTES - 1000, *((SIZE_MAX_BYTES + 2_000_000,) if passes else ())}
    deadline_s = time.monotonic() + LATEST_S
    while not expected <= set(sizes) and time.monotonic() < deadline_s:  # a busy machine takes too long for some
        for size in (SIZE_MAX_BYTES + 2_000_000, SIZE_MAX_BYTES - 1000):
            writer.put(key(VEHICLE, topic), bytes(size), congestion_control=BLOCK)
        time.sleep(0.3)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert set(sizes) == expected


@pytest.mark.parametrize("endpoint", [HOVER.name, TAKEOFF.endpoint.name])
def test_a_request_larger_than_any_of_the_contract_is_dropped(
    sessions: tuple[zenoh.Session, zenoh.Session], endpoint: str
) -> None:
    server, client = sessions

    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, "y")

    queryable = server.declare_queryable(key(VEHICLE, endpoint), reply, complete=True)
    time.sleep(0.2)
    answered = [
        any(reply.ok for reply in client.get(key(VEHICLE, endpoint), payload=bytes(size), timeout=2.0))
        for size in (1000, SIZE_MAX_BYTES + 2_000_000)
    ]
    queryable.undeclare()  # type: ignore[no-untyped-call]
    assert answered == [True, False]


def path_of(endpoint: str) -> Path:
    return Path(endpoint.removeprefix(PREFIX))


@pytest.mark.parametrize("name", ["run", "a" * 150, "ein Ordner mit Ä", "what?#;"])
def test_the_socket_of_every_run_folder_is_short_private_and_its_own(tmp_path: Path, name: str) -> None:
    folders = [tmp_path / name, tmp_path / f"{name}2"]
    sockets = [socket_of(folder) for folder in folders]
    assert sockets == [socket_of(folder) for folder in folders] and sockets[0] != sockets[1]
    assert all(len(os.fsencode(path_of(bus))) <= PATH_MAX_BYTES for bus in sockets)
    with open_router(free_endpoint(), sockets[0]), zenoh.open(client_config(sockets[0], LATEST_S)) as service:
        assert list(service.info.routers_zid())
        assert stat.S_IMODE(path_of(sockets[0]).parent.stat().st_mode) == 0o700 or name == "run"
        with pytest.raises(zenoh.ZError):
            zenoh.open(client_config(sockets[1], 0.3))


CONNECT = """
import os, socket, sys
os.setuid(int(sys.argv[1]))
socket.socket(socket.AF_UNIX).connect(sys.argv[2])
"""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_another_user_of_the_computer_cannot_be_a_service() -> None:
    """Run the router as a process, in a folder that everybody may enter, and connect as another user."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        address = free_endpoint()
        environment = {**os.environ, "JEZERO_ROUTER": address, "JEZERO_RUN_DIR": name}
        router = subprocess.Popen([sys.executable, "-m", "jezero.runtime.router"], env=environment)
        try:
            with zenoh.open(client_config(address, 20.0)):
                own, others = (
                    subprocess.run(
                        [sys.executable, "-c", CONNECT, user, str(path_of(socket_of(Path(name))))],
                        capture_output=True,
                        text=True,
                        check=False,
                    )
                    for user in ("0", "65534")
                )
        finally:
            router.terminate()
            router.wait(10.0)
    assert own.returncode == 0
    assert "PermissionError" in others.stderr


def test_the_socket_of_a_router_that_runs_is_found_by_its_address(tmp_path: Path) -> None:
    address, bus = free_endpoint(), socket_of(tmp_path)
    assert bus_of_router(address) == ""
    with open_router(address, bus):
        assert bus_of_router(address) == bus
    assert bus_of_router("tcp/192.0.2.1:7447") == ""
    assert bus_of_router(bus) == bus


def test_a_service_that_is_given_the_address_for_people_says_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JEZERO_RUN_DIR", str(tmp_path))
    monkeypatch.delenv("JEZERO_ROUTER", raising=False)
    assert service_instance().router == socket_of(tmp_path)
    monkeypatch.setenv("JEZERO_ROUTER", "tcp/127.0.0.1:7447")
    with pytest.raises(ConfigError, match=r"rights of a pilot.*needs the router's socket, which `jezero up`"):
        service_instance()
