"""Background tasks in a process of their own: their values, their failures, and their end at any time."""

import math
import os
import queue
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from jezero.runtime import task_runner
from jezero.runtime.task import TaskOutcome
from jezero.runtime.task_runner import TaskRunner

DEADLINE_S = 20.0


class Tasks:
    """A runner with the outcomes of its tasks."""

    def __init__(self) -> None:
        self.outcomes: queue.SimpleQueue[tuple[str, TaskOutcome]] = queue.SimpleQueue()
        self.runner = TaskRunner(lambda tag, outcome: self.outcomes.put((tag, outcome)))

    def outcome(self, function: Callable[[], Any]) -> TaskOutcome:
        self.runner.add(function, "task")
        return self.outcomes.get(timeout=DEADLINE_S)[1]


@pytest.fixture
def tasks() -> Iterator[Tasks]:
    made = Tasks()
    yield made
    made.runner._end_process()


def wait_for_pid(file: Path) -> int:
    """Id of the process whose task has written it."""
    deadline_s = time.monotonic() + DEADLINE_S
    while not (file.exists() and file.read_text()):
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
    return int(file.read_text())


def announce_and_hang(file: Path) -> None:
    """A task that writes its process's id and never ends."""
    file.write_text(str(os.getpid()))
    sum(range(10**12))


def test_tasks_are_executed_one_after_the_other_in_one_other_process(tasks: Tasks) -> None:
    tasks.runner.add(os.getpid, "first")
    tasks.runner.add(partial(math.sqrt, 9.0), "second")
    tasks.runner.add(os.getpid, "third")
    outcomes = [tasks.outcomes.get(timeout=DEADLINE_S) for _ in range(3)]
    assert [tag for tag, _ in outcomes] == ["first", "second", "third"]
    assert outcomes[1][1] == TaskOutcome(3.0)
    assert outcomes[0][1] == outcomes[2][1]
    assert outcomes[0][1].value != os.getpid()


def test_what_a_task_raises_is_its_error(tasks: Tasks, capfd: pytest.CaptureFixture[str]) -> None:
    assert str(tasks.outcome(partial(math.sqrt, -1.0)).error).startswith("ValueError: ")
    assert "Traceback" in capfd.readouterr().err
    assert tasks.outcome(partial(math.sqrt, 4.0)).value == 2.0


def test_what_a_task_prints_does_not_disturb_its_value(tasks: Tasks) -> None:
    assert tasks.outcome(partial(print, "hello")) == TaskOutcome(None)


@pytest.mark.parametrize(
    "function", [lambda: 1, partial(next, (number for number in (1, 2)))], ids=["lambda", "generator"]
)
def test_a_function_that_can_not_be_pickled_is_an_error(tasks: Tasks, function: Callable[[], Any]) -> None:
    assert "can't be sent to a process of its own" in str(tasks.outcome(function).error)


def test_a_value_that_can_not_be_pickled_is_an_error(tasks: Tasks) -> None:
    assert "pickle" in str(tasks.outcome(partial(open, os.devnull)).error)


def test_a_task_whose_process_is_killed_has_an_error_and_the_next_one_a_new_process(
    tasks: Tasks, tmp_path: Path
) -> None:
    tasks.runner.add(partial(announce_and_hang, tmp_path / "pid"), "killed")
    os.kill(wait_for_pid(tmp_path / "pid"), signal.SIGKILL)
    assert tasks.outcomes.get(timeout=DEADLINE_S) == ("killed", TaskOutcome(None, "its process ended with SIGKILL"))
    assert tasks.outcome(partial(math.sqrt, 4.0)).value == 2.0


def test_a_cancel_ends_a_task_at_once_even_if_it_keeps_the_interpreter(tasks: Tasks, tmp_path: Path) -> None:
    tasks.runner.add(partial(announce_and_hang, tmp_path / "pid"), "running")
    tasks.runner.add(os.getpid, "waiting")
    pid = wait_for_pid(tmp_path / "pid")
    tasks.runner.cancel("waiting")
    canceled_s = time.monotonic()
    tasks.runner.cancel("running")
    assert tasks.outcomes.get(timeout=DEADLINE_S) == ("running", TaskOutcome(None, "canceled"))
    assert time.monotonic() - canceled_s < 1.0
    assert tasks.outcomes.get(timeout=DEADLINE_S) == ("waiting", TaskOutcome(None, "canceled"))
    assert not Path(f"/proc/{pid}").exists()
    tasks.runner.cancel("running")
    assert tasks.outcome(partial(math.sqrt, 4.0)).value == 2.0


def test_a_process_that_has_nothing_to_do_ends(tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task_runner, "IDLE_MAX_S", 0.1)
    pid = tasks.outcome(os.getpid).value
    deadline_s = time.monotonic() + DEADLINE_S
    while Path(f"/proc/{pid}").exists():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    assert tasks.outcome(os.getpid).value != pid
