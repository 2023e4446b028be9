"""What a process does with its children. Needs Linux."""

import ctypes
import os
import signal
from collections.abc import Callable
from pathlib import Path

PR_SET_PDEATHSIG = 1

_libc = ctypes.CDLL(None, use_errno=True)


def die_with(parent_pid: int) -> Callable[[], None]:
    """Function that a child calls before its command starts, so that it is killed when its parent ends.

    The kernel sends SIGKILL when the *thread* that forked ends, so children must be forked by the main thread. If the
    parent has died before the call, the parent's id has changed.
    """

    def before_exec() -> None:
        if _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0 or os.getppid() != parent_pid:
            os._exit(127)

    return before_exec


def is_stopped(pid: int) -> bool:
    """Whether a child is stopped by a signal; a debugger's stop doesn't count. Source: proc(5)."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"
