"""Processes of this machine: who holds a port, whether one is stopped, and children that end with their parent.

Needs Linux and its /proc.
"""

import ctypes
import errno
import os
import shlex
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Literal

from jezero.base.plain_text import plain

Protocol = Literal["tcp", "udp"]
COMMAND_MAX = 80
PR_SET_PDEATHSIG = 1
ACCEPTS = 1 << 16
"""Flag of a socket that listens: `__SO_ACCEPTCON` of linux/net.h."""

_libc = ctypes.CDLL(None, use_errno=True)


def process_in_words() -> str:
    """This host and process, for people."""
    return f"{socket.gethostname()} pid {os.getpid()}"


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
    """Whether a process is stopped by a signal; a debugger's stop doesn't count. Source: proc(5)."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"


def listen_problem(protocol: Protocol, host: str, port: int, variable: str) -> str:
    """Why a process can't listen on a port now, in one sentence, or "".

    Args:
        variable: environment variable that moves the port.
    """
    try:
        found = socket.getaddrinfo(host, port, type=_kind(protocol), flags=socket.AI_PASSIVE)
    except OSError as error:
        return f"cannot listen on {host}: {error.strerror}; set {variable} to an address of this machine"
    family, *_, address = found[0]
    with socket.socket(family, _kind(protocol)) as probe:
        if protocol == "tcp":
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
            if protocol == "tcp":
                probe.listen(1)
        except OSError as error:
            return listen_error(protocol, host, port, variable, error)
    return ""


def listen_error(protocol: Protocol, host: str, port: int, variable: str, error: OSError) -> str:
    """One sentence about an attempt to listen that failed: the port, its holder, and what moves it."""
    where = f"{protocol.upper()} port {port} of {host}"
    if error.errno != errno.EADDRINUSE:
        return f"cannot listen on {where}: {error.strerror}; set {variable} to another one"
    process = port_holder(protocol, port)
    holder = "a process that this user can't see" if process is None else f"process {process} ({_command(process)})"
    return f"{where} is held by {holder}: stop that, or set {variable} to another one"


def port_holder(protocol: Protocol, port: int) -> int | None:
    """The id of the process that has a port; None if /proc doesn't show it."""
    links = {f"socket:[{inode}]" for inode in _inodes(protocol, port)}
    processes = Path("/proc").glob("[0-9]*") if links else ()
    return next((int(each.name) for each in processes if not links.isdisjoint(_open_files(each))), None)


def unix_listener(process: int) -> str:
    """Path of a Unix socket on which a process listens; "" without one, or if /proc doesn't show it."""
    paths = {}
    for line in Path("/proc/net/unix").read_text().splitlines()[1:]:
        _, _, _, flags, _, _, inode, *path = line.split(maxsplit=7)
        if path and path[0].startswith("/") and int(flags, 16) & ACCEPTS:
            paths[f"socket:[{inode}]"] = path[0]
    return next((paths[link] for link in _open_files(Path(f"/proc/{process}")) if link in paths), "")


def _open_files(process: Path) -> Iterator[str]:
    """What the file descriptors of a process are, as far as /proc shows it. Source: proc(5)."""
    with suppress(OSError):  # it has ended, or is another user's
        for name in os.listdir(process / "fd"):
            with suppress(OSError):  # closed since it was listed
                yield os.readlink(process / "fd" / name)


def _inodes(protocol: Protocol, port: int) -> set[str]:
    """Inodes of the sockets with a local port. Source: proc(5)."""
    found = set()
    for table in (protocol, f"{protocol}6"):
        with suppress(OSError):  # a kernel without IPv6
            for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
                fields = line.split()
                if int(fields[1].rpartition(":")[2], 16) == port:
                    found.add(fields[9])
    return found


def _command(process: int) -> str:
    """A process' command line, in the middle of which a long one is cut: its end names a module or script."""
    try:
        data = Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:  # it has just ended
        return ""
    words = data.decode("utf-8", "replace").rstrip("\0").split("\0")
    text, half = plain(shlex.join(words)), COMMAND_MAX // 2
    return text if len(text) <= COMMAND_MAX else f"{text[:half]}…{text[-half:]}"


def _kind(protocol: Protocol) -> socket.SocketKind:
    return socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM
