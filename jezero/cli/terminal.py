"""What a command prints, the keys that it reads, and the exit code with which it ends."""

import json
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Any, NoReturn, Self

import click

from jezero.base.router_address import insecurity

if TYPE_CHECKING:
    from rich.progress import Progress

    from jezero.client import Vehicle

# Exit codes; 0 is success.
FAILED = 1
"""Any other failure."""
USAGE = 2
"""Wrong use of the command line; click's own code."""
REFUSED = 3
"""The vehicle refused, or a stack runs already; the reason is printed."""
ABORTED = 4
"""Accepted, then canceled or aborted."""
UNREACHABLE = 5
"""No reply: the stack does not run, or the connection to it is lost."""
INCOMPLETE = 6
"""The mission has ended, and some of its steps were left out."""
PLAIN_PERIOD_S = 1.0


class Printer:
    """Prints events as text with a progress bar on a terminal, as plain lines into a pipe, or as JSON lines."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self._bar: Progress | None = None
        self._printed_s = -PLAIN_PERIOD_S
        self._warned: set[str] = set()

    def event(self, kind: str, text: str, **fields: Any) -> None:
        """Print one event: `text` for people, or `fields` as JSON."""
        self._end_bar()
        click.echo(json.dumps({"type": kind, **fields}) if self.as_json else text)

    def warn(self, text: str) -> None:
        """Print a warning for people, once; programs find it in the events. "" is none."""
        if text and not self.as_json and text not in self._warned:
            self._end_bar()
            self._warned.add(text)
            click.echo(f"warning: {text}", err=True)

    def hint(self, text: str) -> None:
        """Print a line for the person at the terminal."""
        if not self.as_json and sys.stdout.isatty():
            click.secho(text, dim=True)

    def progress(self, text: str, done: float | None, **fields: Any) -> None:
        """Print feedback: a bar on a terminal, a line per second into a pipe. `done` is a fraction from 0 to 1."""
        if self.as_json:
            click.echo(json.dumps({"type": "feedback", **fields}))
        elif sys.stdout.isatty():
            self._draw(text, done)
        elif time.monotonic() - self._printed_s >= PLAIN_PERIOD_S:
            self._printed_s = time.monotonic()
            click.echo(text)

    def fail(self, kind: str, text: str, exit_code: int, **fields: Any) -> NoReturn:
        """End the command with JSON on standard output, a sentence on standard error, and an exit code."""
        self._end_bar()
        if self.as_json:
            click.echo(json.dumps({"type": kind, **fields}))
        click.echo(text, err=True)
        raise SystemExit(exit_code)

    def _draw(self, text: str, done: float | None) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        if self._bar is None:
            self._bar = Progress(BarColumn(24), TextColumn("{task.description}"), transient=True)
            self._bar.start()
            self._bar.add_task(text, total=None)
        self._bar.update(self._bar.task_ids[0], description=text, completed=done or 0.0, total=done and 1.0)

    def _end_bar(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


def print_table(rows: Sequence[tuple[str, ...]]) -> None:
    """Print rows whose columns are as wide as their longest cell; the first row has the titles."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        click.echo("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())


@contextmanager
def connected(vehicle: str, router: str, printer: Printer) -> Iterator["Vehicle"]:
    """Connect for one command; an error of the client becomes a sentence and an exit code."""
    from jezero.client import Aborted, Canceled, JezeroError, Refused, Unreachable, Vehicle

    try:
        with Vehicle.connect(vehicle, router=router, insecure=True) as uav:  # `Router` has checked it
            printer.warn(insecurity(router))
            yield uav
    except Refused as error:
        printer.fail("rejected", f"refused: {error}", REFUSED, reason=str(error), code=error.code)
    except Canceled as error:
        printer.fail("result", f"canceled: {error}", ABORTED, outcome="canceled", reason=str(error))
    except Aborted as error:
        printer.fail("result", f"aborted: {error}", ABORTED, outcome="aborted", reason=str(error))
    except KeyboardInterrupt:
        printer.fail("interrupted", "interrupted", ABORTED, reason="interrupted")
    except JezeroError as error:
        if isinstance(error, Unreachable) and not printer.as_json:
            _show_stacks_elsewhere(vehicle, router)
        printer.fail("unreachable", f"unreachable: {error}", UNREACHABLE, reason=str(error))


def _show_stacks_elsewhere(vehicle: str, router: str) -> None:
    """Print a line for each stack of this computer that has another name or another address than was asked for."""
    from jezero.deploy.launcher.state import running_stacks

    for folder, state in running_stacks():
        if (state.vehicle, state.router) != (vehicle, router):
            options = f"--vehicle {state.vehicle} --router {state.router}"
            click.echo(f"vehicle {state.vehicle} runs in {folder}: add {options}", err=True)


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
