"""Processes that fly side by side leave nothing behind."""

import os
import signal
import tempfile
from pathlib import Path

import pytest

from jezero.trials.workers import workers


def leave_a_file(name: str) -> str:
    folder = Path(tempfile.mkdtemp(prefix="jezero-"))
    (folder / name).write_text("left")
    return str(folder)


def interrupt_oneself() -> str:
    os.kill(os.getpid(), signal.SIGINT)
    return "done"


def test_what_they_leave_in_temporary_folders_goes_with_them() -> None:
    with workers(2) as pool:
        left = [Path(folder) for folder in pool.map(leave_a_file, ("a", "b", "c"))]
        assert all(folder.is_dir() for folder in left)
    assert not any(folder.exists() or folder.parent.exists() for folder in left)


def test_they_go_when_the_one_who_waits_for_them_is_interrupted() -> None:
    with pytest.raises(KeyboardInterrupt), workers(1) as pool:
        left = Path(pool.apply(leave_a_file, ("a",)))
        raise KeyboardInterrupt
    assert not left.parent.exists()


def test_they_go_when_the_one_who_waits_for_them_is_told_to_end() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit, match=str(128 + signal.SIGTERM)), workers(1) as pool:
        left = Path(pool.apply(leave_a_file, ("a",)))
        os.kill(os.getpid(), signal.SIGTERM)
        pool.apply(leave_a_file, ("b",))
    assert not left.parent.exists()
    assert signal.getsignal(signal.SIGTERM) == before


def test_an_interrupt_of_a_terminal_does_not_end_their_work() -> None:
    with workers(1) as pool:
        assert pool.apply(interrupt_oneself) == "done"
