"""The autopilot's link to ground stations: on the loopback as shipped, and signed where it leaves this computer."""

import os
from ipaddress import AddressValueError, IPv4Address

from msgspec.structs import replace

from jezero.base.config import ConfigError
from jezero.keys.bundle import INSECURE_VARIABLE, VARIABLE, mavlink_key
from jezero.keys.members import KeysError
from jezero.services.autopilot.config import AutopilotConfig, SigningConfig

HOST_VARIABLE = "JEZERO_GCS_HOST"
"""Environment variable with the IPv4 address of the computer of the ground stations."""
LOOPBACK = "127.0.0.1"


def ground_host() -> str:
    """The computer of the ground stations, by `JEZERO_GCS_HOST`.

    Raises:
        ConfigError: it is no IPv4 address.
    """
    given = os.environ.get(HOST_VARIABLE) or LOOPBACK
    try:
        IPv4Address(given)
    except AddressValueError:
        raise ConfigError(f"{HOST_VARIABLE} is {given!r}: write the IPv4 address of one computer, no port") from None
    return given


def is_local(host: str) -> bool:
    """Whether the link stays on this computer."""
    return IPv4Address(host).is_loopback


def insecurity(signing: SigningConfig, host: str) -> str:
    """What a link without signatures to another computer means, for people; "" for any other link."""
    if is_local(host) or signing.key:
        return ""
    return f"the MAVLink link to {host} is insecure: everybody on its network may fly"


def with_signatures(config: AutopilotConfig, host: str) -> AutopilotConfig:
    """The settings with signatures on a link that leaves this computer, by the key in `autopilot.toml` or the bundle's.

    Raises:
        ConfigError: such a link has no key, and nobody has permitted that.
    """
    if is_local(host):
        return config
    signing = config.signing
    try:
        key = signing.key or mavlink_key(os.environ.get(VARIABLE)).hex()
    except KeysError as error:
        raise ConfigError(f"{HOST_VARIABLE}: {error}") from None
    if not key and os.environ.get(INSECURE_VARIABLE) == "1":
        return config
    if not key:
        raise ConfigError(
            f"{HOST_VARIABLE} is {host}: without signatures everybody on its network could fly by MAVLink. Name the "
            f"bundle of `jezero keys` with {VARIABLE}: the ground station needs its mavlink.key too. Or set "
            f"{INSECURE_VARIABLE}=1 on a network that you trust"
        )
    return replace(config, signing=SigningConfig(key=key, links=tuple(dict.fromkeys(("gcs", *signing.links)))))
