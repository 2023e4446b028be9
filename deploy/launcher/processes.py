"""Child processes that die with the launcher, and the rule for their restart."""

import contextlib
import os
import signal
import subprocess
import sys
from collections import deque
from dataclasses import dataclass, field
from typing import IO

from jezero.deploy.launcher.compose import ComposeService
from jezero.runtime.linux_processes import die_with

BACK_OFF_MIN_S = 0.2
BACK_OFF_MAX_S = 5.0
CRASH_LOOP_TRIES = 5
CRASH_LOOP_WINDOW_S = 60.0


class SpawnError(RuntimeError):
    """A command can't be run; the message says which and why."""


@dataclass
class Child:
    """A running process.

    Attributes:
        process: the process.
        pidfd: file descriptor that is readable when the process has ended.
        output: its standard output and error, non-blocking.
    """

    process: subprocess.Popen[bytes]
    pidfd: int
    output: IO[bytes]

    @property
    def pid(self) -> int:
        return self.process.pid

    def signal(self, number: int) -> None:
        """Send a signal to the whole process group; no effect after its end."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def reap(self) -> int:
        """Exit code of the ended process, negative for a signal; kills the rest of its group."""
        self.signal(signal.SIGKILL)
        code = self.process.wait()
        os.close(self.pidfd)
        return code


def spawn(service: ComposeService) -> Child:
    """Start a service's command; `python` is replaced by the launcher's own interpreter.

    Raises:
        SpawnError: the command does not exist or must not be executed.
    """
    command = list(service.command)
    if command[0] in ("python", "python3"):
        command[0] = sys.executable
    try:
        process = subprocess.Popen(
            command,
            env={**os.environ, **service.environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # so that Ctrl+C reaches the launcher only, which stops the services in order
            preexec_fn=die_with(os.getpid()),  # noqa: PLW1509 - touches no lock that another thread could hold
        )
    except OSError as error:
        raise SpawnError(f"cannot run {command[0]}: {error.strerror or error}") from error
    assert process.stdout is not None
    os.set_blocking(process.stdout.fileno(), False)
    return Child(process, os.pidfd_open(process.pid), process.stdout)


@dataclass
class RestartPolicy:
    """Decides after each exit whether and when to restart a service.

    Attributes:
        service: the service.
        restarts: number of restarts so far.
        gave_up: why it will not be restarted although it failed, or "".
    """

    service: ComposeService
    restarts: int = 0
    gave_up: str = ""
    _exits_s: deque[float] = field(default_factory=deque)

    def after_exit(self, now_s: float, ran_s: float, code: int, how: str) -> float | None:
        """Time in s until the restart; None for no restart, with the reason in `gave_up` if the service failed.

        Args:
            now_s: monotonic time.
            ran_s: time for which the process ran.
            code: its exit code.
            how: description of its end.
        """
        if self.service.restart == "no" or (self.service.restart == "on-failure" and code == 0):
            self.gave_up = how if code else ""
            return None
        if code == os.EX_CONFIG:  # a wrong setting doesn't mend itself
            self.gave_up = how
            return None
        if self.service.max_retries is not None and self.restarts >= self.service.max_retries:
            self.gave_up = f"{how} after {self.restarts} restarts"
            return None
        if ran_s > CRASH_LOOP_WINDOW_S:
            self._exits_s.clear()
        while self._exits_s and self._exits_s[0] < now_s - CRASH_LOOP_WINDOW_S:
            self._exits_s.popleft()
        self._exits_s.append(now_s)
        if len(self._exits_s) > CRASH_LOOP_TRIES:
            self.gave_up = (
                f"crash loop: ended {len(self._exits_s)} times within {CRASH_LOOP_WINDOW_S:.0f} s; last it {how}"
            )
            return None
        self.restarts += 1
        return float(min(BACK_OFF_MAX_S, BACK_OFF_MIN_S * 2 ** (len(self._exits_s) - 1)))


def describe_exit(code: int) -> str:
    """Description of an exit code."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
