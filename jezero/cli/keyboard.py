"""Single keys from the terminal, without Enter."""

import os
import select
import sys
import termios
import time
import tty
from types import TracebackType
from typing import Any, Self


class Keyboard:
    """Reads keys while a command runs in a terminal; a context manager, which gives the terminal back as it was.

    Ctrl+C still interrupts. Without a terminal, or in the background of one, there are no keys.

    Attributes:
        attached: whether there are keys.
    """

    def __init__(self) -> None:
        self._descriptor = sys.stdin.fileno() if _is_ours() else -1
        self._before: list[Any] = []

    @property
    def attached(self) -> bool:
        return self._descriptor >= 0

    def __enter__(self) -> Self:
        if self.attached:
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.attached:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def read(self, timeout_s: float) -> str:
        """The keys that were pressed, as the terminal sends them; waits for one until the time-out, then "".

        An arrow is an escape sequence, such as "\\x1b[C".
        """
        if not self.attached:
            time.sleep(timeout_s)
            return ""
        if not select.select([self._descriptor], [], [], timeout_s)[0]:
            return ""
        pressed = os.read(self._descriptor, 64)
        if not pressed:  # the terminal is gone
            self._descriptor = -1
        return pressed.decode(errors="replace")


def _is_ours() -> bool:
    """Whether standard input and output are a terminal, and this process is in its foreground."""
    try:
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            return False
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):  # a closed file
        return False
