"""One frozen struct per service, read once from `deploy/config/<name>.toml`."""

import os
import re
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, TypeVar

import msgspec
from msgspec import Meta

from jezero.keys.bundle import INSECURE_VARIABLE, given_endpoint
from jezero.os_errors import describe_os_error
from jezero.router_address import is_loopback
from jezero.schemas.struct import END


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every service's settings: unknown fields and values out of range are refused."""


S = TypeVar("S", bound=msgspec.Struct)

NAME_EXPECTED = "expected 1 to 32 letters, digits, '-' and '_'"


class ConfigError(ValueError):
    """A setting is wrong; the message names the file, the field and the expected value."""


class Instance(Config, frozen=True, kw_only=True):
    """Identity of one stack on this machine, read from the environment by all its processes.

    Attributes:
        vehicle: name within the keys (`JEZERO_VEHICLE`).
        router: Zenoh endpoint of the router (`JEZERO_ROUTER`), with the files of the bundle (`JEZERO_KEYS`) for TLS.
        number: offset of every MAVLink port and of the rover's, so that stacks don't collide (`JEZERO_INSTANCE`).
        gcs_port: UDP port of ground stations, the same for all vehicles (`JEZERO_GCS_PORT`).
    """

    vehicle: Annotated[str, Meta(pattern=rf"^[A-Za-z0-9_-]{{1,32}}{END}")] = "uav1"
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


class HostLinks(NamedTuple):
    """The links of this computer's router with other computers, read from the environment by the router alone.

    Attributes:
        listen: Zenoh's endpoints at which it listens to them (`JEZERO_LISTEN`).
        connect: Zenoh's endpoints of their routers, to which it connects (`JEZERO_CONNECT`).
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()


LISTEN_VARIABLE, CONNECT_VARIABLE = "JEZERO_LISTEN", "JEZERO_CONNECT"


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


def vehicle_from_environment() -> str:
    """Read `JEZERO_VEHICLE` alone, for what needs no router.

    Raises:
        ConfigError: it is malformed.
    """
    return _instance_of({"vehicle": os.environ.get("JEZERO_VEHICLE") or Instance().vehicle}).vehicle


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


def _instance_of(given: dict[str, str]) -> Instance:
    """The instance with these fields.

    Raises:
        ConfigError: one of them is malformed.
    """
    try:
        return msgspec.convert(given, Instance, strict=False)
    except msgspec.ValidationError as error:
        wrong = re.search(r"(.*) - at `\$\.(\w+)`", str(error))
        assert wrong is not None
        field = wrong[2]
        expected = NAME_EXPECTED if field == "vehicle" else wrong[1].replace("Expected", "expected")
        raise ConfigError(f"{_VARIABLES[field]} is {given[field]!r}: {expected}") from None


def checked_host(name: str, host: str) -> str:
    """The host of a link without TLS, which is another computer only where a person has permitted it.

    Args:
        name: of the setting or variable, for the error.
        host: its value.

    Raises:
        ConfigError: it is no IPv4 address or name of a computer, or not this computer and not permitted.
    """
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,253}", host):
        raise ConfigError(f"{name} is {host!r}: write an IPv4 address or the name of a computer, without a port")
    if not is_loopback(host) and os.environ.get(INSECURE_VARIABLE) != "1":
        raise ConfigError(
            f"{name} is {host!r}: this link has no TLS, so whoever is on its network could drive the rover: write "
            f"127.0.0.1, or set {INSECURE_VARIABLE}=1 on a network that you trust"
        )
    return host


def is_recorded() -> bool:
    """Whether the stack has a recorder, for which its services keep journals (`JEZERO_RECORD`)."""
    return os.environ.get("JEZERO_RECORD") != "0"


class _AutopilotChoice(msgspec.Struct, frozen=True):
    """The one field of `autopilot.toml` that others than the autopilot need."""

    autopilot: Literal["embedded", "px4"] = "embedded"


def chosen_autopilot() -> str:
    """The autopilot that the stack runs, "embedded" or "px4": `JEZERO_AUTOPILOT`, else that of `autopilot.toml`.

    Raises:
        ConfigError: there is no such autopilot, or the file is missing or malformed.
    """
    given = os.environ.get("JEZERO_AUTOPILOT")
    if given and given not in ("embedded", "px4"):
        raise ConfigError(f'JEZERO_AUTOPILOT is "{given}", expected "embedded" or "px4"')
    return given or load_config(_AutopilotChoice, "autopilot").autopilot


def config_directory() -> Path:
    """`JEZERO_CONFIG_DIR` if it is set, otherwise the folder that jezero ships."""
    given = os.environ.get("JEZERO_CONFIG_DIR")
    return Path(given) if given else Path(import_module("jezero.deploy").__path__[0]) / "config"


def load_config(kind: type[S], name: str, directory: Path | None = None) -> S:
    """Read `<name>.toml`; missing fields get their defaults.

    Raises:
        ConfigError: the file is missing or malformed, or a field is unknown or out of range.
    """
    path = (directory or config_directory()) / f"{name}.toml"
    try:
        return msgspec.toml.decode(path.read_bytes(), type=kind)
    except FileNotFoundError:
        raise ConfigError(f"{path} is missing: each service reads its settings from there") from None
    except OSError as error:
        raise ConfigError(describe_os_error(error)) from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error
