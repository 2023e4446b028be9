"""Who has logged in, until when; and how many wrong passwords an address may send.

Times are seconds of a monotonic clock that the caller reads.
"""

import secrets
from collections import OrderedDict, deque
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address

SESSIONS_MAX = 64
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
