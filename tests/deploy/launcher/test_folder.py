"""The run folder: one launcher at a time, its state, and the services' logs."""

import fcntl
import io
import os
from pathlib import Path

import pytest

from jezero.deploy.launcher.output import LogReader, Output, Prefixer, stamp
from jezero.deploy.launcher.state import AlreadyUpError, LaunchedService, RunFolder, RunState, start_ticks


class ClosedTerminal(io.StringIO):
    def write(self, text: str) -> int:
        raise BrokenPipeError


def state_of(pid: int, ticks: int) -> RunState:
    return RunState(
        launcher_pid=pid,
        launcher_start_ticks=ticks,
        compose_file="compose.yaml",
        vehicle="uav1",
        router="tcp/127.0.0.1:7447",
        bus="unixsock-stream//run/jezero/bus",
        ready=False,
        not_ready_reason="starting",
        services=(LaunchedService(service="a", state="failed", text="crash loop"),),
    )


def test_what_the_launcher_wrote_is_read_while_it_lives(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.acquire()
    ticks = start_ticks(os.getpid())
    assert ticks is not None
    state = state_of(os.getpid(), ticks)
    folder.write(state)
    assert RunFolder(tmp_path).read() == state
    assert state.failures == ("a: crash loop",)
    folder.write(state_of(os.getpid(), ticks + 1))  # the id of a process that ended, given to another one
    assert folder.read() is None
    folder.release()
    assert folder.read() is None


def test_a_folder_that_was_let_go_of_keeps_the_logs_only_and_is_free(tmp_path: Path) -> None:
    first, second = RunFolder(tmp_path), RunFolder(tmp_path)
    first.acquire()
    first.write(state_of(os.getpid(), start_ticks(os.getpid()) or 0))
    first.release()
    assert [path.name for path in tmp_path.iterdir()] == ["logs"]
    second.acquire()
    with pytest.raises(AlreadyUpError):
        first.acquire()


def test_a_lock_that_its_holder_removes_while_it_is_being_taken_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = RunFolder(tmp_path), RunFolder(tmp_path)
    first.acquire()
    real_flock = fcntl.flock

    def flock_just_after_the_release(descriptor: int, operation: int) -> None:
        monkeypatch.setattr(fcntl, "flock", real_flock)
        first.release()
        real_flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", flock_just_after_the_release)
    second.acquire()
    with pytest.raises(AlreadyUpError):
        RunFolder(tmp_path).acquire()


def test_a_damaged_state_counts_as_none(tmp_path: Path) -> None:
    (tmp_path / "state.json").write_text("{")
    assert RunFolder(tmp_path).read() is None


def test_a_folder_belongs_to_one_launcher(tmp_path: Path) -> None:
    first, second = RunFolder(tmp_path), RunFolder(tmp_path)
    first.acquire()
    first.write(state_of(os.getpid(), start_ticks(os.getpid()) or 0))
    with pytest.raises(AlreadyUpError, match=rf"process {os.getpid()} runs in {tmp_path}"):
        second.acquire()


def test_lines_get_their_service_in_front_and_unfinished_ones_wait(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.logs.mkdir()
    terminal = io.StringIO()
    output = Output(folder, ["a", "long"], terminal)
    output.on_data("a", b"one\ntw")
    output.on_data("long", b"other\r\n")
    output.on_data("a", b"o\n\xff")
    output.on_exit("a")
    output.close()
    assert terminal.getvalue() == "a    | one\nlong | other\na    | two\na    | \ufffd\n"
    assert folder.log_of("long").read_text().endswith("Z other\n")


def test_a_run_keeps_the_log_of_the_one_before(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.logs.mkdir()
    for text in (b"first\n", b"second\n"):
        output = Output(folder, ["a"], None)
        output.on_data("a", text)
        output.close()
    assert "second" in folder.log_of("a").read_text()
    assert "first" in (folder.logs / "a.log.1").read_text()
    assert folder.logged() == ["a"]


def test_a_terminal_that_is_gone_does_not_stop_the_services(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.logs.mkdir()
    output = Output(folder, ["a"], ClosedTerminal())
    output.on_data("a", b"one\ntwo\n")
    output.close()
    assert len(folder.log_of("a").read_text().splitlines()) == 2


def test_logs_are_read_in_order_of_time_and_only_whole_lines(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.logs.mkdir()
    folder.log_of("a").write_text(f"{stamp(1.0)} a1\n{stamp(3.0)} a3\n{stamp(4.0)} unfini")
    folder.log_of("b").write_text(f"{stamp(2.0)} b2\n")
    reader = LogReader(folder, ["a", "b"])
    assert [(name, line.split(" ")[1]) for name, line in reader.read()] == [("a", "a1"), ("b", "b2"), ("a", "a3")]
    assert reader.read() == []
    with folder.log_of("a").open("a") as file:
        file.write("shed\n")
    assert reader.read() == [("a", f"{stamp(4.0)} unfinished")]


def test_colour_is_for_terminals_only() -> None:
    assert Prefixer(["a"], colour=False).line("a", "x") == "a | x"
    assert Prefixer(["a"], colour=True).line("a", "x") == "\x1b[36ma | \x1b[0mx"
    assert stamp(0.0005) == "1970-01-01T00:00:00.000Z"
