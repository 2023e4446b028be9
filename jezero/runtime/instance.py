"""Which stack a process belongs to, as its environment says: vehicle, router, ports, run folder, other computers.

A computer's router has two addresses: TCP for people's programs, and a Unix socket for the services. Who is a service
is decided by the kernel: only programs of this user, or of root, can connect to the socket, and the router gives its
links the rights of the services. A link over TCP has the rights of a pilot, whatever its messages say.
"""

import hashlib
import os
import re
import stat
from errno import ENOENT
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from jezero.base.config import Config, ConfigError
from jezero.base.mistakes import mistake
from jezero.base.router_address import is_loopback, shown_router
from jezero.base.vehicle_name import NAME_EXPECTED, NAME_PATTERN
from jezero.keys.bundle import INSECURE_VARIABLE, given_endpoint
from jezero.schemas.struct import END

LISTEN_VARIABLE, CONNECT_VARIABLE = "JEZERO_LISTEN", "JEZERO_CONNECT"

RUN_DIR_VARIABLE = "JEZERO_RUN_DIR"
PREFIX = "unixsock-stream/"
SOCKET = "bus"
NAMES = "names"
"""Folder beside a router's socket, with a locked file for each service that runs."""
PATH_MAX_BYTES = 107
"""Longest path of a Unix socket. Source: unix(7)."""
_PLAIN_PATH = re.compile(r"[A-Za-z0-9/._~+-]+")
"""Paths that Zenoh reads as they are: `?` and `#` end an address, and blanks separate addresses."""


class Instance(Config, frozen=True, kw_only=True):
    """Identity of one stack on this machine, read from the environment by all its processes.

    Attributes:
        vehicle: name within the keys (`JEZERO_VEHICLE`).
        router: Zenoh endpoint of the router (`JEZERO_ROUTER`), with the files of the bundle (`JEZERO_KEYS`) for TLS.
        number: offset of every MAVLink port and of the rover's, so that stacks don't collide (`JEZERO_INSTANCE`).
        gcs_port: UDP port of ground stations, the same for all vehicles (`JEZERO_GCS_PORT`).
    """

    vehicle: Annotated[str, Meta(pattern=NAME_PATTERN)] = "uav1"
    router: Annotated[str, Meta(pattern=rf"^(tcp|tls|udp|unixsock-stream)/.+{END}")] = "tcp/127.0.0.1:7447"
    number: Annotated[int, Meta(ge=0, le=249)] = 0
    gcs_port: Annotated[int, Meta(ge=1, le=65535)] = 14550

    @property
    def hil_port(self) -> int:
        """TCP port on which the simulator listens for the autopilot."""
        return 4560 + self.number

    @property
    def rover_port(self) -> int:
        """TCP port on which the simulator listens for the rover's computer; those of the HIL links are below."""
        return 4810 + self.number

    @property
    def bridge_port(self) -> int:
        """UDP port of the vehicle bridge."""
        return 14540 + self.number

    @property
    def autopilot_offboard_port(self) -> int:
        """UDP port of the autopilot's offboard link."""
        return 14580 + self.number

    @property
    def autopilot_gcs_port(self) -> int:
        """UDP port of the autopilot's ground-station link, which sends to `gcs_port`."""
        return 18570 + self.number

    @property
    def system_id(self) -> int:
        """MAVLink system id of the autopilot."""
        return 1 + self.number


_VARIABLES = {
    "vehicle": "JEZERO_VEHICLE",
    "router": "JEZERO_ROUTER",
    "number": "JEZERO_INSTANCE",
    "gcs_port": "JEZERO_GCS_PORT",
}


def instance_from_environment() -> Instance:
    """Read the variables that `Instance` names, and those of the router's keys: `JEZERO_KEYS`, `JEZERO_INSECURE`.

    Raises:
        ConfigError: one of them is malformed, or the router's address needs keys.
    """
    given = {field: os.environ[name] for field, name in _VARIABLES.items() if os.environ.get(name)}
    try:
        if "router" in given:
            given["router"] = given_endpoint(given["router"])
    except ValueError as error:
        raise ConfigError(f"{_VARIABLES['router']}: {error}") from None
    return _instance_of(given)


def vehicle_from_environment() -> str:
    """Read `JEZERO_VEHICLE` alone, for what needs no router.

    Raises:
        ConfigError: it is malformed.
    """
    return _instance_of({"vehicle": os.environ.get("JEZERO_VEHICLE") or Instance().vehicle}).vehicle


def _instance_of(given: dict[str, str]) -> Instance:
    """The instance with these fields.

    Raises:
        ConfigError: one of them is malformed.
    """
    try:
        return msgspec.convert(given, Instance, strict=False)
    except msgspec.ValidationError as error:
        field, _, expected = mistake(error, Instance).partition(": ")
        expected = NAME_EXPECTED if field == "vehicle" else expected
        raise ConfigError(f"{_VARIABLES[field]} is {given[field]!r}: {expected}") from None


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


class HostLinks(NamedTuple):
    """The links of this computer's router with other computers, read from the environment by the router alone.

    Attributes:
        listen: Zenoh's endpoints at which it listens to them (`JEZERO_LISTEN`).
        connect: Zenoh's endpoints of their routers, to which it connects (`JEZERO_CONNECT`).
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()


def links_from_environment() -> HostLinks:
    """Read `JEZERO_LISTEN` and `JEZERO_CONNECT`, addresses with blanks between them, and the variables of the keys.

    Raises:
        ConfigError: an address is malformed, or needs keys.
    """
    return HostLinks(_endpoints(LISTEN_VARIABLE), _endpoints(CONNECT_VARIABLE))


def _endpoints(variable: str) -> tuple[str, ...]:
    try:
        return tuple(given_endpoint(address) for address in os.environ.get(variable, "").split())
    except ValueError as error:
        raise ConfigError(f"{variable}: {error}") from None


def checked_host(name: str, host: str, *, signed: bool = False, remedy: str = "") -> str:
    """The host of a link without TLS, which is another computer only where a person has permitted it.

    Args:
        name: of the setting or variable, for the error.
        host: its value.
        signed: whether its messages are signed, so that it may be another computer.
        remedy: what makes this kind of link safe, for the error; "" for nothing.

    Raises:
        ConfigError: it is no IPv4 address or name of a computer, or not this computer and not permitted.
    """
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,253}", host):
        raise ConfigError(f"{name} is {host!r}: write an IPv4 address or the name of a computer, without a port")
    if not signed and not is_loopback(host) and os.environ.get(INSECURE_VARIABLE) != "1":
        raise ConfigError(
            f"{name} is {host!r}: this link has no TLS, so whoever is on its network can change what it carries: write "
            f"127.0.0.1, {remedy}or set {INSECURE_VARIABLE}=1 on a network that you trust"
        )
    return host


def is_recorded() -> bool:
    """Whether the stack has a recorder, for which its services keep journals (`JEZERO_RECORD`)."""
    return os.environ.get("JEZERO_RECORD") != "0"


def run_folder_of(vehicle: str) -> Path:
    """The run folder by `JEZERO_RUN_DIR`, or the default one of a vehicle.

    Raises:
        OSError: the user has no home.
    """
    given = os.environ.get(RUN_DIR_VARIABLE)
    return Path(given) if given else default_run_folder(vehicle)


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
