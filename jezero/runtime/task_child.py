"""`python -m jezero.runtime.task_child`: executes the background tasks of one service, see `task_runner`.

Frames on standard input and output are a length of 8 bytes and a pickle: a function in, an `Outcome` out. What a task
prints goes to standard error, which is the service's log.
"""

import os
import queue
import signal
import sys
import threading
from typing import BinaryIO

from jezero.runtime.task import execute

LENGTH_BYTES = 8


def main() -> None:
    """Execute tasks until standard input is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C is for the service, which then closes the pipe
    outcomes = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read_tasks, args=(tasks,), daemon=True).start()
    while True:
        write_frame(outcomes, execute(tasks.get()))


def _read_tasks(tasks: queue.SimpleQueue[bytes]) -> None:
    """Queue the tasks. The end of the service ends this process at once, also in the midst of a task."""
    while (frame := read_frame(sys.stdin.buffer)) is not None:
        tasks.put(frame)
    os._exit(0)


def write_frame(pipe: BinaryIO, data: bytes) -> None:
    """Write one frame.

    Raises:
        OSError: the other end is closed.
    """
    pipe.write(len(data).to_bytes(LENGTH_BYTES, "little"))
    pipe.write(data)
    pipe.flush()


def read_frame(pipe: BinaryIO) -> bytes | None:
    """Read one frame; None when the other end is closed."""
    head = pipe.read(LENGTH_BYTES)
    if len(head) < LENGTH_BYTES:
        return None
    length = int.from_bytes(head, "little")
    data = pipe.read(length)
    return data if len(data) == length else None


if __name__ == "__main__":
    main()
