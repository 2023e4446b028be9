"""The links of a router to routers of other computers: which of them are missing, and why."""

import socket
import threading
import time
from collections.abc import Sequence

import zenoh

from jezero.keys.diagnosis import connection_problem
from jezero.router_address import parse_router, shown_router

PERIOD_S = 1.0
DIAGNOSIS_PERIOD_S = 5.0
"""A diagnosis is a TLS handshake of its own, which takes room on the link."""


class Uplinks:
    """Watches in a thread of its own whether this router is connected to each of the others.

    Args:
        session: session of this router.
        endpoints: Zenoh's endpoints of the other routers.

    Attributes:
        problem: a sentence for each link that is missing, or "".
    """

    def __init__(self, session: zenoh.Session, endpoints: Sequence[str]) -> None:
        self.problem = ""
        self._session = session
        self._reasons = dict.fromkeys(endpoints, "no router replies there")
        self._due_s = 0.0
        if endpoints:
            threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while not self._session.is_closed():
            try:
                linked = {link.dst.partition("/")[2].partition("?")[0] for link in self._session.info.links()}
            except zenoh.ZError:  # the session was closed just now
                return
            missing = [endpoint for endpoint in self._reasons if not linked & _addresses(endpoint)]
            if missing and time.monotonic() >= self._due_s:
                self._due_s = time.monotonic() + DIAGNOSIS_PERIOD_S
                for endpoint in missing:
                    self._reasons[endpoint] = connection_problem(endpoint) or "no router replies there"
            self.problem = "; ".join(f"no link to {shown_router(each)}: {self._reasons[each]}" for each in missing)
            time.sleep(PERIOD_S)


def _addresses(endpoint: str) -> set[str]:
    """The addresses of an endpoint's host as Zenoh writes them: host:port, an IPv6 host in brackets."""
    _, host, port = parse_router(endpoint)
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError:  # no such name, or nobody to ask
        return set()
    return {f"[{address[0]}]:{port}" if ":" in str(address[0]) else f"{address[0]}:{port}" for *_, address in found}
