"""The notifications that the launcher sends to systemd, and their times."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from jezero.deploy.launcher.systemd import SystemdNotifier


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.setblocking(False)
        yield receiver


def environment(systemd: socket.socket, pid: int | None = None) -> dict[str, str]:
    pid = os.getpid() if pid is None else pid
    address = systemd.getsockname()
    return {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "10000000", "WATCHDOG_PID": str(pid), "PATH": "/bin"}


def received(systemd: socket.socket) -> list[str]:
    try:
        return systemd.recv(4096).decode().splitlines()
    except BlockingIOError:
        return []


def test_readiness_is_sent_once_the_status_when_it_changes_and_the_watchdog_twice_in_its_time(
    systemd: socket.socket,
) -> None:
    variables = environment(systemd)
    notifier = SystemdNotifier(variables)
    assert variables == {"PATH": "/bin"}
    sent = []
    for now_s, status, started in [
        (100.0, "no telemetry", False),
        (101.0, "no telemetry", True),
        (104.9, "ready\nx", True),
        (105.0, "ready\nx", True),
    ]:
        notifier.update(now_s, status, started=started, stopping=False)
        sent.append(received(systemd))
    assert sent == [["STATUS=no telemetry", "WATCHDOG=1"], ["READY=1"], ["STATUS=ready"], ["WATCHDOG=1"]]
    assert notifier.due_s == 110.0
    notifier.close()


def test_no_watchdog_runs_for_another_process_and_nothing_is_sent_without_systemd(systemd: socket.socket) -> None:
    notifier = SystemdNotifier(environment(systemd, pid=1))
    assert notifier.due_s is None
    notifier.update(1.0, "", started=True, stopping=False)
    assert received(systemd) == ["READY=1"]
    notifier.close()
    alone = SystemdNotifier({})
    alone.update(1.0, "ready", started=True, stopping=False)
    assert alone.due_s is None


def test_an_end_of_systemds_socket_ends_nothing(systemd: socket.socket) -> None:
    notifier = SystemdNotifier(environment(systemd))
    os.unlink(systemd.getsockname())
    notifier.update(1.0, "ready", started=True, stopping=False)
    notifier.close()
