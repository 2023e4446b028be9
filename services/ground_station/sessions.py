"""Who has logged in, until when; and how many wrong passwords an address may send.

Times are seconds of a monotonic clock that the caller reads.
"""

import hashlib
import secrets
from collections import OrderedDict, deque
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address

SESSIONS_MAX = 64
TOKEN_BYTES = 32
ADDRESSES_MAX = 1024
FAILURES_MAX = 5
FAILURE_SPAN_S = 60.0
IPV6_NETWORK_BYTES = 8
"""One household or machine has all addresses of such a network."""


@dataclass
class _Session:
    start_s: float
    used_s: float


class Sessions:
    """The log-ins, by random tokens of which only hashes are kept.

    Args:
        idle_s: a session ends when it was not used for this time.
        max_s: a session ends after this time in any case.
    """

    def __init__(self, idle_s: float, max_s: float) -> None:
        self._idle_s, self._max_s = idle_s, max_s
        self._sessions: OrderedDict[bytes, _Session] = OrderedDict()

    def begin(self, now_s: float) -> str:
        """Begin a session; returns its token. The oldest session ends when there are too many."""
        token = secrets.token_urlsafe(TOKEN_BYTES)
        self._sessions[_digest(token)] = _Session(now_s, now_s)
        while len(self._sessions) > SESSIONS_MAX:
            self._sessions.popitem(last=False)
        return token

    def remaining_s(self, token: str, now_s: float) -> float:
        """Time until a session ends if it is not used; 0 for one that has ended, or never was."""
        session = self._sessions.get(_digest(token))
        if session is None:
            return 0.0
        end_s = min(session.used_s + self._idle_s, session.start_s + self._max_s)
        if end_s <= now_s:
            self.end(token)
        return max(end_s - now_s, 0.0)

    def use(self, token: str, now_s: float) -> bool:
        """Note that somebody uses a session; returns whether it is there."""
        if self.remaining_s(token, now_s) <= 0.0:
            return False
        self._sessions[_digest(token)].used_s = now_s
        return True

    def end(self, token: str) -> None:
        """End a session."""
        self._sessions.pop(_digest(token), None)


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode()).digest()


class LoginLimiter:
    """Lets each address send a few wrong passwords a minute. The table of addresses is bounded."""

    def __init__(self) -> None:
        self._failures: OrderedDict[str, deque[float]] = OrderedDict()

    def wait_s(self, address: str, now_s: float) -> float:
        """Time until an address may send a password; 0 at once."""
        failures = self._failures.get(_network(address))
        if failures is None or len(failures) < FAILURES_MAX:
            return 0.0
        return max(failures[0] + FAILURE_SPAN_S - now_s, 0.0)

    def on_failure(self, address: str, now_s: float) -> None:
        """Count a wrong password."""
        name = _network(address)
        self._failures.setdefault(name, deque(maxlen=FAILURES_MAX)).append(now_s)
        self._failures.move_to_end(name)
        while len(self._failures) > ADDRESSES_MAX:
            self._failures.popitem(last=False)

    def on_success(self, address: str) -> None:
        """Forget the wrong passwords of an address."""
        self._failures.pop(_network(address), None)


def _network(address: str) -> str:
    """What is counted as one address: all addresses of one IPv6 network."""
    try:
        parsed = ip_address(address)
    except ValueError:
        return address
    if isinstance(parsed, IPv6Address) and parsed.ipv4_mapped is None:
        return parsed.packed[:IPV6_NETWORK_BYTES].hex()
    return address
