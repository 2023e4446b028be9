"""The address of a Zenoh router, such as `tcp/127.0.0.1:7447`."""

import re
from ipaddress import ip_address
from typing import NamedTuple

PROTOCOLS = ("tcp", "tls", "udp", "unixsock-stream")
_NETWORK = re.compile(
    r"(?P<protocol>tcp|tls|udp)/(?P<host>\[[0-9A-Fa-f:.]+(?:%\w+)?\]|[^\s/:\[\]]+):(?P<port>\d{1,5})"
    r"(?:\?[^\s#]*)?(?:#\S.*)?"
)
_UNIX = re.compile(r"unixsock-stream/\S+")


class RouterAddress(NamedTuple):
    """An address in its parts.

    Attributes:
        protocol: one of `PROTOCOLS`.
        host: name or IP address, without brackets; "" for a Unix socket.
        port: port; 0 for a Unix socket.
    """

    protocol: str
    host: str
    port: int


def parse_router(text: str) -> RouterAddress:
    """Parse an address.

    Raises:
        ValueError: its syntax is wrong; the message shows it and an example.
    """
    if _UNIX.fullmatch(text):
        return RouterAddress("unixsock-stream", "", 0)
    match = _NETWORK.fullmatch(text)
    if match is None or not 1 <= int(match["port"]) <= 65535:
        raise ValueError(f"{text!r} is no address of a router: write PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447")
    return RouterAddress(match["protocol"], match["host"].strip("[]"), int(match["port"]))


def shown_router(text: str) -> str:
    """An address for people: without the files that come behind `#`."""
    return text.partition("#")[0]


def is_loopback(host: str) -> bool:
    """Whether only programs on this machine reach an address."""
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name
        return host == "localhost"


def is_on_this_computer(text: str) -> bool:
    """Whether an address is a Unix socket's, or has a host that only this machine reaches."""
    protocol, host, _ = parse_router(text)
    return protocol == "unixsock-stream" or is_loopback(host)


def is_insecure(text: str) -> bool:
    """Whether an address leaves this computer without TLS."""
    return parse_router(text).protocol in ("tcp", "udp") and not is_on_this_computer(text)


def insecurity(text: str) -> str:
    """What an address without TLS means, for people; "" for one with TLS, and for one of this computer."""
    return (
        f"{shown_router(text)} is insecure: whoever is on its network sees all and may fly" if is_insecure(text) else ""
    )
