"""Where the pages are served, and what another address than the loopback address needs."""

import socket
import ssl
from dataclasses import dataclass
from errno import EADDRNOTAVAIL
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from jezero.router_address import insecurity
from jezero.runtime.config import ConfigError, links_from_environment
from jezero.services.ground_station.config import GroundStationConfig
from jezero.services.ground_station.password import SET_IT, default_password_file, read_password

LOOPBACK_NAMES = frozenset({"localhost"})
PORTS_TRIED = 20


@dataclass(frozen=True)
class Listening:
    """Where the pages are served, and to whom.

    Attributes:
        address: IP address.
        password_hash: hash of the password that commands need; "" where anybody may fly.
        certificate: file of the TLS certificate; "" without TLS.
        key: file of its private key.
        names: names by which browsers find this machine, in lower case, besides IP addresses.
    """

    address: str
    password_hash: str
    certificate: str
    key: str
    names: frozenset[str]

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches the address."""
        return ip_address(self.address).is_loopback

    def url(self, port: int) -> str:
        """Address of the pages, for a browser."""
        host = self.address
        if ip_address(host).is_unspecified:
            host = socket.gethostname()
        elif ":" in host:
            host = f"[{host}]"
        return f"{'https' if self.certificate else 'http'}://{host}:{port}"

    def serves(self, host: str) -> bool:
        """Whether a request's `Host` names this machine; another name is one that somebody else has pointed here."""
        name = (urlsplit(f"//{host}").hostname or "") if host.isascii() else ""
        if name in LOOPBACK_NAMES | self.names:
            return True
        try:
            named = ip_address(name)
        except ValueError:
            return False
        return named.is_loopback or not self.is_loopback


def listening_of(config: GroundStationConfig) -> Listening:
    """Check the settings of who may reach the pages.

    Raises:
        ConfigError: on another address than the loopback address, the password or TLS is missing; or a file can't be
            used. The message says what to do.
    """
    try:
        address = ip_address(config.listen)
    except ValueError:
        raise ConfigError(f"{config.listen!r} is no IP address to listen on, such as 127.0.0.1 or 0.0.0.0") from None
    if bool(config.certificate) != bool(config.key):
        raise ConfigError("TLS needs both files: the certificate and its key")
    if config.certificate:
        _check_certificate(config.certificate, config.key)
    if address.is_loopback:
        return Listening(config.listen, "", config.certificate, config.key, frozenset())
    hashed = _password_of(config)
    if not config.certificate and not config.insecure:
        raise ConfigError(
            f"on {config.listen} the password would cross the network in clear text: give --certificate FILE and "
            "--key FILE, or --insecure on a network that you trust"
        )
    own = socket.gethostname().lower()
    names = {own, f"{own}.local", *(name.lower() for name in config.host_names)}
    return Listening(config.listen, hashed, config.certificate, config.key, frozenset(names))


def insecurities(listening: Listening, router: str | None) -> str:
    """What is without TLS between this stack, its pages and others, for people; "" for nothing.

    Args:
        listening: where the pages are served.
        router: endpoint of the vehicle's router; None without one.
    """
    links = links_from_environment()
    found = [insecurity(endpoint) for endpoint in (router, *links.listen, *links.connect) if endpoint]
    if not listening.is_loopback and not listening.certificate:
        found.append("These pages are insecure: whoever is on their network reads the password and may fly")
    return "; ".join(filter(None, found))


def password_file(config: GroundStationConfig) -> Path:
    """The file of the password's hash."""
    return Path(config.password_file).expanduser() if config.password_file else default_password_file()


def _password_of(config: GroundStationConfig) -> str:
    file = password_file(config)
    if not file.exists():
        raise ConfigError(
            f"on {config.listen} whoever reaches this machine could fly, and there is no password in {file}: {SET_IT}"
        )
    return read_password(file)


def _check_certificate(certificate: str, key: str) -> None:
    for file in (certificate, key):
        if not Path(file).is_file():
            raise ConfigError(f"{file}: there is no such file")
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password="")
    except (ssl.SSLError, OSError) as error:
        raise ConfigError(f"{certificate} and {key} are no certificate and its unencrypted key: {error}") from None


def listening_socket(address: str, port: int) -> socket.socket:
    """A socket that listens on a port, or on one of the next ports when that is busy.

    Raises:
        OSError: the address is not one of this machine, or none of the ports is free.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    for candidate in (*range(port, min(port + PORTS_TRIED, 65536)), 0):
        listening = socket.socket(family)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((address, candidate))
            listening.listen()
        except OSError as error:
            listening.close()
            if error.errno == EADDRNOTAVAIL:
                raise OSError(error.errno, f"{address} is no address of this machine") from None
            continue
        return listening
    raise OSError(f"no free port on {address}")
