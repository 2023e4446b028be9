"""Executes a service's `BackgroundTask`s in a process of its own, one after the other.

A thread would not do: a library that keeps the interpreter for seconds stops the service's loop too, and a task in a
thread can't be ended. A process can be killed at any time, and its death is only the end of its task.

That process is `python -m jezero.runtime.task_runner`. Frames on its standard input and output are a length of 8 bytes
and a pickle: a function in, a `TaskOutcome` out. What a task prints goes to standard error, which is the service's
log.
"""

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO, cast

from jezero.runtime.task import CANCELED, TaskOutcome, execute, pickled, read_outcome

LENGTH_BYTES = 8
IDLE_MAX_S = 60.0
"""A process without a task ends after this time, as it holds a hundred megabytes of libraries. Until then the next task
finds them imported."""


@dataclass(eq=False)
class _Task:
    frame: bytes
    tag: str
    canceled: bool = False


class TaskRunner:
    """A thread that feeds one child process; both start with the first task and end with this process.

    Args:
        done: called after each task with its tag and its outcome; in the thread, unless the task can't be sent.
    """

    def __init__(self, done: Callable[[str, TaskOutcome], None]) -> None:
        self._done = done
        self._tasks: queue.SimpleQueue[_Task] = queue.SimpleQueue()
        self._lock = threading.Lock()
        """Held while tasks or the process change."""
        self._pending: dict[str, _Task] = {}
        """Tasks by tag, from their arrival to their outcome."""
        self._running: _Task | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._started = False

    def add(self, function: Callable[[], Any], tag: str) -> None:
        """Queue a task; returns at once."""
        frame = pickled(function)
        if isinstance(frame, TaskOutcome):
            self._done(tag, frame)
            return
        task = _Task(frame, tag)
        with self._lock:
            self._pending[tag] = task
        self._tasks.put(task)
        if not self._started:
            self._started = True
            threading.Thread(target=self._run, name="tasks", daemon=True).start()

    def cancel(self, tag: str) -> None:
        """End a task that runs, by killing its process, or one that waits; returns at once."""
        with self._lock:
            task = self._pending.get(tag)
            if task is None:
                return
            task.canceled = True
            if task is self._running and self._process is not None:
                self._process.kill()

    # -- the thread --

    def _run(self) -> None:
        while True:
            try:
                task = self._tasks.get(timeout=IDLE_MAX_S)
            except queue.Empty:
                self._end_process()
                task = self._tasks.get()
            outcome = self._execute(task)
            with self._lock:
                self._running = None
                self._pending.pop(task.tag, None)
            self._done(task.tag, outcome)

    def _execute(self, task: _Task) -> TaskOutcome:
        try:
            process = self._begin(task)
        except OSError as error:
            return TaskOutcome(None, f"its process can't be started: {error.strerror or error}")
        if process is None:
            return CANCELED
        frame = None
        with contextlib.suppress(OSError):  # the process was killed before it had read the task
            _write_frame(cast(BinaryIO, process.stdin), task.frame)
            frame = _read_frame(cast(BinaryIO, process.stdout))
        if frame is not None:
            return read_outcome(frame)
        code = self._end_process()
        return CANCELED if task.canceled else TaskOutcome(None, f"its process ended with {_exit_in_words(code)}")

    def _begin(self, task: _Task) -> "subprocess.Popen[bytes] | None":
        """Make the task the present one; returns a living process, or None if the task is canceled already.

        Raises:
            OSError: no process can be started.
        """
        if self._process is not None and self._process.poll() is not None:
            self._end_process()
        with self._lock:
            if task.canceled:
                return None
            self._running = task
            if self._process is None:
                command = [sys.executable, "-m", "jezero.runtime.task_runner"]
                self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            return self._process

    def _end_process(self) -> int:
        """Kill the process, if there is one, and close its pipes; returns its exit code."""
        with self._lock:
            process, self._process = self._process, None
        if process is None:
            return 0
        process.kill()
        code = process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):  # a task that was half written
                    pipe.close()
        return code


def _exit_in_words(code: int) -> str:
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name


# -- the child process -------------------------------------------------------------------------------------


def main() -> None:
    """The child process: execute tasks until standard input is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C is for the service, which then closes the pipe
    outcomes = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read_tasks, args=(tasks,), daemon=True).start()
    while True:
        _write_frame(outcomes, execute(tasks.get()))


def _read_tasks(tasks: queue.SimpleQueue[bytes]) -> None:
    """Queue the tasks. The end of the service ends this process at once, also in the midst of a task."""
    while (frame := _read_frame(sys.stdin.buffer)) is not None:
        tasks.put(frame)
    os._exit(0)


def _write_frame(pipe: BinaryIO, data: bytes) -> None:
    """Write one frame.

    Raises:
        OSError: the other end is closed.
    """
    pipe.write(len(data).to_bytes(LENGTH_BYTES, "little"))
    pipe.write(data)
    pipe.flush()


def _read_frame(pipe: BinaryIO) -> bytes | None:
    """Read one frame; None when the other end is closed."""
    head = pipe.read(LENGTH_BYTES)
    if len(head) < LENGTH_BYTES:
        return None
    length = int.from_bytes(head, "little")
    data = pipe.read(length)
    return data if len(data) == length else None


if __name__ == "__main__":
    main()
