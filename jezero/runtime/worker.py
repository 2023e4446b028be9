"""Executes functions in a thread beside a service's loop, one after the other: for writing files, not for computing."""

import queue
import threading
import traceback
from collections.abc import Callable


class Worker:
    """A thread, started with the first task, that ends with the process.

    An exception that a task raises goes to standard error; the next task is executed all the same.
    """

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._started = False

    def add(self, task: Callable[[], object]) -> None:
        """Queue a task; returns at once."""
        self._tasks.put(task)
        if not self._started:
            self._started = True
            threading.Thread(target=self._run, name="worker", daemon=True).start()

    def wait(self) -> None:
        """Wait until all tasks so far have been executed."""
        done = threading.Event()
        self.add(done.set)
        done.wait()

    def _run(self) -> None:
        while True:
            task = self._tasks.get()
            try:
                task()
            except Exception as error:  # noqa: BLE001 - a thread that ends would execute nothing any more
                traceback.print_exception(error)
