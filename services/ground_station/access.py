"""Who reaches the pages, and who may fly: the address on which they are served, the password, and the log-ins.

On another address than the loopback address a password and TLS are needed. Times are seconds of a monotonic clock that
the caller reads.
"""

import os
import secrets
import socket
import ssl
import stat
from collections import OrderedDict, deque
from dataclasses import dataclass
from errno import EADDRNOTAVAIL
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from urllib.parse import urlsplit

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError, VerifyMismatchError

from jezero.base.config import ConfigError
from jezero.base.files import naming
from jezero.base.router_address import insecurity
from jezero.runtime.instance import links_from_environment
from jezero.services.ground_station.config import GroundStationConfig

LOOPBACK_NAMES = frozenset({"localhost"})
PORTS_TRIED = 20
HASHER = PasswordHasher(time_cost=2, memory_cost=19 * 1024, parallelism=1)
"""Argon2id, with which each guess takes 19 MiB and about 0.05 s of one processor: the others are left to the vehicle.
Source: OWASP's sheet on storing passwords."""
PASSWORD_LENGTH_MIN, PASSWORD_LENGTH_MAX = 8, 200
MODE_OF_OTHERS = stat.S_IRWXG | stat.S_IRWXO
SET_IT = "`jezero ground --set-password` sets it"
SESSIONS_MAX = 64
ADDRESSES_MAX = 1024
FAILURES_MAX = 5
FAILURE_SPAN_S = 60.0
IPV6_NETWORK_BYTES = 8
"""One household or machine has all addresses of such a network."""


# -- the address --


