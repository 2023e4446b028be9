"""Executes functions in a thread beside a service's loop, one after the other: for writing files, not for computing."""

import queue
import threading
from collections.abc import Callable
from typing import Any


class Worker:
    """A thread, started with the first task, that ends with the process.

    Args:
        done: called in the thread after each task with its tag, the function's return value, and its exception.
    """

    def __init__(self, done: Callable[[str, Any, BaseException | None], None]) -> None:
        self._done = done
        self._tasks: queue.SimpleQueue[tuple[Callable[[], Any], str]] = queue.SimpleQueue()
        self._started = False

    def add(self, function: Callable[[], Any], tag: str) -> None:
        """Queue a task; returns at once."""
        self._tasks.put((function, tag))
        if not self._started:
            self._started = True
            threading.Thread(target=self._run, name="worker", daemon=True).start()

    def _run(self) -> None:
        while True:
            function, tag = self._tasks.get()
            try:
                outcome = function()
            except BaseException as error:  # noqa: BLE001 - handed over to the loop, which raises it
                self._done(tag, None, error)
            else:
                self._done(tag, outcome, None)
