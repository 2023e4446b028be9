"""Starting PX4, and a child process as a link, with programs that stand in for PX4."""

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from jezero.base.config import ConfigError
from jezero.base.vehicle_config import BatteryConfig
from jezero.services.autopilot.px4 import command, environment
from jezero.services.autopilot.px4_link import ChildLink

pytestmark = pytest.mark.process

CONNECTS = """
import os, signal, socket, subprocess, sys
print("folder", os.getcwd(), os.listdir(), flush=True)
server = socket.create_connection(("127.0.0.1", PORT))
helper = subprocess.Popen(["sleep", "60"])
print("connected", helper.pid, flush=True)
signal.pause()
"""
DEADLINE_S = 5.0


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


def child(program: str, server: socket.socket, folder: Path | None) -> ChildLink:
    """A link to a Python program; PORT in it is the server's."""
    port = server.getsockname()[1]
    return ChildLink("PX4", [sys.executable, "-c", program.replace("PORT", str(port))], {}, folder, port)


def poll_until(link: ChildLink, holds: Callable[[str], bool]) -> str:
    """Poll until it holds of all that was printed."""
    printed = ""
    deadline_s = time.monotonic() + DEADLINE_S
    while not holds(printed):
        assert time.monotonic() < deadline_s, printed
        printed += link.poll(time.monotonic_ns()).decode()
        time.sleep(0.01)
    return printed


def exists(process_id: int) -> bool:
    """Whether a process runs; one that is dead and only waits to be reaped doesn't."""
    try:
        stat = Path(f"/proc/{process_id}/stat").read_text()
    except FileNotFoundError:
        return False
    return stat.rsplit(")", 1)[1].split()[0] not in "ZX"


def test_the_link_is_up_while_the_program_is_connected_and_takes_its_whole_group_with_it(
    server: socket.socket, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    folder = tmp_path / "px4"
    folder.mkdir()
    (folder / "of the last run").touch()
    link = child(CONNECTS, server, folder)
    link.start()
    printed = poll_until(link, lambda text: link.up and "connected" in text)
    assert f"folder {folder} []" in printed
    assert link.connections == 1
    helper = int(printed.split()[-1])
    assert exists(helper)
    begin_s = time.monotonic()
    link.close()
    assert time.monotonic() - begin_s < 1.0
    deadline_s = time.monotonic() + 2.0
    while exists(helper):
        assert time.monotonic() < deadline_s, "the program's helper outlives it"
        time.sleep(0.01)
    assert capfdbinary.readouterr().out.decode() == printed


def test_a_lost_connection_is_an_error(server: socket.socket) -> None:
    link = child(CONNECTS, server, None)
    link.start()
    try:
        poll_until(link, lambda _: link.up)
        server.accept()[0].close()
        with pytest.raises(ConnectionAbortedError, match="PX4 lost its connection to port"):
            poll_until(link, lambda _: False)
    finally:
        link.close()


@pytest.mark.parametrize(
    ("program", "how"), [("raise SystemExit(7)", "exit code 7"), ("import os; os.abort()", "signal 6")]
)
def test_a_program_that_ends_by_itself_is_an_error(server: socket.socket, program: str, how: str) -> None:
    link = child(program, server, None)
    link.start()
    try:
        with pytest.raises(ChildProcessError, match=f"PX4 ended by itself with {how}"):
            poll_until(link, lambda _: False)
    finally:
        link.close()


def test_a_program_that_is_stopped_is_an_error_and_one_that_goes_on_after_a_moment_is_not(
    server: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jezero.services.autopilot.px4_link.CHECK_PERIOD_NS", 20_000_000)
    link = child("import os, time; print(os.getpid(), flush=True); time.sleep(60)", server, None)
    link.start()
    try:
        pid = int(poll_until(link, lambda text: text.endswith("\n")))
        os.kill(pid, signal.SIGSTOP)
        poll_until(link, lambda _: link._stopped_checks == 3)
        os.kill(pid, signal.SIGCONT)
        poll_until(link, lambda _: link._stopped_checks == 0)
        os.kill(pid, signal.SIGSTOP)
        with pytest.raises(ChildProcessError, match="PX4 is frozen: stopped by a signal"):
            poll_until(link, lambda _: False)
    finally:
        link.close()


def test_the_program_starts_when_the_server_listens(server: socket.socket) -> None:
    link = child("print('started', flush=True)\nimport time; time.sleep(60)", server, None)
    port = server.getsockname()[1]
    server.close()
    link.start()
    try:
        assert link.poll(time.monotonic_ns()) == b"" and not link.sockets()
        with socket.create_server(("127.0.0.1", port)) as late:
            poll_until(link, lambda text: "started" in text)
            late.setblocking(False)
            with pytest.raises(BlockingIOError):  # looking has not connected
                late.accept()
    finally:
        link.close()


def test_a_temporary_folder_is_removed(server: socket.socket) -> None:
    link = child("import os; print(os.getcwd(), flush=True)\nimport time; time.sleep(60)", server, None)
    link.start()
    folder = Path(poll_until(link, lambda text: text.endswith("\n")).strip())
    assert folder.is_dir()
    link.close()
    assert not folder.exists()


def test_the_simulated_battery_lasts_as_long_as_the_vehicles_in_a_hover() -> None:
    battery = BatteryConfig(capacity_mah=9000.0, electronics_a=1.0, hover_a=26.0)
    assert environment(battery)["PX4_BATTERY_S"] == "1200"


def test_what_is_wrong_with_the_runtime_is_told_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="JEZERO_PX4_DIR is not set"):
        command(None, 0)
    with pytest.raises(ConfigError, match="has no bin/px4 or no etc/"):
        command(tmp_path, 0)
    (tmp_path / "bin").mkdir()
    (tmp_path / "etc").mkdir()
    (tmp_path / "bin" / "px4").touch()
    started = command(tmp_path, 9)
    assert started[:3] == (str(tmp_path / "bin" / "px4"), "-i", "9")
    assert Path(started[-1]).is_file()
    with pytest.raises(ConfigError, match="JEZERO_INSTANCE is 10: with PX4 it is 9 at most"):
        command(tmp_path, 10)
