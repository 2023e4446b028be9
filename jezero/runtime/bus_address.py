"""The addresses of a computer's router: TCP for people's programs, and a Unix socket for the services.

Who is a service is decided by the kernel: only programs of this user, or of root, can connect to the socket, and the
router gives its links the rights of the services. A link over TCP has the rights of a pilot, whatever its messages say.
"""

import hashlib
import os
import re
import stat
from errno import ENOENT
from pathlib import Path

import msgspec

from jezero.router_address import is_loopback, parse_router, shown_router
from jezero.runtime.config import ConfigError, Instance, instance_from_environment
from jezero.runtime.linux_processes import port_holder, unix_listener

RUN_DIR_VARIABLE = "JEZERO_RUN_DIR"
PREFIX = "unixsock-stream/"
SOCKET = "bus"
NAMES = "names"
"""Folder beside a router's socket, with a locked file for each service that runs."""
PATH_MAX_BYTES = 107
"""Longest path of a Unix socket. Source: unix(7)."""
_PLAIN_PATH = re.compile(r"[A-Za-z0-9/._~+-]+")
"""Paths that Zenoh reads as they are: `?` and `#` end an address, and blanks separate addresses."""


def default_run_folder(vehicle: str) -> Path:
    """This user's folder for a vehicle's stack.

    Raises:
        OSError: the user has no home.
    """
    base = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    if not os.path.isabs(base):
        raise OSError(ENOENT, "no folder for the run, as this user has no home: choose one with --run-dir")
    return Path(base) / "jezero" / vehicle


def socket_of(run_folder: Path) -> str:
    """Zenoh's endpoint of the Unix socket for the services of a stack.

    It is in the run folder, or in a folder of this user in `/tmp` where that path is too long for a socket, or has
    characters that an address can't have.
    """
    path = run_folder.resolve() / SOCKET
    if len(os.fsencode(path)) > PATH_MAX_BYTES or not _PLAIN_PATH.fullmatch(str(path)):
        path = _short_folder() / hashlib.sha256(os.fsencode(path)).hexdigest()[:16]
    return f"{PREFIX}{path}"


def _short_folder() -> Path:
    return Path(f"/tmp/jezero-{os.getuid()}")


def make_socket_folder(endpoint: str) -> None:
    """Make the folder of a socket, which only this user may enter.

    Raises:
        ConfigError: the folder in `/tmp` is there already, and is another user's or open to others.
        OSError: it can't be made.
    """
    folder = Path(endpoint.removeprefix(PREFIX)).parent
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    state = folder.lstat()
    private = stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid() and not state.st_mode & 0o077
    if folder == _short_folder() and not private:
        raise ConfigError(
            f"{folder} is not a private folder of this user: remove it, or choose a run folder with a shorter path"
        )


def service_instance() -> Instance:
    """The instance of a service: its router's address is that of the socket.

    Without `JEZERO_ROUTER` it is the socket of the run folder.

    Raises:
        ConfigError: a variable is malformed, or `JEZERO_ROUTER` is the address for people's programs.
        OSError: there is no run folder, as the user has no home.
    """
    instance = instance_from_environment()
    if not os.environ.get("JEZERO_ROUTER"):
        return msgspec.structs.replace(instance, router=socket_of(run_folder_of(instance.vehicle)))
    if not instance.router.startswith(PREFIX):
        raise ConfigError(
            f"JEZERO_ROUTER is {shown_router(instance.router)}, where a program has the rights of a pilot. A service "
            f"needs the router's socket, which `jezero up` and `jezero ps` print: {PREFIX}FOLDER/{SOCKET}"
        )
    return instance


def run_folder_of(vehicle: str) -> Path:
    """The run folder by `JEZERO_RUN_DIR`, or the default one of a vehicle.

    Raises:
        OSError: the user has no home.
    """
    given = os.environ.get(RUN_DIR_VARIABLE)
    return Path(given) if given else default_run_folder(vehicle)


def bus_of_router(router: str) -> str:
    """The socket for services of a router that runs; "" if none is known, as of another user's router.

    Args:
        router: its address for people's programs, or the socket itself.
    """
    if router.startswith(PREFIX):
        return router
    protocol, host, port = parse_router(router)
    holder = port_holder("tcp", port) if protocol == "tcp" and is_loopback(host) else None
    path = "" if holder is None else unix_listener(holder)
    return f"{PREFIX}{path}" if path else ""
