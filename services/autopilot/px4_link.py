"""PX4 as a program of its own: its output, and its connection to the simulator, as a link."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from jezero.runtime.linux_processes import die_with, is_stopped

CHECK_PERIOD_NS = 200_000_000
STOPPED_CHECKS_MIN = 7
"""Checks in a row that find a program stopped until it counts as frozen: 1.4 s, or more when this process is late."""
STOP_TIMEOUT_S = 0.3
CHUNK = 65_536
TCP_LISTEN, TCP_ESTABLISHED = "0A", "01"


class ChildLink:
    """Runs a program as soon as a TCP server listens; up while the program is connected to it. Needs /proc (Linux).

    The program's output is also printed on this process's standard output. The program leads a process group of its
    own, whose members all end with the link. Nothing can be sent to it.

    Args:
        name: the program's, for error messages.
        command: the program and its arguments.
        environment: variables besides those of this process.
        folder: working directory, emptied first; None makes a temporary one.
        port: TCP port of the server on this host. The program has to connect to it, and can't connect again.
    """

    def __init__(
        self, name: str, command: Sequence[str], environment: Mapping[str, str], folder: Path | None, port: int
    ) -> None:
        self.up = False
        self.connections = 0
        self._name = name
        self._command = list(command)
        self._environment = dict(environment)
        self._folder = folder
        self._port = port
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._output: socket.socket | None = None
        self._next_check_ns = 0
        self._stopped_checks = 0

    def start(self) -> None:
        """Make the folder; `poll` starts the program when the server listens."""
        if self._folder is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="jezero-", ignore_cleanup_errors=True)
            self._folder = Path(self._temporary.name)
        else:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder.mkdir(parents=True)

    def sockets(self) -> list[socket.socket]:
        return [] if self._output is None else [self._output]

    def poll(self, wall_ns: int) -> bytes:
        """New output of the program.

        Raises:
            ChildProcessError: the program can't be run, ended by itself, or is frozen.
            ConnectionAbortedError: its connection to the server is lost.
        """
        data = self._read()
        if data:
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
        if wall_ns >= self._next_check_ns:
            self._next_check_ns = wall_ns + CHECK_PERIOD_NS
            self._check()
        return data

    def send(self, data: bytes) -> None:
        """Drop the bytes: the program reads nothing."""

    def close(self) -> None:
        """Stop the program with SIGTERM, and kill the rest of its group after `STOP_TIMEOUT_S`."""
        if self._process is not None:
            self._signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(STOP_TIMEOUT_S)
            self._signal(signal.SIGKILL)
            self._process.wait()
        if self._output is not None:
            self._output.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def _check(self) -> None:
        if self._process is None:
            if _tcp_exists(TCP_LISTEN, local_port=self._port):
                self._spawn()
            return
        code = self._process.poll()
        if code is not None:
            how = f"exit code {code}" if code >= 0 else f"signal {-code}"
            raise ChildProcessError(f"{self._name} ended by itself with {how}")
        self._stopped_checks = self._stopped_checks + 1 if is_stopped(self._process.pid) else 0
        if self._stopped_checks >= STOPPED_CHECKS_MIN:
            raise ChildProcessError(f"{self._name} is frozen: stopped by a signal")
        up = _tcp_exists(TCP_ESTABLISHED, remote_port=self._port)
        if self.up and not up:
            raise ConnectionAbortedError(
                f"{self._name} lost its connection to port {self._port} and can't connect again"
            )
        self.connections += int(up and not self.up)
        self.up = up

    def _spawn(self) -> None:
        self._output, child_end = socket.socketpair()
        self._output.setblocking(False)
        with child_end:
            try:
                self._process = subprocess.Popen(
                    self._command,
                    cwd=self._folder,
                    env={**os.environ, **self._environment},
                    stdin=subprocess.DEVNULL,
                    stdout=child_end.fileno(),
                    stderr=child_end.fileno(),
                    process_group=0,
                    preexec_fn=die_with(os.getpid()),  # noqa: PLW1509 - touches no lock that another thread could hold
                )
            except OSError as error:
                raise ChildProcessError(f"cannot run {self._command[0]}: {error.strerror or error}") from error

    def _read(self) -> bytes:
        if self._output is None:
            return b""
        try:
            data = self._output.recv(CHUNK)
        except BlockingIOError:
            return b""
        if not data:  # the last process of the group has closed it
            self._output.close()
            self._output = None
            self._next_check_ns = 0
        return data

    def _signal(self, number: int) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)


def _tcp_exists(state: str, *, local_port: int | None = None, remote_port: int | None = None) -> bool:
    """Whether this host has an IPv4 socket in a state, with these ports; needs no connection. Source: proc(5)."""
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        _, local, remote, found_state, *_ = line.split()
        ports = (int(local.rpartition(":")[2], 16), int(remote.rpartition(":")[2], 16))
        if found_state == state and local_port in (None, ports[0]) and remote_port in (None, ports[1]):
            return True
    return False
