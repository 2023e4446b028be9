"""A launcher that systemd has started: its notifications, received at a socket as systemd's."""

import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from jezero.deploy.launcher.ports import instance_environment, reserved_instance
from tests.system.conftest import JEZERO

SERVICES = """
services:
  first: {command: sleep 1000}
  second: {command: sh -c 'echo "address=$$NOTIFY_SOCKET" > VARIABLES; exec sleep 1000', depends_on: [first]}
"""
WATCHDOG_S = 2.0
START_TIMEOUT_S = 60.0


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket at which systemd would receive."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.settimeout(START_TIMEOUT_S)
        yield receiver


@pytest.fixture
def launcher(tmp_path: Path, systemd: socket.socket) -> Iterator["subprocess.Popen[bytes]"]:
    """A launcher in the foreground, with systemd's variables."""
    file = tmp_path / "compose.yaml"
    file.write_text(SERVICES.replace("VARIABLES", str(tmp_path / "variables")))
    with reserved_instance(vehicle=f"s{os.getpid()}") as instance:
        environment = {
            **os.environ,
            **instance_environment(instance),
            "JEZERO_RUN_DIR": str(tmp_path / "run"),
            "NOTIFY_SOCKET": systemd.getsockname(),
            "WATCHDOG_USEC": str(int(1e6 * WATCHDOG_S)),
        }
        process = subprocess.Popen(
            [*JEZERO, "up", "-f", str(file)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        yield process
        process.send_signal(signal.SIGCONT)
        process.terminate()
        process.communicate(timeout=60.0)


def lines_until(systemd: socket.socket, wanted: str) -> list[str]:
    """What arrives until a line, with that line."""
    lines: list[str] = []
    while wanted not in lines:
        lines += systemd.recv(4096).decode().splitlines()
    return lines


def test_ready_follows_the_start_of_all_services_and_the_watchdog_stops_with_a_frozen_launcher(
    systemd: socket.socket, launcher: "subprocess.Popen[bytes]", tmp_path: Path
) -> None:
    assert lines_until(systemd, "READY=1").count("READY=1") == 1
    systemd.settimeout(WATCHDOG_S)  # after which systemd would kill it
    for _ in range(3):
        assert "READY=1" not in lines_until(systemd, "WATCHDOG=1")
    assert (tmp_path / "variables").read_text() == "address=\n", "systemd's variables are the launcher's alone"

    launcher.send_signal(signal.SIGSTOP)
    while "State:\tT" not in Path(f"/proc/{launcher.pid}/status").read_text():
        pass
    systemd.setblocking(False)
    with pytest.raises(BlockingIOError):
        while True:
            systemd.recv(4096)
    systemd.settimeout(WATCHDOG_S)
    with pytest.raises(TimeoutError):
        systemd.recv(4096)
    launcher.send_signal(signal.SIGCONT)
    lines_until(systemd, "WATCHDOG=1")

    launcher.terminate()
    assert "STOPPING=1" in lines_until(systemd, "STATUS=stopping") + systemd_rest(systemd)
    launcher.communicate(timeout=60.0)
    assert launcher.returncode == 0


def systemd_rest(systemd: socket.socket) -> list[str]:
    """What has arrived already."""
    systemd.setblocking(False)
    try:
        return systemd.recv(4096).decode().splitlines()
    except BlockingIOError:
        return []
