"""The Zenoh router of one stack: `python -m jezero.runtime.router` routes until SIGTERM.

It listens to the programs of its own computer at `JEZERO_ROUTER`. With links to other computers a second router, the
gate, is in the same process: it listens to them at `JEZERO_LISTEN`, connects to their routers at `JEZERO_CONNECT`, and
is linked with the first. So no radio delays messages between programs of one computer.
"""

import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress

import zenoh

from jezero.codec import encode
from jezero.router_address import insecurity
from jezero.runtime.config import ConfigError, HostLinks, Instance, instance_from_environment, links_from_environment
from jezero.runtime.denials import Denials
from jezero.runtime.gate import Gate
from jezero.runtime.link_guard import LinkGuard
from jezero.runtime.process import new_boot_id
from jezero.runtime.routing import ListenError, check_local, close, open_router, shown
from jezero.schemas.health import ServiceHealth, ServiceState
from jezero.schemas.topics import health_of, key, liveliness_key

NAME = "router"
HEALTH_PERIOD_S = 1.0
SAMPLE_PERIOD_S = 0.25
NAMED_FOR_S = 60.0
"""Time for which health names a reader whose link was closed."""
TEXT_MAX = 1000
STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)


def run(instance: Instance, links: HostLinks) -> None:
    """Route until SIGTERM or SIGINT, and publish health once a second.

    Raises:
        ListenError: see `open_router` and `check_local`.
    """
    check_local(instance.router)
    stop = _stop_socket()
    readers = _Readers()
    denials = Denials(readers.member_of)
    if any(links):
        denials.watch()
    session = open_router(instance.router, instance.vehicle)
    gate = Gate(instance.router, instance.vehicle, links) if any(links) else None
    alive = session.liveliness().declare_token(liveliness_key(instance.vehicle, "service", NAME))
    publish = _health_publisher(session, instance.vehicle)
    warnings = "".join(f"; {warning}" for each in (*links.listen, *links.connect) if (warning := insecurity(each)))
    where = f"listening on {shown((instance.router, *links.listen))}{warnings}"
    stopping, health_due_s = False, time.monotonic()
    while not stopping:
        gate_session = None if gate is None else gate.session
        readers.update([session] if gate_session is None else [session, gate_session])
        if time.monotonic() >= health_due_s:
            health_due_s = time.monotonic() + HEALTH_PERIOD_S
            if gate is not None and gate.update():
                print(f"{NAME}: the keys have changed: the links with other computers begin anew", file=sys.stderr)
            problem = "" if gate is None else gate.problem
            text = problem or f"{where}, {readers.sessions} sessions{readers.members}"
            publish("degraded" if problem else "ok", f"{text}{readers.text}{denials.text(time.monotonic())}")
        stopping = bool(select.select([stop], [], [], SAMPLE_PERIOD_S)[0])
    alive.undeclare()  # type: ignore[no-untyped-call]
    if gate is not None:
        gate.close()
    if not close(session):
        sys.stderr.flush()
        os._exit(0)


def _stop_socket() -> socket.socket:
    """A socket that can be read as soon as one of `STOP_SIGNALS` has arrived, in whichever thread."""
    stop_read, stop_write = socket.socketpair()
    stop_write.setblocking(False)
    signal.set_wakeup_fd(stop_write.detach())
    for number in STOP_SIGNALS:
        signal.signal(number, lambda _number, _frame: None)
    return stop_read


def _health_publisher(session: zenoh.Session, vehicle: str) -> Callable[[ServiceState, str], None]:
    """A function that publishes the health of this router, from its state and text."""
    publisher = session.declare_publisher(key(vehicle, health_of(NAME).name), encoding=zenoh.Encoding.APPLICATION_JSON)
    boot_id, process = new_boot_id(), f"{socket.gethostname()} pid {os.getpid()}"

    def publish(state: ServiceState, text: str) -> None:
        report = ServiceHealth(
            t_ns=0, service=NAME, boot_id=boot_id, process=process, state=state, text=text[:TEXT_MAX]
        )
        publisher.put(encode(report))

    return publish


class _Readers:
    """Who is connected; ends the links of readers that stopped reading, and names them."""

    def __init__(self) -> None:
        self._guard = LinkGuard()
        self._sessions: tuple[zenoh.Session, ...] = ()
        self._peers: dict[str, str] = {}
        """Who is at each address: name of the member with keys, and Zenoh's id of the session."""
        self._members: dict[str, str] = {}
        """Name of the member by Zenoh's id of its session, of those that are connected with keys."""
        self._named: dict[str, tuple[str, float]] = {}
        """Stopped readers by member and session: the name of each, and the time until which health names it."""
        self.sessions = 0
        """Number of sessions with others than this process."""

    def update(self, sessions: Sequence[zenoh.Session]) -> None:
        """Check all links of the sessions of this process; to be called every `SAMPLE_PERIOD_S`."""
        now_s = time.monotonic()
        self._sessions = tuple(sessions)
        own = {str(session.zid()) for session in sessions}
        links = [link for session in sessions for link in session.info.links() if str(link.zid) not in own]
        self._members = _members_of(links)
        self.sessions = len({str(link.zid) for link in links})
        peers = {link.dst.partition("/")[2].partition("?")[0]: _peer(link) for link in links}
        known = self._peers | peers  # a link may have ended since the last update
        self._peers = peers
        self._named = {session: named for session, named in self._named.items() if named[1] > now_s}
        for address in self._guard.update(now_s):
            peer = known.get(address, "unknown")
            name = f"{address} ({peer})"
            self._named[peer] = (name, now_s + NAMED_FOR_S)
            print(f"{NAME}: {name} stopped reading: its link is closed", file=sys.stderr, flush=True)

    def member_of(self, session: str) -> str:
        """Name of the member that has a session, by Zenoh's id of it, or "" for one that isn't known."""
        if session not in self._members:  # it has begun since the last update
            with suppress(zenoh.ZError):  # the gate was closed just now
                self._members |= _members_of(link for each in self._sessions for link in each.info.links())
        return self._members.get(session, "")

    @property
    def members(self) -> str:
        """For health: the members of the team on other computers that are connected, or ""."""
        return f", with {', '.join(sorted(set(self._members.values())))}" if self._members else ""

    @property
    def text(self) -> str:
        """For health: the readers of the last minute, or ""."""
        names = ", ".join(name for name, _ in self._named.values())
        return f"; stopped reading, link closed: {names}" if names else ""


def _members_of(links: Iterable[zenoh.Link]) -> dict[str, str]:
    """Name of the member by Zenoh's id of its session, of the links with keys."""
    return {str(link.zid): link.auth_identifier for link in links if link.auth_identifier}


def _peer(link: zenoh.Link) -> str:
    """Who is at the other end of a link."""
    member = f"{link.auth_identifier}, " if link.auth_identifier else ""
    return f"{member}session {link.zid}"


def main() -> int:
    """Run the router of the instance in the environment."""
    try:
        run(instance_from_environment(), links_from_environment())
    except (ConfigError, ListenError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return os.EX_CONFIG if isinstance(error, ConfigError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