@dataclass(frozen=True)
class Listening:
    """Where the pages are served, and to whom.

    Attributes:
        config: the settings, which have been checked.
        password_hash: hash of the password that commands need; "" where anybody may fly.
        names: names by which browsers find this machine, in lower case, besides IP addresses.
    """

    config: GroundStationConfig
    password_hash: str = ""
    names: frozenset[str] = frozenset()

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches the address."""
        return ip_address(self.config.listen).is_loopback

    def url(self, port: int) -> str:
        """Address of the pages, for a browser."""
        host = self.config.listen
        if ip_address(host).is_unspecified:
            host = socket.gethostname()
        elif ":" in host:
            host = f"[{host}]"
        return f"{'https' if self.config.certificate else 'http'}://{host}:{port}"

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
        return Listening(config)
    hashed = _password_of(config)
    if not config.certificate and not config.insecure:
        raise ConfigError(
            f"on {config.listen} the password would cross the network in clear text: give --certificate FILE and "
            "--key FILE, or --insecure on a network that you trust"
        )
    own = socket.gethostname().lower()
    names = {own, f"{own}.local", *(name.lower() for name in config.host_names)}
    return Listening(config, hashed, frozenset(names))


def _check_certificate(certificate: str, key: str) -> None:
    for file in (certificate, key):
        if not Path(file).is_file():
            raise ConfigError(f"{file}: there is no such file")
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key, password="")
    except (ssl.SSLError, OSError) as error:
        raise ConfigError(f"{certificate} and {key} are no certificate and its unencrypted key: {error}") from None


def _password_of(config: GroundStationConfig) -> str:
    file = password_file(config)
    if not file.exists():
        raise ConfigError(
            f"on {config.listen} whoever reaches this machine could fly, and there is no password in {file}: {SET_IT}"
        )
    return read_password(file)


def insecurities(listening: Listening, router: str | None) -> str:
    """What is without TLS between this stack, its pages and others, for people; "" for nothing.

    Args:
        listening: where the pages are served.
        router: endpoint of the vehicle's router; None without one.
    """
    links = links_from_environment()
    found = [insecurity(endpoint) for endpoint in (router, *links.listen, *links.connect) if endpoint]
    if not listening.is_loopback and not listening.config.certificate:
        found.append("These pages are insecure: whoever is on their network reads the password and may fly")
    return "; ".join(filter(None, found))


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


# -- the password: only its Argon2 hash is kept, in a file that nobody but its owner can read --


def password_file(config: GroundStationConfig) -> Path:
    """The file of the password's hash: this user's `~/.config/jezero/ground_station.password`, if none is set."""
    if config.password_file:
        return Path(config.password_file).expanduser()
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(base) / "jezero" / "ground_station.password"


def write_password(path: Path, password: str) -> None:
    """Write the hash of a password into a file that only this user can read.

    Raises:
        ValueError: the password is too short or too long.
        OSError: the file can't be written.
    """
    hashed = hash_of(password)
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f"{path.name}.new")
    with naming(path):
        new.unlink(missing_ok=True)
        with open(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(f"{hashed}\n")
        new.replace(path)


def hash_of(password: str) -> str:
    """A new hash of a password, with its salt and the parameters of Argon2.

    Raises:
        ValueError: the password is too short or too long.
    """
    if not PASSWORD_LENGTH_MIN <= len(password) <= PASSWORD_LENGTH_MAX:
        least, most = PASSWORD_LENGTH_MIN, PASSWORD_LENGTH_MAX
        raise ValueError(f"the password has {len(password)} characters: choose {least} to {most}")
    return HASHER.hash(password)


def read_password(path: Path) -> str:
    """The hash in a file.

    Raises:
        ConfigError: others can read the file too, or its content is no hash.
        OSError: it can't be read.
    """
    if path.stat().st_mode & MODE_OF_OTHERS:
        raise ConfigError(f"{path} can be read by other users: `chmod 600 {path}`")
    try:
        hashed = path.read_text(encoding="ascii").strip()
        matches("", hashed)
    except (UnicodeDecodeError, InvalidHashError, VerificationError):
        raise ConfigError(f"{path} holds no Argon2 hash: {SET_IT} anew") from None
    return hashed


def matches(password: str, hashed: str) -> bool:
    """Whether a password is the one of a hash.

    Raises:
        VerificationError: the hash is damaged.
        InvalidHashError: it is no hash of Argon2.
    """
    try:
        return HASHER.verify(hashed, password)
    except VerifyMismatchError:
        return False


# -- the log-ins --


@dataclass
class _Session:
    start_s: float
    used_s: float


class Sessions:
    """The log-ins, by the ids that their cookies carry.

    Args:
        idle_s: a session ends when it was not used for this time.
        max_s: a session ends after this time in any case.
    """

    def __init__(self, idle_s: float, max_s: float) -> None:
        self._idle_s, self._max_s = idle_s, max_s
        self._sessions: OrderedDict[str, _Session] = OrderedDict()

    def begin(self, now_s: float) -> str:
        """Begin a session; returns its id. The oldest session ends when there are too many."""
        session = secrets.token_urlsafe()
        self._sessions[session] = _Session(now_s, now_s)
        while len(self._sessions) > SESSIONS_MAX:
            self._sessions.popitem(last=False)
        return session

    def remaining_s(self, session: str, now_s: float) -> float:
        """Time until a session ends if it is not used; 0 for one that has ended, or never was."""
        if (times := self._sessions.get(session)) is None:
            return 0.0
        end_s = min(times.used_s + self._idle_s, times.start_s + self._max_s)
        if end_s <= now_s:
            self.end(session)
        return max(end_s - now_s, 0.0)

    def use(self, session: str, now_s: float) -> bool:
        """Note that somebody uses a session; returns whether it is there."""
        if self.remaining_s(session, now_s) <= 0.0:
            return False
        self._sessions[session].used_s = now_s
        return True

    def end(self, session: str) -> None:
        """End a session."""
        self._sessions.pop(session, None)


class LoginLimiter:
    """Lets each address send a few wrong passwords a minute. The table of addresses is bounded."""

    def __init__(self) -> None:
        self._failures: OrderedDict[str, deque[float]] = OrderedDict()

    def wait_s(self, address: str, now_s: float) -> float:
        """Time until an address may send a password; 0 at once."""
        failures = self._failures.get(network_of(address))
        if failures is None or len(failures) < FAILURES_MAX:
            return 0.0
        return max(failures[0] + FAILURE_SPAN_S - now_s, 0.0)

    def on_failure(self, address: str, now_s: float) -> None:
        """Count a wrong password."""
        name = network_of(address)
        self._failures.setdefault(name, deque(maxlen=FAILURES_MAX)).append(now_s)
        self._failures.move_to_end(name)
        while len(self._failures) > ADDRESSES_MAX:
            self._failures.popitem(last=False)

    def on_success(self, address: str) -> None:
        """Forget the wrong passwords of an address."""
        self._failures.pop(network_of(address), None)


def network_of(address: str) -> str:
    """The name of an address where it is counted: all addresses of one IPv6 network count as one."""
    try:
        parsed = ip_address(address)
    except ValueError:
        return address
    if isinstance(parsed, IPv6Address) and parsed.ipv4_mapped is None:
        return parsed.packed[:IPV6_NETWORK_BYTES].hex()
    return address
